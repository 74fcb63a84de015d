"""The endpoints of the REST API, one module per group; their docstrings are the texts of /docs."""
