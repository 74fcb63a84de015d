"""What is asked for in groups, beside the commands in `app.py`; their docstrings are the page at /docs."""
