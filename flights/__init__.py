"""Flying many: runners, processes, tests, tables and pages of what came of it."""
