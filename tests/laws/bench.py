"""The default campaign in short on the plant, written as a recording that holds nothing of the plant but its nameplate.

The rotor stays where it is, or is turned to the next of a few positions after each segment.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.blind.campaign import Campaign, _plan, _Rows, _write, manifest
from tests.blind.magnetics import PM400
from tests.laws.hidden import Hidden
from tests.laws.plant import BUS_GAIN, CONTROL, NOTHING, OFF, OPEN, RESOLVER, STATES, Array, Machine, run

SHORT = Campaign(period_s=0.5, injection_s=0.25)
POSITIONS = 6
"""Places of a rotor that is turned."""
BUS_SWING, BUS_PERIOD_S = 0.08, 23.0
"""The link's swing relative to its mean, where it swings."""


@dataclass
class _Bench:
    """The plant's state from segment to segment."""

    hidden: Hidden | None
    machine: Machine
    rng: np.random.Generator
    time_s: float = 0.0
    cores: Array = field(default_factory=lambda: np.zeros(2))
    pull: Array = field(default_factory=lambda: np.zeros(2))

    def __post_init__(self) -> None:
        self.law = self.hidden.law if self.hidden is not None else NOTHING
        constants = self.hidden.constants if self.hidden is not None else ()
        self.k = np.array([*constants, 1.0, 1.0])[:2]
        self.phase = "abc".index(self.hidden.phase) if self.hidden is not None and self.hidden.phase else -1
        self.y = np.zeros(STATES)
        self.y[0] = self.machine.magnet_wb
        width = 2.0 * math.pi * 25.0
        inductance = np.array([self.machine.l_d_h, self.machine.l_q_h])
        self.gains = np.concatenate([math.sqrt(2.0) * width * inductance, width**2 * inductance])

    def stretch(self, mode: int, wanted: Array, believed: float, pulses: float) -> tuple[Array, Array, Array]:
        """Currents and voltages in the stator frame, shape (n, 2), and the link voltage, shape (n,)."""
        rows, ts = len(wanted), 1.0 / PM400.sampling_hz
        current, voltage = np.empty((rows, 2)), np.empty((rows, 2))
        noise = self.machine.noise_a * self.rng.standard_normal((rows, 2))
        t = self.time_s + ts * np.arange(rows)
        swing = BUS_SWING * np.sin(2.0 * np.pi * t / BUS_PERIOD_S) if self.law == BUS_GAIN else np.zeros(rows)
        run(
            self.law, self.k, self.phase, self.machine.numbers, self.y, self.cores, mode, self.gains, self.pull,
            believed, pulses, self.time_s, ts, np.ascontiguousarray(wanted, dtype=np.float64), swing, noise, current,
            voltage,
        )  # fmt: skip
        self.time_s += rows * ts
        return current, voltage, PM400.bus_v * (1.0 + swing)


def record(directory: Path, hidden: Hidden | None, seed: int = 0, machine: Machine | None = None) -> Path:
    """Run the campaign and write its recording; returns its directory."""
    (directory / "captures").mkdir(parents=True, exist_ok=True)
    first = float(np.random.default_rng([seed, 1]).uniform(-math.pi, math.pi))
    bench = _Bench(hidden, machine or Machine(), np.random.default_rng(seed))
    bench.y[2] = bench.machine.magnet_wb * math.cos(first)
    positions = POSITIONS if bench.law == RESOLVER else 1
    counts: dict[str, int] = {}
    segments: list[dict[str, Any]] = []
    for ask in _plan(PM400, SHORT):
        number = counts.get(ask.stage, 0)
        counts[ask.stage] = number + 1
        turn = 2.0 * math.pi / positions * (len(segments) % positions)
        believed = math.remainder(first + turn, 2.0 * math.pi)
        if ask.off:
            start = bench.time_s
            current, voltage, bus = bench.stretch(OFF, np.zeros((ask.off, 2)), believed, 1.0)
        else:
            settling = np.tile(ask.settle_a, (int(0.25 * PM400.sampling_hz), 1))
            _, volts, _ = bench.stretch(CONTROL, settling, believed, ask.pwm_ratio)
            start = bench.time_s
            if ask.path_a is not None:
                current, voltage, bus = bench.stretch(CONTROL, ask.path_a, believed, ask.pwm_ratio)
            else:
                assert ask.wave_v is not None
                c, s = math.cos(believed), math.sin(believed)
                mean = volts[-len(volts) // 5 :].mean(axis=0) @ np.array([[c, -s], [s, c]])
                current, voltage, bus = bench.stretch(OPEN, mean + ask.wave_v, believed, ask.pwm_ratio)
        single = (current.astype(np.float32), voltage.astype(np.float32), bus.astype(np.float32))
        name = f"{ask.stage}-{number:03d}"
        segments.append(
            {
                "id": name, "stage": ask.stage, "start_s": start, "samples": len(current),
                "rotor_angle_rad": believed, "settings": ask.settings,
                "sha256": _write(directory / "captures" / f"{name}.parquet", _Rows(*single, None)),
            }
        )  # fmt: skip
    text = json.dumps(manifest(PM400, 0.0, "hidden-law", segments), indent=1)
    (directory / "recording.json").write_text(text, encoding="utf-8")
    return directory
