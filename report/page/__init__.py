"""The report as one file for a browser: nothing is fetched, everything is inside."""

from report.page.page import write_page

__all__ = ["write_page"]
