"""Hysteresis steps on a blind plant, written as a recording: +-U on each axis, turned round at a current limit.

The commonest standstill self-commissioning (M. Hinkkanen, P. Pescetto, E. Molsa, S. E. Saarakkala, G. Pellegrino,
R. Bojoi, "Sensorless self-commissioning of synchronous reluctance motors at standstill without rotor locking", IEEE
Trans. Ind. Appl. 53 (2017) 2120, doi:10.1109/TIA.2016.2644624), here with the rotor locked.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.blind.campaign import Bench, _Clock, _manifest, _Rows, _stretch, _write
from tests.blind.drive import OFF, OPEN
from tests.blind.magnetics import Array

STATES_BUS_V, STATES_HZ = 120.0, 2e4
"""Where a bridge keeps one state from row to row."""


@dataclass(frozen=True)
class Steps:
    """One segment: volts on d and q, and the currents at which each turns round; zero volts leave an axis alone.

    `centre` shifts the limits, so that a loop need not lie about zero.
    """

    volts: tuple[float, float]
    limit_a: tuple[float, float]
    seconds: float
    centre_a: tuple[float, float] = (0.0, 0.0)


def usual(bench: Bench, volts: float, seconds: float = 0.3) -> Sequence[Steps]:
    """On d, on q, and on both at once, the latter to several limits: the loops then fill the plane."""
    top = bench.machine.top_a
    both = [(a * top, b * top) for a, b in ((0.7, 0.7), (1.0, 0.45), (0.45, 1.0), (0.7, 0.35))]
    return (
        Steps((volts, 0.0), (top, top), seconds),
        Steps((0.0, volts), (top, top), seconds),
        *(Steps((volts, 0.83 * volts), limit, seconds) for limit in both),
    )


def record_steps(bench: Bench, plan: Sequence[Steps], directory: Path, gates_off_s: float = 0.0) -> Path:
    """Run the steps and write the recording; returns its directory. Nothing of the plant but its nameplate is in it."""
    (directory / "captures").mkdir(parents=True)
    clock, rng, segments = _Clock(), np.random.default_rng(bench.seed), []
    off = round(gates_off_s * bench.machine.sampling_hz)
    requested: list[Steps | None] = [None, *plan] if off else list(plan)
    for number, steps in enumerate(requested):
        stage, start = "gates_off" if steps is None else "steps", clock.time_s
        rows = (
            _stretch(bench, OFF, np.zeros((off, 2)), clock, rng) if steps is None else _swung(bench, steps, clock, rng)
        )
        name = f"{stage}-{number:03d}"
        settings = {} if steps is None else {"volts_d_v": steps.volts[0], "volts_q_v": steps.volts[1]}
        segments.append(
            {
                "id": name, "stage": stage, "start_s": start, "samples": len(rows.current),
                "rotor_angle_rad": bench.believed_rad, "settings": settings,
                "sha256": _write(directory / "captures" / f"{name}.parquet", rows),
            }
        )  # fmt: skip
        if steps is not None:
            _stretch(bench, OPEN, np.zeros((round(0.1 * bench.machine.sampling_hz), 2)), clock, rng)
    (directory / "recording.json").write_text(json.dumps(_manifest(bench, "blind-steps", segments), indent=1))
    return directory


def _swung(bench: Bench, steps: Steps, clock: _Clock, rng: np.random.Generator) -> _Rows:
    """Sample by sample: a voltage turns round where the current that was just read is beyond its limit."""
    c, s = np.cos(bench.believed_rad), np.sin(bench.believed_rad)
    sign = np.ones(2)
    read, rows = np.zeros(2), []
    for _ in range(round(steps.seconds * bench.machine.sampling_hz)):
        sign = np.where(read > np.add(steps.centre_a, steps.limit_a), -1.0, sign)
        sign = np.where(read < np.subtract(steps.centre_a, steps.limit_a), 1.0, sign)
        rows.append(_stretch(bench, OPEN, (sign * steps.volts)[None], clock, rng))
        alpha, beta = rows[-1].current[0]
        read = np.array([c * alpha + s * beta, c * beta - s * alpha])
    current, voltage, bus = (np.concatenate([row[k] for row in rows]) for k in range(3))
    return _Rows(current, voltage, bus, None)


def record_states(bench: Bench, directory: Path, seconds: float = 0.08) -> Path:
    """Steps by a bridge that keeps one state a row: along a, along b, along c, and along a and b by turns."""
    machine = replace(bench.machine, bus_v=STATES_BUS_V, sampling_hz=STATES_HZ)
    plant = bench.plant._replace(bus_v=STATES_BUS_V, sample_s=1.0 / STATES_HZ)
    bench = replace(bench, machine=machine, plant=plant)
    (directory / "captures").mkdir(parents=True)
    clock, rng, segments = _Clock(), np.random.default_rng(bench.seed), []
    plan: list[tuple[Sequence[int], Sequence[float]]] = [((phase,), (1.0,)) for phase in range(3)]
    plan += [((0, 1), limits) for limits in ((0.6, 0.6), (0.9, 0.4), (0.4, 0.9), (0.6, 0.3))]
    for number, (along, limits) in enumerate(plan):
        start = clock.time_s
        rows = _switched(bench, along, machine.top_a * np.array(limits), round(seconds * STATES_HZ), clock, rng)
        name = f"steps-{number:03d}"
        segments.append(
            {
                "id": name, "stage": "steps", "start_s": start, "samples": len(rows.current),
                "rotor_angle_rad": bench.believed_rad, "settings": {},
                "sha256": _write(directory / "captures" / f"{name}.parquet", rows),
            }
        )  # fmt: skip
        _stretch(bench, OPEN, np.zeros((round(0.1 * STATES_HZ), 2)), clock, rng)
    (directory / "recording.json").write_text(json.dumps(_manifest(bench, "blind-states", segments), indent=1))
    return directory


def _switched(
    bench: Bench, along: Sequence[int], limit_a: Array, count: int, clock: _Clock, rng: np.random.Generator
) -> _Rows:
    """Along each phase's axis in turn, its voltage turned where its own part of the current is beyond the limit."""
    angle = np.array(along) * 2.0 * np.pi / 3.0
    axes = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    c, s = np.cos(bench.believed_rad), np.sin(bench.believed_rad)
    believed = axes @ np.array([[c, -s], [s, c]])
    sign, rows = np.ones(len(along)), []
    for k in range(count):
        turn = k % len(along)
        volts = sign[turn] * 2.0 / 3.0 * bench.machine.bus_v * believed[turn]
        rows.append(_stretch(bench, OPEN, volts[None], clock, rng))
        read = np.linalg.pinv(axes.T) @ rows[-1].current[0]
        sign = np.where(read > limit_a, -1.0, np.where(read < -limit_a, 1.0, sign))
    current, voltage, bus = (np.concatenate([row[k] for row in rows]) for k in range(3))
    return _Rows(current, voltage, bus, None)
