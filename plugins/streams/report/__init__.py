"""The report: one page for a colleague, made from a run directory's files alone."""

from plugins.streams.report._fleet_page import write_fleet_report
from plugins.streams.report._page import write_report
from plugins.streams.report._stream import ReportStream

__all__ = ["ReportStream", "write_fleet_report", "write_report"]
