"""The plugin interface and the built-in policies."""
