"""The console: a run as a person likes to watch it, or as plain lines where nobody watches."""

from plugins.streams.console._stream import ConsoleOptions, ConsoleStream

__all__ = ["ConsoleOptions", "ConsoleStream"]
