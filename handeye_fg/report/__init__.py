"""A result for a person: ``report.html`` and the summary in the terminal. Nothing is estimated here."""

from handeye_fg.report.page import render as render_report
from handeye_fg.report.page import write_report
from handeye_fg.report.terminal import summary_text

__all__ = ["render_report", "summary_text", "write_report"]
