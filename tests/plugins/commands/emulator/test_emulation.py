"""The emulator's loop: with real-time priority it leaves time to others, its host among them."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from plugins.commands.emulator._bounds import BOUNDS
from plugins.commands.emulator._emulation import Emulation, LinkSettings
from plugins.commands.emulator._log import no_log


class Computing:
    """A device that always has something to compute."""

    def __init__(self, turn_s: float) -> None:
        self._turn_s = turn_s
        self.power = SimpleNamespace(guard=lambda now_s: None)
        self.urgent: list[Any] = []
        self.bulk: list[Any] = []

    def wait_s(self) -> float:
        return 0.0

    def receive(self, frames: Any) -> None:
        return None

    def turn(self) -> None:
        time.sleep(self._turn_s)


class Port:
    """A link on which nothing comes; it notes how long it may be waited for."""

    connected = None
    damage = damage_received = None

    def __init__(self) -> None:
        self.waits_s: list[float] = []

    def receive(self, timeout_s: float) -> list[Any]:
        self.waits_s.append(timeout_s)
        return []


@pytest.mark.parametrize(("rests", "turn_s"), [(True, 0.003), (True, 0.03), (False, 0.003)])
def test_a_computation_is_followed_by_a_pause_as_long_where_it_has_priority(rests: bool, turn_s: float) -> None:
    port: Any = Port()
    device: Any = Computing(turn_s)
    emulation = Emulation(device, port, LinkSettings(), no_log)
    emulation.rests = rests
    for _ in range(3):
        emulation.turn()
    assert port.waits_s[0] == 0.0
    for wait_s in port.waits_s[1:]:
        assert min(turn_s, BOUNDS.max_rest_s) * rests <= wait_s <= BOUNDS.max_rest_s * rests
