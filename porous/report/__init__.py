"""The report: one self-contained HTML page of what was made and what is known of it."""

from porous.report._compare import Material, compare_html, material_of
from porous.report._csv import curves_csv, measures_csv, read_curves
from porous.report._provenance import now, versions
from porous.report._report import report_html, write_report

__all__ = [
    "Material",
    "compare_html",
    "curves_csv",
    "material_of",
    "measures_csv",
    "now",
    "read_curves",
    "report_html",
    "versions",
    "write_report",
]
