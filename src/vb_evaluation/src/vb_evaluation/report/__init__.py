"""The study's report: one HTML page without external resources, and each of its tables as CSV."""
from vb_evaluation.report.page import write_report

__all__ = ["write_report"]
