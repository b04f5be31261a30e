"""The console: a run as a person likes to watch it, or as plain lines where nobody watches."""

from plugins.streams.console._progress import Progress
from plugins.streams.console._stream import ConsoleOptions, ConsoleStream
from plugins.streams.console._words import stage_title, summary_rows, time_left

__all__ = ["ConsoleOptions", "ConsoleStream", "Progress", "stage_title", "summary_rows", "time_left"]
