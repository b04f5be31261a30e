"""What is urgent overtakes, a paced line keeps its pace, and losses are as specified."""

from __future__ import annotations

import itertools
import random

import pytest

from plugins.commands.emulator._line import Losses, Lossy, Outbox
from plugins.commands.emulator._ports import Unit
from plugins.wire import CLASSIC_LAYOUT, BlockLayout, Frame, SerialDecoder, to_serial


class Sink:
    """A port that takes everything, or nothing."""

    def __init__(self) -> None:
        self.open = True
        self.taken: list[Unit] = []

    @property
    def connected(self) -> bool | None:
        return True

    def publish(self) -> None:
        pass

    def layout(self, block_bytes: int) -> BlockLayout:
        return CLASSIC_LAYOUT

    def coded(self, frame: Frame) -> Unit:
        return to_serial(frame)

    def cost(self, unit: Unit) -> float:
        return len(unit)

    def damage(self, unit: Unit, chance: random.Random) -> Unit | None:
        return None

    def damage_received(self, frame: Frame, chance: random.Random) -> Frame | None:
        return None

    def send(self, unit: Unit) -> bool:
        if self.open:
            self.taken.append(unit)
        return self.open

    def receive(self, timeout_s: float) -> list[Frame]:
        return []

    def close(self) -> None:
        pass


def whole(losses: Losses = Losses()) -> Lossy[Unit]:  # noqa: B008
    return Lossy(losses, "1", lambda unit, chance: None)


def ids(sink: Sink) -> list[int]:
    decoder = SerialDecoder()
    return [frame.frame_id for unit in sink.taken for frame in decoder.feed(bytes(unit))]  # type: ignore[arg-type]


def test_urgent_frames_overtake_bulk() -> None:
    sink = Sink()
    outbox = Outbox(sink, whole(), None)
    outbox.put_bulk([Frame(272, bytes(8))] * 3)
    outbox.put([Frame(128, bytes(8))])
    outbox.pump(0.0)
    assert ids(sink) == [128, 272, 272, 272]
    assert outbox.empty


@pytest.mark.parametrize("rate", [5_000.0, 92_160.0])
def test_a_paced_line_keeps_its_pace(rate: float) -> None:
    sink = Sink()
    outbox = Outbox(sink, whole(), rate)
    outbox.pump(10.0)
    outbox.put_bulk([Frame(272, bytes(8))] * 40_000)
    for k in range(1000):
        outbox.pump(10.0 + 1e-3 * k)
    sent = sum(len(unit) for unit in sink.taken)
    assert sent == pytest.approx(rate, rel=0.05)


def test_what_nobody_takes_is_thrown_away() -> None:
    sink = Sink()
    outbox = Outbox(sink, whole(), None)
    outbox.pump(0.0)
    sink.open = False
    outbox.put([Frame(128, bytes(8))] * 100)
    outbox.pump(0.1)
    assert not outbox.empty
    outbox.pump(0.5)
    assert outbox.empty


@pytest.mark.parametrize("field", ["drop", "duplicate", "reorder", "corrupt"])
def test_losses_are_those_that_were_requested(field: str) -> None:
    lossy: Lossy[int] = Lossy(Losses(**{field: 0.05}), "seed", lambda unit, chance: -unit)
    out = lossy(range(1, 20_001))
    sizes = [abs(unit) for unit in out]
    changed = {
        "drop": 20_000 - len(set(sizes)),
        "duplicate": len(out) - len(set(sizes)),
        "reorder": sum(b < a for a, b in itertools.pairwise(sizes)),
        "corrupt": sum(unit < 0 for unit in out),
    }
    assert changed.pop(field) == pytest.approx(1000, rel=0.15)
    held_back = changed.pop("drop", 0)
    assert held_back <= (10 if field == "reorder" else 0)
    assert not any(changed.values())


def test_the_same_seed_loses_the_same() -> None:
    losses = Losses(0.1, 0.1, 0.1, 0.1)
    first, second = (Lossy[int](losses, "s", lambda unit, chance: None)(range(1000)) for _ in range(2))
    assert first == second


def test_a_long_answer_does_not_keep_the_watchdog_waiting() -> None:
    sink = Sink()
    outbox = Outbox(sink, whole(), None)
    outbox.put_bulk([Frame(272, bytes(8))] * 5000)
    outbox.pump(0.0)
    assert 0 < len(sink.taken) <= 64
    assert not outbox.blocked
