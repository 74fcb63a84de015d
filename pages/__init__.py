"""The HTML pages: one look for every report, each a single file that fetches nothing.

A room above brings words and figures; elements and tables (markup), the document around them (document), small drawings
(charts) and the plot of recordings (plot) are made here.
"""
