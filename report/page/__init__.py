"""The report as one HTML file; it loads nothing from the network."""

from report.page.page import write_page

__all__ = ["write_page"]
