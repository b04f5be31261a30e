"""The built-in streams under the kit that third parties use."""

from __future__ import annotations

from pydantic import BaseModel

from orchestrator.testing import StreamConformance
from plugins.streams.console import ConsoleOptions, ConsoleStream
from plugins.streams.remote import RemoteStream
from plugins.streams.report import ReportStream
from protocols import Stream, StreamSetup


class TestConsoleAuto(StreamConformance):
    options_given: ConsoleOptions = ConsoleOptions()

    def make_stream(self, setup: StreamSetup) -> Stream:
        return ConsoleStream(setup)

    def options(self) -> BaseModel:
        return self.options_given


class TestConsoleLive(TestConsoleAuto):
    options_given = ConsoleOptions(mode="live")


class TestConsolePlain(TestConsoleAuto):
    options_given = ConsoleOptions(mode="plain")


class TestConsoleQuiet(TestConsoleAuto):
    options_given = ConsoleOptions(mode="quiet")


class TestConsoleJson(TestConsoleAuto):
    options_given = ConsoleOptions(mode="jsonl")


class TestRemote(StreamConformance):
    def make_stream(self, setup: StreamSetup) -> Stream:
        return RemoteStream(setup)


class TestReport(StreamConformance):
    def make_stream(self, setup: StreamSetup) -> Stream:
        return ReportStream(setup)
