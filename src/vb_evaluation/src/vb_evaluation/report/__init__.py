"""The study's report: one HTML page without any outside resource, and every table of it as CSV."""
from vb_evaluation.report.page import write_report

__all__ = ["write_report"]
