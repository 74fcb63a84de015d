"""Mutation testing: a test must fail when a safety-relevant module is changed in one place."""
