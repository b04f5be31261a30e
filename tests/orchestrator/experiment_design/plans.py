"""Small plans of the demo's motor, as a drive without hardware would lay them out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

from orchestrator.config import Plan, load_procedure, make_plan
from orchestrator.experiment_design.machine import Machine
from orchestrator.registry.plugins import PluginKind, make_plugins
from protocols import Capabilities, Effect, Procedure, StageEntry

NOISE_A = 0.02
DRIVE = Capabilities(
    name="on paper",
    simulated=True,
    sampling_frequency_hz=10_000.0,
    pwm_frequency_hz=10_000.0,
    pwm_frequencies_hz=(10_000.0, 20_000.0),
    dc_bus_voltage_v=540.0,
    max_current_a=20.0,
    max_voltage_v=300.0,
    excitations=frozenset({"gates_off", "hold", "trapezoid", "injection"}),
    watchdog_s=0.5,
    watchdog_covers=frozenset({"gates_off", "hold", "trapezoid", "injection"}),
)
GATES_OFF = {"kind": "gates_off", "duration_s": 1.0}
HOLDS = {"kind": "resistance", "points_a": [[1, 0], [-1, 0], [0, 1], [0, -1], [2.5, 0], [-2.5, 0], [0.1, 0], [-0.1, 0]]}
SWEEPS = {"kind": "classical", "held_a": [0.0], "axes": ["d", "q"], "periods": 1}
RIPPLE = {"kind": "injection", "points_a": [[0, 0], [2, 0], [-2, 0], [0, 2], [1, -2], [-1, 1]], "duration_s": 0.5}


@cache
def _demo() -> Procedure:
    return load_procedure("demo")


def plan(*stages: dict[str, Any], repeats: int = 1) -> Plan:
    """The demo's motor and limits with these stages, all of them again and again."""
    entries = tuple(StageEntry.model_validate(stage) for stage in stages * repeats)
    free = _demo().limits.model_copy(update={"duration_s": None, "energy_j": None})
    return make_plan(_demo().model_copy(update={"stages": entries, "limits": free}), DRIVE)


def machine() -> Machine:
    """By its nameplate."""
    return Machine.of(_demo().motor, "on paper")


def effects(*names: str) -> Sequence[Effect]:
    """Of the catalogue."""
    return make_plugins(PluginKind.EFFECTS, list(names))
