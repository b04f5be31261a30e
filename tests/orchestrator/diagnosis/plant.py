"""A machine on paper for the diagnosis' tests: the flux is prescribed, current and voltage follow from it exactly.

psi is piecewise linear, i = grad H(psi) with the polynomial energy of Jebai, Combes, Malrait, Martin, Rouchon,
and v_k Ts = psi_k+1 - psi_k + R int i dt (Simpson). No code is shared with the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.recording import Recording, SegmentWriter, open_recording, write_manifest
from protocols import Capture, DriveRecord, Manifest, Motor, Segment, SegmentStage

Array = NDArray[np.float64]

FS = 10_000.0
TS = 1.0 / FS
R_S = 4.31
NOISE_A = 0.004


@dataclass(frozen=True)
class Flaws:
    """What the machine suffers from."""

    dead_time_v: float = 0.0
    misalignment_rad: float = 0.0
    drift_a_per_s: float = 0.0
    offset_scatter_a: float = 0.0
    sensor_bend_v: float = 0.0
    noise_correlation: float = 0.0
    jitter_s: float = 0.0
    first_gain: float = 0.0
    third_gain: float = 0.0
    """By how much one of three sensors reads more; where it is not nil, their readings are logged."""
    warming_per_k: float = 0.0
    """Resistance per kelvin of a thermometer that is logged, and that climbs by 12 K as the experiment goes on."""
    second_pwm: bool = False
    """Held currents at twice the PWM frequency too, where dead time takes twice the voltage."""


def current(psi: Array) -> Array:
    """i = grad H(psi), psi without the magnet's flux."""
    x, y = psi.T
    d = x / 0.04325 + 27.0 * x**2 + 6.5 * y**2 + 160.0 * x**3 + 90.0 * x * y**2
    q = y / 0.06905 + 13.0 * x * y + 90.0 * x**2 * y + 180.0 * y**3
    return np.stack([d, q], axis=1)


def flux(target: tuple[float, float]) -> Array:
    """Newton's method for psi(i), with a numerical Jacobian."""
    psi = np.array([0.04 * target[0], 0.06 * target[1]])
    for _ in range(30):
        miss = current(psi[None])[0] - np.array(target)
        jacobian = np.stack(
            [(current((psi + h)[None])[0] - current((psi - h)[None])[0]) / 2e-6 for h in 1e-6 * np.eye(2)], axis=1
        )
        psi = psi - np.linalg.solve(jacobian, miss)
    return psi


def _capture(psi: Array, start_s: float, flaws: Flaws, rng: np.random.Generator) -> Capture:
    """A capture of len(psi) - 1 samples."""
    i, middle = current(psi), current(0.5 * (psi[1:] + psi[:-1]))
    mean = (i[:-1] + 4.0 * middle + i[1:]) / 6.0
    t = start_s + np.arange(len(psi) - 1) * TS
    warmer = 12.0 * (1.0 - np.exp(-t / 4.0))
    v = np.diff(psi, axis=0) / TS + R_S * (1.0 + flaws.warming_per_k * warmer)[:, None] * mean
    c, s = math.cos(flaws.misalignment_rad), math.sin(flaws.misalignment_rad)
    to_stator = np.array([[c, s], [-s, c]])
    i_ab, v_ab, mean_ab = i[:-1] @ to_stator, v @ to_stator, mean @ to_stator
    phases = np.array([[1.0, 0.0], [-0.5, math.sqrt(0.75)], [-0.5, -math.sqrt(0.75)]])
    v_ab = v_ab + flaws.dead_time_v * np.tanh(mean_ab @ phases.T / 0.05) @ phases * (2.0 / 3.0)
    v_ab = v_ab + flaws.sensor_bend_v * np.abs(mean_ab @ phases.T) @ phases * (2.0 / 3.0)
    drift = flaws.drift_a_per_s * t
    drifts = np.stack([drift, drift / math.sqrt(3.0)], axis=1)
    if flaws.offset_scatter_a:
        a, b = rng.normal(0.0, flaws.offset_scatter_a, 2)
        drifts = drifts + np.array([a, (a + 2.0 * b) / math.sqrt(3.0)])
    noise = rng.normal(0.0, NOISE_A, (len(t), 2)) @ np.array([[1.0, 0.6], [0.0, 1.1]])
    if flaws.noise_correlation:
        keep = flaws.noise_correlation
        for k in range(1, len(noise)):
            noise[k] = keep * noise[k - 1] + math.sqrt(1.0 - keep**2) * noise[k]
    late = flaws.jitter_s * rng.normal(0.0, 1.0, len(t)) / TS if flaws.jitter_s else np.zeros(len(t))
    moved = late[:, None] * np.diff(i_ab, axis=0, append=i_ab[-1:])
    read = i_ab + moved + noise + drifts
    logged = {}
    if flaws.first_gain or flaws.third_gain:
        logged["i_abc"] = read @ phases.T * np.array([1.0 + flaws.first_gain, 1.0, 1.0 + flaws.third_gain])
        read = logged["i_abc"] @ phases * (2.0 / 3.0)
    if flaws.warming_per_k:
        logged["temperature_c"] = 22.0 + warmer
    return Capture(
        start_s=start_s, sampling_frequency_hz=FS, i_ab=read, v_ab=v_ab, v_dc=np.full(len(t), 540.0), **logged
    )


def _trapezoid(period: int) -> Array:
    x = np.arange(2 * period + 1) / period % 1.0
    return np.interp(x, [0.0, 0.125, 0.375, 0.625, 0.875, 1.0], [0.0, 1.0, 1.0, -1.0, -1.0, 0.0])


def _plan(flaws: Flaws) -> list[tuple[SegmentStage, dict[str, object], Callable[[], Array]]]:
    plan: list[tuple[SegmentStage, dict[str, object], Callable[[], Array]]] = []
    plan.append((SegmentStage.GATES_OFF, {}, lambda: np.zeros((1201, 2))))
    holds = [(a * x, a * y) for a in (0.1, 0.5, 2.0) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    for point in [*holds, (3.0, 0.0), (0.0, 3.0), (2.0, 0.0)]:
        plan.append((SegmentStage.RESISTANCE, {}, lambda p=point: np.repeat(flux(p)[None], 801, axis=0)))  # type: ignore[misc]
    for point in holds if flaws.second_pwm else []:
        twice: dict[str, object] = {"pwm_frequency_hz": 2.0 * FS}
        plan.append((SegmentStage.RESISTANCE, twice, lambda p=point: np.repeat(flux(p)[None], 801, axis=0)))  # type: ignore[misc]
    for held in (-2.0, 0.0, 2.0):
        for axis in ("q", "d"):
            plan.append((SegmentStage.CLASSICAL, {"swept_axis": axis, "period_s": 0.15}, _sweep(axis, held)))
    plan.append((SegmentStage.CLASSICAL, {"swept_axis": "dq", "period_s": 0.15}, _sweep("dq", 0.0)))
    points = [(a, b, 40.0) for a in (-2.5, 0.0, 2.5) for b in (-2.5, 0.0, 2.5)]
    for d, q, volts in [*points, (1.2, 1.2, 20.0), (-1.2, -1.2, 20.0), (0.0, 0.0, 20.0)]:
        settings: dict[str, object] = {"frequency_hz": 500.0, "rotation_hz": 8.0, "amplitude_v": volts}
        plan.append((SegmentStage.INJECTION, settings, _ripple(d, q, volts)))
    return plan


def _sweep(axis: str, held: float) -> Callable[[], Array]:
    def make() -> Array:
        wave = _trapezoid(1500)
        high = flux((3.0, held) if axis == "d" else (held, 3.0))
        middle = flux((0.0, held) if axis == "d" else (held, 0.0))
        if axis == "dq":
            high, middle = flux((2.1, 2.1)), np.zeros(2)
        return np.asarray(middle + wave[:, None] * (high - middle))

    return make


def _ripple(d: float, q: float, volts: float) -> Callable[[], Array]:
    def make() -> Array:
        k = np.arange(1600)
        wave = np.where(k % 20 < 10, volts, -volts)
        turn = 2 * np.pi * 8.0 * k * TS
        steps = (wave * TS)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        ripple = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        return np.asarray(flux((d, q)) + ripple - ripple.mean(axis=0))

    return make


def record(directory: Path, flaws: Flaws, seed: int = 1) -> Recording:
    """Measure the machine into a recording."""
    rng = np.random.default_rng(seed)
    directory.mkdir(parents=True)
    segments = []
    clock = 0.0
    for number, (stage, settings, psi) in enumerate(_plan(flaws)):
        name = f"{stage.value}-{number:03d}"
        volts = flaws.dead_time_v * float(settings.get("pwm_frequency_hz", FS)) / FS  # type: ignore[arg-type]
        capture = _capture(psi(), clock, replace(flaws, dead_time_v=volts), rng)
        if stage is SegmentStage.GATES_OFF:
            capture = capture.model_copy(update={"v_ab": np.zeros_like(capture.v_ab)})
        with SegmentWriter(directory, name) as writer:
            writer.append(capture)
            written = writer.finish()
        segments.append(
            Segment(
                id=name,
                stage=stage,
                start_s=clock,
                samples=written.samples,
                settings=settings,
                sha256=written.sha256,
            )
        )
        clock += len(capture) * TS + 0.1
    motor = Motor(
        name="on paper",
        pole_pairs=2,
        rated_current_rms_a=1.66,
        stator_resistance_ohm=4.25,
        d_inductance_h=0.04325,
        q_inductance_h=0.06905,
        pm_flux_wb=0.3,
    )
    drive = DriveRecord(name="on paper", sampling_frequency_hz=FS, pwm_frequency_hz=FS, dc_bus_voltage_v=540.0)
    write_manifest(
        directory,
        Manifest(
            format="fluxbench-recording",
            version=1,
            name=directory.name,
            created="2026-01-01T00:00:00Z",
            motor=motor,
            drive=drive,
            segments=tuple(segments),
        ),
    )
    return open_recording(directory)
