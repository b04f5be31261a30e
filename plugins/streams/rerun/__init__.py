"""A run in the rerun viewer (https://rerun.io): while it happens, and afterwards out of its ``view.rrd``."""

from plugins.streams.rerun._making import make_fleet_view, make_view, whole_view
from plugins.streams.rerun._stream import RerunOptions, RerunStream
from plugins.streams.rerun._viewer import best_view, page_url

__all__ = ["RerunOptions", "RerunStream", "best_view", "make_fleet_view", "make_view", "page_url", "whole_view"]
