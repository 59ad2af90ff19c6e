"""The report: one self-contained HTML page of what was made and what is known of it."""

from porous.report._csv import curves_csv, measures_csv
from porous.report._provenance import versions
from porous.report._report import report_html, write_report

__all__ = ["curves_csv", "measures_csv", "report_html", "versions", "write_report"]
