"""The default campaign in short, run on a blind plant and written as a recording of format version 1.

Gates off, anchors, direct currents at two PWM frequencies, trapezoids on d, q and the diagonal, injection over a grid
at two amplitudes, anchors again. Nothing of the plant but its nameplate gets into the recording.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.blind.drive import CONTROL, OFF, OPEN, Rows, run
from tests.blind.magnetics import Array, Machine, Table
from tests.blind.plant import MEMORY, STATES, Plant
from tests.blind.switched import NO_BRIDGE, Bridge

LEVELS = (-1.0, -0.5, 0.0, 0.5, 1.0)
SMALL = ((-1.0, -1.0), (-1.0, 1.0), (-0.5, 0.5), (0.0, 0.0), (0.5, -0.5), (1.0, -1.0), (1.0, 1.0))
DWELLS_D = (0.04, 0.08, 0.17, 0.33, 0.67, 1.0)
DWELLS_Q = (0.08, 0.33, 1.0)
SECOND_PWM = ((0.04, 0.0), (0.17, 0.0), (0.67, 0.0), (-0.04, 0.0), (-0.17, 0.0), (-0.67, 0.0), (0.0, 1.0), (0.0, -0.33))


@dataclass(frozen=True)
class Campaign:
    """What is measured; sizes in units of the machine's largest current and the injection's usual amplitude."""

    gates_off: bool = True
    second_pwm: bool = True
    classical: bool = True
    injection: bool = True
    second_amplitude: bool = True
    sine: bool = False
    """Instead of a square wave."""
    anchors: bool = True
    dwells: bool = True
    excited: bool = True
    """False: every stage is there, and nothing flows."""
    short_s: float | None = None
    """Every segment cut to this."""
    period_s: float = 1.0
    injection_s: float = 0.5
    dwell_s: float = 0.25


@dataclass(frozen=True)
class Bench:
    """A machine on the bench: what the plant truly is, and what the operator believes."""

    machine: Machine
    table: Table
    plant: Plant
    believed_rad: float = 0.0
    drive_delay_samples: float = 0.0
    seed: int = 0
    bridge: Bridge = NO_BRIDGE
    zero_wander_a: float = 0.0
    """By how much each reading's zero differs from segment to segment (rms)."""


@dataclass
class _Clock:
    """The state that is carried from segment to segment."""

    state: Array = field(default_factory=lambda: np.zeros(STATES))
    memory: Array = field(default_factory=lambda: np.zeros(MEMORY))
    time_s: float = 0.0


class _Rows(NamedTuple):
    """What is captured of a stretch."""

    current: Rows
    voltage: Rows
    bus: Rows
    phases: Rows | None


@dataclass(frozen=True)
class _Ask:
    """One segment: the set-point before it, and what is captured."""

    stage: str
    settings: dict[str, Any]
    settle_a: tuple[float, float] = (0.0, 0.0)
    path_a: Array | None = None
    """CONTROL: currents, a row a sample."""
    wave_v: Array | None = None
    """OPEN: on top of the voltage that the settling ended with."""
    off: int = 0
    pwm_ratio: float = 1.0


def record(bench: Bench, campaign: Campaign, directory: Path, name: str = "blind") -> Path:
    """Run the campaign and write the recording; returns its directory."""
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "captures").mkdir(exist_ok=True)
    clock, rng = _Clock(), np.random.default_rng(bench.seed)
    counts: dict[str, int] = {}
    segments = []
    for ask in _plan(bench.machine, campaign):
        number = counts.get(ask.stage, 0)
        counts[ask.stage] = number + 1
        start_s, rows = _measure(bench, ask, clock, rng)
        segments.append(
            {
                "id": f"{ask.stage}-{number:03d}",
                "stage": ask.stage,
                "start_s": start_s,
                "samples": len(rows.current),
                "rotor_angle_rad": bench.believed_rad,
                "settings": ask.settings,
                "sha256": _write(directory / "captures" / f"{ask.stage}-{number:03d}.parquet", rows),
            }
        )
    (directory / "recording.json").write_text(json.dumps(_manifest(bench, name, segments), indent=1))
    return directory


def rows_of(bench: Bench, campaign: Campaign) -> Iterator[tuple[str, Array, Array]]:
    """Run the campaign; by segments its stage, and current and voltage in the believed frame, shape (samples, 2).

    The voltage is of the row in which it is impressed.
    """
    clock, rng = _Clock(), np.random.default_rng(bench.seed)
    c, s = np.cos(bench.believed_rad), np.sin(bench.believed_rad)
    into_dq, late = np.array([[c, -s], [s, c]]), round(bench.drive_delay_samples)
    for ask in _plan(bench.machine, campaign):
        _, rows = _measure(bench, ask, clock, rng)
        count = len(rows.current) - late
        yield ask.stage, rows.current[late:].astype(float) @ into_dq, rows.voltage[:count].astype(float) @ into_dq


def _plan(machine: Machine, campaign: Campaign) -> Iterator[_Ask]:
    rate, top = machine.sampling_hz, machine.top_a * (1.0 if campaign.excited else 0.0)
    volts = 4 * machine.injection_hz * 0.2 * machine.l_d_h * np.sqrt(2.0) * machine.rated_current_rms_a
    volts = float(f"{volts:.2g}") * (1.0 if campaign.excited else 0.0)

    def seconds(wanted: float) -> int:
        return round(rate * (wanted if campaign.short_s is None else min(wanted, campaign.short_s)))

    def dwell(d: float, q: float, ratio: float = 1.0, **more: Any) -> _Ask:
        point = (d * top, q * top)
        settings = {"current_d_a": point[0], "current_q_a": point[1], **more}
        if ratio != 1.0:
            settings["pwm_frequency_hz"] = ratio * rate
        path = np.tile(point, (seconds(campaign.dwell_s), 1))
        return _Ask("resistance", settings, point, path_a=path, pwm_ratio=ratio)

    def inject(d: float, q: float, ratio: float = 1.0, **more: Any) -> _Ask:
        point, amplitude = (d * top, q * top), ratio * volts
        turn = 1.0 / campaign.injection_s
        settings = {
            "target_d_a": point[0], "target_q_a": point[1], "amplitude_v": amplitude,
            "frequency_hz": machine.injection_hz, "rotation_hz": turn,
            "waveform": "sine" if campaign.sine else "square", **more,
        }  # fmt: skip
        t = np.arange(seconds(campaign.injection_s)) / rate
        cycles = machine.injection_hz * t
        square = np.where(np.floor(2 * cycles + 1e-6) % 2 == 0, 1.0, -1.0)
        sign = np.sin(2 * np.pi * cycles) if campaign.sine else square
        angle = 2 * np.pi * turn * t
        wave = amplitude * sign[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return _Ask("injection", settings, point, wave_v=wave)

    def sweep(axis: str, held: float | None) -> _Ask:
        steps = seconds(campaign.period_s)
        shape = np.interp(np.arange(steps) / steps, [0, 0.125, 0.375, 0.625, 0.875, 1.0], [0, 1, 1, -1, -1, 0])
        wave = np.tile(shape, 2)[:, None] * top
        if held is None:
            path = wave * np.array([[1.0, 1.0]]) / np.sqrt(2.0)
        else:
            path = wave * np.array([[float(axis == "d"), float(axis == "q")]])
            path = path + held * top * np.array([[float(axis == "q"), float(axis == "d")]])
        settings: dict[str, Any] = {"swept_axis": axis, "amplitude_a": top, "period_s": steps / rate, "periods": 2}
        if held is not None:
            settings["held_a"] = held * top
        return _Ask("classical", settings, (float(path[0, 0]), float(path[0, 1])), path_a=path)

    if campaign.gates_off:
        yield _Ask("gates_off", {}, off=seconds(0.5))
    if campaign.anchors:
        yield dwell(0.67, 0.0, anchor=True)
        if campaign.injection:
            yield inject(0.0, 0.5, anchor=True)
    if campaign.dwells:
        for size in DWELLS_D:
            yield from (dwell(size, 0.0), dwell(-size, 0.0))
        for size in DWELLS_Q:
            yield from (dwell(0.0, size), dwell(0.0, -size))
    if campaign.second_pwm:
        yield from (dwell(d, q, 2.0) for d, q in SECOND_PWM)
    if campaign.classical:
        for held in LEVELS:
            yield from (sweep("q", held), sweep("d", held))
        yield sweep("dq", None)
    if campaign.injection:
        yield from (inject(d, q) for d in LEVELS for q in LEVELS)
        if campaign.second_amplitude:
            yield from (inject(d, q, 0.5) for d, q in SMALL)
    if campaign.anchors:
        if campaign.injection:
            yield inject(0.0, 0.5, anchor=True)
        yield dwell(0.67, 0.0, anchor=True)


def _measure(bench: Bench, ask: _Ask, clock: _Clock, rng: np.random.Generator) -> tuple[float, _Rows]:
    if bench.zero_wander_a > 0.0:
        zero_a, zero_b = bench.zero_wander_a * rng.standard_normal(2)
        plant = bench.plant._replace(offset_a=bench.plant.offset_a + zero_a, offset_b=bench.plant.offset_b + zero_b)
        bench = replace(bench, plant=plant)
    if ask.pwm_ratio != 1.0:
        bridge = bench.bridge._replace(half_s=bench.bridge.half_s / ask.pwm_ratio)
        plant = bench.plant._replace(dead_v=bench.plant.dead_v * ask.pwm_ratio)
        bench = replace(bench, plant=plant, bridge=bridge)
    if ask.off:
        start = clock.time_s
        return start, _stretch(bench, OFF, np.zeros((ask.off, 2)), clock, rng)
    settling = int(0.25 * bench.machine.sampling_hz)
    volts = _stretch(bench, CONTROL, np.tile(ask.settle_a, (settling, 1)), clock, rng).voltage
    start = clock.time_s
    if ask.path_a is not None:
        return start, _stretch(bench, CONTROL, ask.path_a, clock, rng)
    assert ask.wave_v is not None
    c, s = np.cos(bench.believed_rad), np.sin(bench.believed_rad)
    mean = volts[-settling // 5 :].mean(axis=0, dtype=np.float64) @ np.array([[c, -s], [s, c]])
    return start, _stretch(bench, OPEN, mean + ask.wave_v, clock, rng)


def _stretch(bench: Bench, mode: int, wanted: Array, clock: _Clock, rng: np.random.Generator) -> _Rows:
    machine, table, count = bench.machine, bench.table, len(wanted)
    bandwidth = 2 * np.pi * 25.0 * max(1.0, machine.resistance_ohm / machine.l_q_h / 300.0)
    inductance = np.array([machine.l_d_h, machine.l_q_h])
    gains = np.concatenate([np.sqrt(2.0) * bandwidth * inductance, bandwidth**2 * inductance])
    current, voltage = np.empty((count, 2), np.float32), np.empty((count, 2), np.float32)
    bus, phases = np.empty(count, np.float32), np.empty((count, 3), np.float32)
    plant = bench.plant._replace(delay_samples=bench.plant.delay_samples + bench.drive_delay_samples)
    noise = rng.standard_normal((count, 6 if bench.bridge.gain_c > 0.0 else 5))
    run(
        plant, table.coefficients, table.low_a, 1.0 / table.step_a, clock.state, clock.memory, np.zeros((5, STATES)),
        clock.time_s, bench.believed_rad, mode, gains, machine.bus_v / np.sqrt(3.0), np.ascontiguousarray(wanted),
        noise, current, voltage, bench.bridge, bus, phases,
    )  # fmt: skip
    clock.time_s += count / machine.sampling_hz
    return _Rows(current, voltage, bus, phases if bench.bridge.gain_c > 0.0 else None)


def _write(path: Path, rows: _Rows) -> str:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {
        "v_alpha": rows.voltage[:, 0], "v_beta": rows.voltage[:, 1],
        "i_alpha": rows.current[:, 0], "i_beta": rows.current[:, 1], "v_dc": rows.bus,
    }  # fmt: skip
    if rows.phases is not None:
        columns |= {f"i_{phase}": rows.phases[:, n] for n, phase in enumerate("abc")}
    schema = pa.schema([pa.field(name, pa.float32(), False) for name in columns])
    pq.write_table(pa.table({n: pa.array(c) for n, c in columns.items()}, schema=schema), path, compression="zstd")
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _manifest(bench: Bench, name: str, segments: list[dict[str, Any]]) -> dict[str, Any]:
    return manifest(bench.machine, bench.drive_delay_samples, name, segments)


def manifest(m: Machine, delay_samples: float, name: str, segments: list[dict[str, Any]]) -> dict[str, Any]:
    """A recording's manifest, which holds nothing of the plant but its nameplate."""
    return {
        "format": "fluxbench-recording",
        "version": 1,
        "name": name,
        "created": "2026-11-21T10:00:00Z",
        "motor": {
            "name": m.name, "pole_pairs": m.pole_pairs, "rated_power_w": m.rated_power_w,
            "rated_voltage_rms_v": m.rated_voltage_rms_v, "rated_current_rms_a": m.rated_current_rms_a,
            "rated_frequency_hz": m.rated_frequency_hz, "rated_speed_rpm": 60.0 * m.rated_frequency_hz / m.pole_pairs,
            "rated_torque_nm": m.rated_torque_nm, "stator_resistance_ohm": m.resistance_ohm,
            "d_inductance_h": m.l_d_h, "q_inductance_h": m.l_q_h, "pm_flux_wb": m.pm_flux_wb,
        },
        "drive": {
            "name": "laboratory", "sampling_frequency_hz": m.sampling_hz, "pwm_frequency_hz": m.sampling_hz,
            "dc_bus_voltage_v": m.bus_v, "voltage_delay_samples": delay_samples,
        },
        "segments": segments,
    }  # fmt: skip
