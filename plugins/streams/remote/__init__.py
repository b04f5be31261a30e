"""The run for a program that shows it to a person: where it stands, all of it, as one line of JSON each time."""

from plugins.streams.remote._stream import RemoteOptions, RemoteStream

__all__ = ["RemoteOptions", "RemoteStream"]
