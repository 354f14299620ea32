"""What a run is worth: figures under stable names, and one page that a person would want to look at."""

from twin_node.nodes.report.page import FILES, STEPS, ReportError, write_report

__all__ = ["FILES", "STEPS", "ReportError", "write_report"]
