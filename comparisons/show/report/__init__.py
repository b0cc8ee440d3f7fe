"""The report page: one HTML file that shows a comparison, offline, with everything in it that it needs.

`view` lays the estimates into one frame and thins them out, one module per figure turns that into plain Plotly
dictionaries, `page` puts them into the template. Plotly (the extra ``report``) is imported only to be inlined.
"""

from .page import check_page, page_of, write_report

__all__ = ["check_page", "page_of", "write_report"]
