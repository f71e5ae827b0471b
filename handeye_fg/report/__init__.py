"""A result for a person: the page, the terminal, Markdown, figures. Nothing is estimated here."""

from handeye_fg.report.figure_files import write_figures
from handeye_fg.report.markdown import markdown_text
from handeye_fg.report.page import render as render_report
from handeye_fg.report.page import write_report
from handeye_fg.report.terminal import summary_text

__all__ = ["markdown_text", "render_report", "summary_text", "write_figures", "write_report"]
