"""Evaluation of policies: runners, parallel flights, tests, tables, pages and closing of a gap."""
