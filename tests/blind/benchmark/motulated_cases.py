"""Benches of the third plant: three motors, their experiment, and what is hidden in them."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.benchmark.definition import Row
from tests.blind.benchmark.motulated import Complex, Drive, Saturation, Task, simulate
from tests.blind.benchmark.truths import Hidden, Made
from tests.blind.campaign import _Rows, _write, manifest
from tests.blind.magnetics import Machine

Rng = np.random.Generator
SETTLING, HOLD, SWEEP, INJECTION, OFF = 1500, 1000, 2500, 2000, 3000
"""Samples before a segment, and of one; a sweep has two periods."""
PAUSE_S = 0.05
"""Between segments."""
ORDINARY = (0.05, 0.6)
"""Sizes on an ordinary bench, in units of the typical one."""

PLATES = {
    "joint_48v": Machine(
        "48 V robot joint", 7, 300.0, 26.0, 9.0, 250.0, 0.9, 0.11, 1.1e-4, 1.35e-4, 0.0085, 48.0, 2e4, 1000.0, 0.015,
        4e-3,
    ),
    "pmsm_2k2": Machine(
        "2.2 kW PMSM", 3, 2200.0, 370.0, 4.3, 75.0, 14.0, 3.6, 0.036, 0.051, 0.545, 540.0, 1e4, 500.0, 6e-3, 2e-3
    ),
    "traction_800v": Machine(
        "800 V traction machine of 120 kW", 4, 120e3, 480.0, 150.0, 350.0, 170.0, 0.014, 1.6e-4, 4.2e-4, 0.075, 800.0,
        1e4, 500.0, 0.2, 0.05,
    ),
}  # fmt: skip
"""The 2.2 kW machine has the numbers of motulator's own examples; the other two are made up around their voltage."""


@dataclass(frozen=True)
class Effect:
    """How a size changes the drive: the change, and the number that an answer states of it."""

    build: Callable[[Rng, float, Machine], tuple[dict[str, Any], float]]
    low: float
    high: float


def _sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _rated_a(plate: Machine) -> float:
    return float(np.sqrt(2.0)) * plate.rated_current_rms_a


def _dead_time(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    volts = 0.01 * size * m.bus_v
    return {"dead_v": volts, "dead_knee_a": rng.uniform(0.02, 0.06) * _rated_a(m)}, volts


def _drop(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    volts = size * (0.9 if m.bus_v > 100.0 else 0.3)
    return {"drop_v": volts, "drop_knee_a": rng.uniform(0.005, 0.015) * _rated_a(m)}, volts


def _late(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    late_s = 12e-6 * size * 500.0 / m.injection_hz
    return {"late_samples": late_s * m.sampling_hz}, late_s


def _filter(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    lag_s = 12e-6 * size * 500.0 / m.injection_hz
    return {"filter_s": lag_s}, lag_s


def _gain(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    off = 0.01 * size * _sign(rng)
    return {"gain": (1.0 + off / 2, 1.0 - off / 2)}, off


def _offset(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    a = 0.008 * size * _rated_a(m) * _sign(rng)
    return {"offset_a": (a, a * float(rng.uniform(-1, 1)))}, a


def _bias(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    a = 3e-4 * size * m.bus_v * _sign(rng)
    return {"bias_v": (a, a * float(rng.uniform(-1, 1)))}, a


def _angle(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    angle = float(np.deg2rad(1.5 * size)) * _sign(rng)
    return {"angle_rad": angle}, angle


def _eddy(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    siemens = 0.15 * size / (2 * np.pi * m.injection_hz * m.l_q_h)
    return {"eddy_siemens": siemens}, 1.0 / siemens


def _sag(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    per_watt = 0.006 * size / (1.5 * m.resistance_ohm * m.top_a**2)
    return {"sag_per_watt": per_watt}, per_watt


def _imbalance(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    ohm = 0.03 * size * m.resistance_ohm
    return {"extra_ohm": (ohm, 0.0)}, ohm


def _cubic(rng: Rng, size: float, m: Machine) -> tuple[dict[str, Any], float]:
    cubic = 0.006 * size / m.top_a**2 * _sign(rng)
    return {"cubic_per_a2": cubic}, cubic


HIDDEN: dict[str, Effect] = {
    "dead_time": Effect(_dead_time, 0.2, 1.5),
    "device_drop": Effect(_drop, 0.6, 1.4),
    "voltage_delay": Effect(_late, 0.6, 3.0),
    "current_filter": Effect(_filter, 0.6, 2.0),
    "current_gain_mismatch": Effect(_gain, 0.5, 3.0),
    "current_offset": Effect(_offset, 0.6, 3.0),
    "voltage_bias": Effect(_bias, 0.6, 3.0),
    "rotor_misalignment": Effect(_angle, 0.5, 2.5),
    "eddy_currents": Effect(_eddy, 0.5, 2.0),
    "bus_sag": Effect(_sag, 0.6, 2.0),
    "phase_resistance_imbalance": Effect(_imbalance, 0.5, 2.5),
    "current_nonlinearity": Effect(_cubic, 0.6, 2.0),
}
FOREIGN: dict[str, Callable[[Rng, Machine], dict[str, Any]]] = {
    "even_leg_drop": lambda r, m: {"even_v": r.uniform(2e-3, 5e-3) * m.bus_v, "even_a": _rated_a(m)},
    "sensor_crosstalk": lambda r, m: {"crosstalk": _sign(r) * r.uniform(0.01, 0.03)},
}
"""In no catalogue."""
PAIRS = (("voltage_delay", "current_filter"), ("dead_time", "device_drop"), ("current_offset", "voltage_bias"))


def made(row: Row) -> Made:
    """What a row of the set gives; raises `ModuleNotFoundError` without motulator."""
    import motulator  # noqa: F401

    rng = np.random.default_rng([row.seed, zlib.crc32(f"motulator {row.case}".encode()), row.index])
    plate, drive = draw_drive(rng, row.motor)
    names = list(HIDDEN)
    hidden: list[tuple[str, float | None]] = []
    if row.case in ("single", "left_out"):
        hidden = [(row.without if row.case == "left_out" else names[row.index % len(names)], None)]
    elif row.case == "double":
        hidden = [(str(name), None) for name in rng.choice(names, 2, replace=False)]
        while any({name for name, _ in hidden} == set(pair) for pair in PAIRS):
            hidden = [(str(name), None) for name in rng.choice(names, 2, replace=False)]
    elif row.case == "ordinary":
        hidden = [(name, float(np.exp(rng.uniform(*np.log(ORDINARY))))) for name in names]
    foreign = list(FOREIGN)[row.index % len(FOREIGN)] if row.case == "foreign" else None
    truths: list[Hidden] = []
    for name, relative in hidden:
        effect = HIDDEN[name]
        size = float(np.exp(rng.uniform(np.log(effect.low), np.log(effect.high)))) if relative is None else relative
        changes, value = effect.build(rng, size, plate)
        drive = replace(drive, defects=replace(drive.defects, **changes))
        truths.append(Hidden(name, size, (value, value)))
    if foreign is not None:
        drive = replace(drive, defects=replace(drive.defects, **FOREIGN[foreign](rng, plate)))
    seed = int(rng.integers(2**31))
    return Made(
        record=lambda folder: record(drive, plate, seed, folder),
        plate=plate,
        resistance_ohm=drive.resistance_ohm,
        flux=drive.saturation.flux,
        hidden=truths,
        foreign=foreign,
        twins=PAIRS[:1],
    )


def draw_drive(rng: Rng, motor: str) -> tuple[Machine, Drive]:
    """A motor of this name, some per cent off its nameplate, on a drive without defects."""
    plate = PLATES[motor]
    l_d, l_q = plate.l_d_h * rng.uniform(0.95, 1.05), plate.l_q_h * rng.uniform(0.95, 1.05)
    magnet_wb = plate.pm_flux_wb * rng.uniform(0.97, 1.03)
    top_d = magnet_wb + l_d * plate.top_a
    top_q = l_q * plate.top_a
    # At its largest current the d axis needs this much more, and so on; each by the flux without saturation.
    d, q, cross = rng.uniform(0.05, 0.15), rng.uniform(0.2, 0.6), rng.uniform(0.1, 0.3)
    iron = Saturation(1.0 / l_d, 1.0 / l_q, d / l_d / top_d**4, q / l_q / top_q, cross / l_q / top_d**3, 0.0)
    magnet_a = float(iron.current(np.array([complex(magnet_wb)]))[0].real)
    drive = Drive(
        saturation=replace(iron, magnet_a=magnet_a),
        resistance_ohm=plate.resistance_ohm * float(rng.uniform(0.96, 1.1)),
        pole_pairs=plate.pole_pairs,
        sampling_hz=plate.sampling_hz,
        bus_v=plate.bus_v,
        noise_a=plate.noise_a * float(rng.uniform(0.6, 1.5)),
        quantum_a=plate.quantum_a * float(rng.uniform(0.3, 2.0)),
        believed_rad=float(rng.uniform(-np.pi, np.pi)),
        delay=int(rng.integers(2)),
        tuning_h=(0.7 * plate.l_d_h, 0.7 * plate.l_q_h),
    )
    at_rest = [
        drive.saturation.flux(a, b) for a, b in ((0.0, 0.0), (0.01 * plate.top_a, 0.0), (0.0, 0.01 * plate.top_a))
    ]
    small_d, small_q = ((at_rest[k][k - 1] - at_rest[0][k - 1]) / (0.01 * plate.top_a) for k in (1, 2))
    return replace(
        plate,
        pm_flux_wb=float(f"{magnet_wb:.3g}"),
        l_d_h=float(f"{small_d * rng.uniform(0.95, 1.05):.3g}"),
        l_q_h=float(f"{small_q * rng.uniform(0.95, 1.05):.3g}"),
    ), drive


def plan(plate: Machine) -> list[Task]:
    """Gates off, holds at two PWM frequencies, triangles on d, q and the diagonal, a rotating square wave at points."""
    top, hz = plate.top_a, plate.sampling_hz

    def held(point: complex, samples: int) -> Complex:
        return np.full(samples, point, complex)

    def hold(point: complex, ratio: float = 1.0) -> Task:
        settings: dict[str, Any] = {"current_d_a": point.real, "current_q_a": point.imag}
        if ratio != 1.0:
            settings["pwm_frequency_hz"] = ratio * hz
        return Task("resistance", settings, held(point, HOLD), pwm_ratio=ratio)

    holds = [hold(complex(top * size * sign)) for size in (0.05, 0.12, 0.3, 0.65, 1.0) for sign in (1, -1)]
    holds += [hold(1j * top * size * sign) for size in (0.15, 0.5, 1.0) for sign in (1, -1)]
    holds += [hold(top * point, 2.0) for point in (0.05, -0.05, 0.3, -0.3, 0.65, 1j * 0.5)]
    steps = SWEEP
    triangle = np.interp(np.arange(2 * steps) / steps % 1.0, [0, 0.25, 0.75, 1.0], [0, 1, -1, 0])
    sweeps = []
    for axis, way in (("d", 1.0), ("q", 1j)):
        for level in (-0.9, 0.0, 0.9):
            across = 1j * way * level * (1 if axis == "d" else -1)
            settings = {
                "swept_axis": axis,
                "held_a": level * top,
                "amplitude_a": top,
                "period_s": SWEEP / hz,
                "periods": 2,
            }
            sweeps.append(Task("classical", settings, np.asarray(top * (way * triangle + across), complex)))
    injections = []
    t = np.arange(INJECTION) / hz
    sign = np.where(np.floor(2 * plate.injection_hz * t + 1e-6) % 2 == 0, 1.0, -1.0)
    usual = float(f"{4 * plate.injection_hz * 0.2 * plate.l_d_h * _rated_a(plate):.2g}")
    levels = (-1.0, -0.5, 0.0, 0.5, 1.0)
    points = [(complex(a, b), 1.0) for a in levels for b in levels] + [
        (complex(a, b), 0.5) for a, b in ((-1, 1), (0, 0), (1, -1))
    ]
    for point, part in points:
        settings = {
            "target_d_a": point.real * top, "target_q_a": point.imag * top, "amplitude_v": part * usual,
            "frequency_hz": plate.injection_hz, "rotation_hz": hz / INJECTION, "waveform": "square",
        }  # fmt: skip
        wave = part * usual * sign * np.exp(2j * np.pi * t * hz / INJECTION)
        injections.append(Task("injection", settings, held(point * top, INJECTION), wave))
    return [Task("gates_off", {}, held(0.0, OFF), off=True), *holds, *sweeps, *injections]


def record(drive: Drive, plate: Machine, seed: int, directory: Path) -> Path:
    """Run the experiment and write the recording; returns its directory."""
    (directory / "captures").mkdir(parents=True)
    rng, start_s = np.random.default_rng(seed), 0.0
    entries: list[dict[str, Any]] = []
    counts: dict[str, int] = {}
    tasks = plan(plate)
    for task, (current, voltage) in zip(tasks, simulate(drive, tasks, SETTLING, rng), strict=True):
        start_s += 0.0 if task.off else SETTLING / plate.sampling_hz
        number, count = counts.get(task.stage, 0), len(task.path_a)
        counts[task.stage], name = number + 1, f"{task.stage}-{number:03d}"
        rows = _Rows(_pairs(current), _pairs(voltage), np.full(count, plate.bus_v, np.float32), None)
        entries.append(
            {
                "id": name, "stage": task.stage, "start_s": round(start_s, 6), "samples": count,
                "rotor_angle_rad": drive.believed_rad, "settings": task.settings,
                "sha256": _write(directory / "captures" / f"{name}.parquet", rows),
            }
        )  # fmt: skip
        start_s += count / plate.sampling_hz + PAUSE_S
    content = manifest(plate, float(drive.delay), "benchmark", entries)
    (directory / "recording.json").write_text(json.dumps(content, indent=1))
    return directory


def _pairs(values: Complex) -> Any:
    return np.stack([values.real, values.imag], axis=1).astype(np.float32)
