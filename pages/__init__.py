"""Markup, style and plots of the HTML pages: one look for every report."""
