"""The configuration file: reader, checks, editor and reference of its keys."""
