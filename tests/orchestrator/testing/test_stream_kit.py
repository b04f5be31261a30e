"""The stream kit passes a stream that keeps the contract, and fails each one that breaks it in one way."""

from __future__ import annotations

import tempfile
import threading
import time
from pathlib import Path
from typing import ClassVar

import pytest
from pydantic import BaseModel

from orchestrator.testing import StreamConformance
from protocols import Message, NoOptions, SamplesCaptured, Stream, StreamSetup
from tests.orchestrator.testing.kit_runner import failures


class ExampleStream:
    """Counts what it hears, and writes the count down at the end."""

    name: ClassVar[str] = "example"
    Options: ClassVar[type[BaseModel]] = NoOptions
    wants_samples: ClassVar[bool] = False

    def __init__(self, setup: StreamSetup) -> None:
        self.run = setup.run
        self.count = 0

    def receive(self, message: Message) -> None:
        self.count += 1
        print(message.kind)

    def close(self) -> None:
        (self.run / "count.txt").write_text(f"{self.count}\n", encoding="utf-8")


class ExampleScope(ExampleStream):
    """Keeps the latest block."""

    wants_samples = True
    latest: SamplesCaptured | None = None

    def receive(self, message: Message) -> None:
        if isinstance(message, SamplesCaptured):
            self.latest = message


def kit_for(stream: type[ExampleStream]) -> StreamConformance:
    class Kit(StreamConformance):
        registered = False

        def make_stream(self, setup: StreamSetup) -> Stream:
            return stream(setup)

    return Kit()


@pytest.mark.parametrize("stream", [ExampleStream, ExampleScope])
def test_passes_a_stream_that_keeps_the_contract(tmp_path: Path, stream: type[ExampleStream]) -> None:
    assert failures(kit_for(stream), tmp_path) == {}


class WantsRunStartedFirst(ExampleStream):
    started = False

    def receive(self, message: Message) -> None:
        self.started = self.started or message.kind == "run_started"
        if not self.started:
            raise RuntimeError("no run is under way")


class ChokesOnMaps(ExampleStream):
    def receive(self, message: Message) -> None:
        if message.kind == "map_estimated":
            raise TypeError("what is that?")


class NeedsARunToClose(ExampleStream):
    def close(self) -> None:
        if self.count == 0:
            raise RuntimeError("nothing received")


class RetriesForEver(ExampleStream):
    def receive(self, message: Message) -> None:
        while True:
            try:
                print(message.kind)
            except OSError:
                time.sleep(0.05)
            else:
                return


class LeavesThroughTheWindow(ExampleStream):
    def receive(self, message: Message) -> None:
        try:
            print(message.kind)
        except OSError as error:
            raise SystemExit(1) from error


class WritesIntoTheWorkingDirectory(ExampleStream):
    def close(self) -> None:
        Path("count.txt").write_text("", encoding="utf-8")


class WritesBesideTheRun(ExampleStream):
    def close(self) -> None:
        self.run.with_suffix(".txt").write_text("", encoding="utf-8")


class TidiesTheJournal(ExampleStream):
    def close(self) -> None:
        (self.run / "journal.jsonl").write_text("[]", encoding="utf-8")


class KeepsEverything(ExampleScope):
    def __init__(self, setup: StreamSetup) -> None:
        super().__init__(setup)
        self.kept: list[Message] = []

    def receive(self, message: Message) -> None:
        self.kept.append(message)


class Slow(ExampleStream):
    def receive(self, message: Message) -> None:
        time.sleep(0.06)


class WantsSamplesPerhaps(ExampleStream):
    wants_samples = None  # type: ignore[assignment]


class ScalesWhatItIsShown(ExampleScope):
    def receive(self, message: Message) -> None:
        if isinstance(message, SamplesCaptured):
            message.capture.i_ab[:] *= 1e3  # to milliamperes, for the axis


class LeavesAThread(ExampleStream):
    def __init__(self, setup: StreamSetup) -> None:
        super().__init__(setup)
        threading.Thread(target=time.sleep, args=(4.0,), name="refresher", daemon=True).start()


class WritesToTheTemporaryFolder(ExampleStream):
    def close(self) -> None:
        with tempfile.NamedTemporaryFile("w", delete=False, dir=self.run.parents[1]) as file:
            file.write("x")


class HangsAtTheEnd(ExampleStream):
    def close(self) -> None:
        time.sleep(4.0)


MUTATIONS: list[tuple[type[ExampleStream], str]] = [
    (ScalesWhatItIsShown, "whole_run"),
    (LeavesAThread, "closed_without_a_message"),
    (WritesToTheTemporaryFolder, "nowhere_but"),
    (HangsAtTheEnd, "closed_without_a_message"),
    (WantsRunStartedFirst, "any_order"),
    (ChokesOnMaps, "any_order"),
    (ChokesOnMaps, "whole_run"),
    (NeedsARunToClose, "closed_without_a_message"),
    (RetriesForEver, "goes_away"),
    (LeavesThroughTheWindow, "goes_away"),
    (WritesIntoTheWorkingDirectory, "nowhere_but"),
    (WritesBesideTheRun, "nowhere_but"),
    (TidiesTheJournal, "nowhere_but"),
    (KeepsEverything, "memory_stays_bounded"),
    (Slow, "quickly"),
    (WantsSamplesPerhaps, "class_keeps_the_contract"),
]


@pytest.mark.parametrize(("stream", "check"), MUTATIONS, ids=[f"{s.__name__}-{c}" for s, c in MUTATIONS])
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_fails_a_stream_that_breaks_the_contract(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stream: type[ExampleStream], check: str
) -> None:
    for timeout in ("CALL_TIMEOUT_S", "THREAD_END_TIMEOUT_S"):
        monkeypatch.setattr(f"orchestrator.testing._stream.{timeout}", 1.0)
    assert failures(kit_for(stream), tmp_path, only=check), f"{stream.__name__} passes {check}"


def test_a_stream_that_hangs_is_waited_for_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orchestrator.testing._stream.CALL_TIMEOUT_S", 0.5)
    begun = time.monotonic()
    found = failures(kit_for(HangsAtTheEnd), tmp_path)
    assert time.monotonic() - begun < 3.0
    assert sum("it hangs: close has not returned" in text for text in found.values()) >= 8
