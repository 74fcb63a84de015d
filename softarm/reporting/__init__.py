"""HTML reports with a common style, each a single file without external resources.

Modules: elements and tables (markup), the page around them (document), small charts (charts) and the plot of
recordings (plot). The packages that use them supply texts and figures.
"""
