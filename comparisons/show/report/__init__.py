"""The interactive report: one HTML file that shows a comparison offline, with everything in it that it needs.

`view` aligns the estimates and thins them, the modules of the figures turn that into plain Plotly dictionaries, and `page`
puts them into the template. Plotly (the extra ``report``) is imported only to copy its script into the page.
"""
