"""A drive with a locked rotor and one law that no library has, written from the equations alone.

    dpsi/dt = R(-theta) (v - e) - r i - w J psi,    i = grad H(psi) + i_turn

H is the polynomial energy of Jebai, Combes, Malrait, Martin and Rouchon (doi:10.1109/CDC.2014.7040330). Nothing of the
discovery, the diagnosis or the effects is imported.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from tests.blind.campaign import Campaign, _plan, _Rows, _write, manifest
from tests.blind.magnetics import PM400

Array = np.ndarray[Any, np.dtype[np.float64]]

SQRT3 = math.sqrt(3.0)
SUBSTEPS = 4
CONTROL, OPEN, OFF = 0, 1, 2
MAGNET_WB, RESISTANCE_OHM, L_D_H, L_Q_H = 0.30, 4.4, 0.042, 0.067
NOISE_A = 2e-3

(NOTHING, LOG_LEG, SQUARE_LEGS, CROSSTALK, CLIP, RAMP, GAIN_DRIFT, TURN, PLAY, CREEP, FADING_BUS) = range(11)


@dataclass(frozen=True)
class Hidden:
    """A law: where it enters, over what, in which phase, and its constants."""

    law: int
    place: str
    quantity: str
    phase: str
    constants: tuple[float, float]


LAWS: Mapping[str, Hidden] = {
    "logarithm_in_one_leg": Hidden(LOG_LEG, "leg_voltage", "phase_currents", "b", (0.25, 0.2)),
    "square_in_all_legs": Hidden(SQUARE_LEGS, "leg_voltage", "phase_currents", "", (0.12, 0.0)),
    "saturating_crosstalk": Hidden(CROSSTALK, "reading", "next_phase_currents", "a", (0.03, 1.0)),
    "one_sensor_clips": Hidden(CLIP, "reading", "phase_currents", "b", (0.05, 2.0)),
    "joint_loosens": Hidden(RAMP, "resistance", "time", "", (0.3, 20.0)),
    "one_gain_settles": Hidden(GAIN_DRIFT, "reading_gain", "time", "b", (0.02, 15.0)),
    "shorted_turn": Hidden(TURN, "magnetising", "phase_fluxes", "a", (1.2, 4e-4)),
    "sensor_remanence": Hidden(PLAY, "reading", "phase_currents", "", (0.02, 0.03)),
    "brake_creeps": Hidden(CREEP, "angle", "time", "", (0.04, 12.0)),
    "bus_fades": Hidden(FADING_BUS, "voltage_gain", "time", "", (0.02, 18.0)),
}


@njit(cache=True)
def _current(psi_d: float, psi_q: float) -> tuple[float, float]:
    d, q = psi_d - MAGNET_WB, psi_q
    return (
        d / L_D_H + 18.0 * d * d + 900.0 * d**3 + 320.0 * d * q * q,
        q / L_Q_H + 320.0 * d * d * q + 260.0 * q**3,
    )


@njit(cache=True)
def _phases(alpha: float, beta: float) -> tuple[float, float, float]:
    return alpha, 0.5 * (SQRT3 * beta - alpha), -0.5 * (SQRT3 * beta + alpha)


@njit(cache=True)
def _stator(law: int, k: Array, y: Array, theta: float) -> tuple[float, float]:
    """Stator current of the fluxes and the shorted turn's lag in y = (psi_d, psi_q, x)."""
    d, q = _current(y[0], y[1])
    c, s = math.cos(theta), math.sin(theta)
    alpha = c * d - s * q
    if law == TURN:
        alpha += 2.0 / 3.0 * k[0] * (c * y[0] - s * y[1] - y[2])
    return alpha, s * d + c * q


@njit(cache=True)
def _rates(law: int, k: Array, y: Array, v_alpha: float, v_beta: float, t: float, believed: float, out: Array) -> None:
    theta, turning = believed, 0.0
    if law == CREEP:
        theta += k[0] * (1.0 - math.exp(-t / k[1]))
        turning = k[0] / k[1] * math.exp(-t / k[1])
    alpha, beta = _stator(law, k, y, theta)
    r = RESISTANCE_OHM
    if law == RAMP:
        r += k[0] * max(t / k[1] - 1.0, 0.0)
    if law == FADING_BUS:
        v_alpha *= 1.0 - k[0] * (1.0 - math.exp(-t / k[1]))
        v_beta *= 1.0 - k[0] * (1.0 - math.exp(-t / k[1]))
    a, b, c = _phases(alpha, beta)
    e_a = e_b = e_c = 0.0
    if law == LOG_LEG:
        e_b = k[0] * math.copysign(math.log1p(abs(b) / k[1]), b)
    elif law == SQUARE_LEGS:
        e_a, e_b, e_c = k[0] * a * a, k[0] * b * b, k[0] * c * c
    u_alpha = v_alpha - r * alpha - (2.0 * e_a - e_b - e_c) / 3.0
    u_beta = v_beta - r * beta - (e_b - e_c) / SQRT3
    cos, sin = math.cos(theta), math.sin(theta)
    out[0] = cos * u_alpha + sin * u_beta + turning * y[1]
    out[1] = cos * u_beta - sin * u_alpha - turning * y[0]
    out[2] = (cos * y[0] - sin * y[1] - y[2]) / k[1] if law == TURN else 0.0


@njit(cache=True)
def _read(law: int, k: Array, a: float, b: float, t: float, cores: Array) -> tuple[float, float]:
    """Both sensors' readings without noise."""
    if law == CROSSTALK:
        return a + k[0] * math.tanh(b / k[1]), b
    if law == CLIP:
        return a, b - k[0] * math.copysign(max(abs(b) - k[1], 0.0), b)
    if law == GAIN_DRIFT:
        return a, b * (1.0 + k[0] * (1.0 - math.exp(-t / k[1])))
    if law == PLAY:
        cores[0] = min(max(cores[0], a - k[1]), a + k[1])
        cores[1] = min(max(cores[1], b - k[1]), b + k[1])
        return a + k[0] / k[1] * (a - cores[0]), b + k[0] / k[1] * (b - cores[1])
    return a, b


@njit(cache=True)
def _run(
    law: int, k: Array, y: Array, cores: Array, mode: int, gains: Array, pull: Array, believed: float, start: float,
    ts: float, wanted: Array, noise: Array, i_out: Array, v_out: Array,
) -> None:  # fmt: skip
    """Row by row: the current read at t_k, and the voltage held until t_k+1 by classical Runge-Kutta."""
    cos, sin = math.cos(believed), math.sin(believed)
    h = ts / SUBSTEPS
    rates, z = np.zeros((4, 3)), np.zeros(3)
    for n in range(wanted.shape[0]):
        t = start + n * ts
        a = b = 0.0
        if mode != OFF:
            theta = believed + (k[0] * (1.0 - math.exp(-t / k[1])) if law == CREEP else 0.0)
            alpha, beta = _stator(law, k, y, theta)
            a, b, _ = _phases(alpha, beta)
        a, b = _read(law, k, a, b, t, cores)
        a, b = a + noise[n, 0], b + noise[n, 1]
        alpha, beta = a, (a + 2.0 * b) / SQRT3
        i_out[n, 0], i_out[n, 1] = alpha, beta
        v_d = v_q = 0.0
        if mode == CONTROL:
            off_d = wanted[n, 0] - cos * alpha - sin * beta
            off_q = wanted[n, 1] - cos * beta + sin * alpha
            pull[0] += gains[2] * ts * off_d
            pull[1] += gains[3] * ts * off_q
            v_d, v_q = gains[0] * off_d + pull[0], gains[1] * off_q + pull[1]
        elif mode == OPEN:
            v_d, v_q = wanted[n, 0], wanted[n, 1]
        v_alpha, v_beta = cos * v_d - sin * v_q, sin * v_d + cos * v_q
        v_out[n, 0], v_out[n, 1] = v_alpha, v_beta
        if mode == OFF:
            continue
        for m in range(SUBSTEPS):
            now = t + m * h
            _rates(law, k, y, v_alpha, v_beta, now, believed, rates[0])
            for j in range(3):
                z[j] = y[j] + 0.5 * h * rates[0, j]
            _rates(law, k, z, v_alpha, v_beta, now + 0.5 * h, believed, rates[1])
            for j in range(3):
                z[j] = y[j] + 0.5 * h * rates[1, j]
            _rates(law, k, z, v_alpha, v_beta, now + 0.5 * h, believed, rates[2])
            for j in range(3):
                z[j] = y[j] + h * rates[2, j]
            _rates(law, k, z, v_alpha, v_beta, now + h, believed, rates[3])
            for j in range(3):
                y[j] += h / 6.0 * (rates[0, j] + 2.0 * rates[1, j] + 2.0 * rates[2, j] + rates[3, j])


class _Bench:
    """The plant's state from segment to segment."""

    def __init__(self, law: int, constants: tuple[float, float], believed: float, seed: int) -> None:
        self.law, self.k, self.believed = law, np.array(constants), believed
        self.rng = np.random.default_rng(seed)
        self.y, self.cores, self.pull = np.array([MAGNET_WB, 0.0, 0.0]), np.zeros(2), np.zeros(2)
        self.y[2] = MAGNET_WB * math.cos(believed)
        self.time_s = 0.0
        width = 2.0 * math.pi * 25.0
        inductance = np.array([L_D_H, L_Q_H])
        self.gains = np.concatenate([math.sqrt(2.0) * width * inductance, width**2 * inductance])

    def stretch(self, mode: int, wanted: Array) -> tuple[Array, Array]:
        """Currents and voltages in the stator frame, shape (n, 2)."""
        rows, ts = len(wanted), 1.0 / PM400.sampling_hz
        current, voltage = np.empty((rows, 2)), np.empty((rows, 2))
        noise = NOISE_A * self.rng.standard_normal((rows, 2))
        _run(
            self.law, self.k, self.y, self.cores, mode, self.gains, self.pull, self.believed, self.time_s, ts,
            np.ascontiguousarray(wanted, dtype=np.float64), noise, current, voltage,
        )  # fmt: skip
        self.time_s += rows * ts
        return current, voltage


def record(directory: Path, hidden: Hidden | None, seed: int = 0) -> Path:
    """Run the default campaign in short and write its recording; returns its directory."""
    (directory / "captures").mkdir(parents=True, exist_ok=True)
    law, constants = (hidden.law, hidden.constants) if hidden is not None else (NOTHING, (0.0, 1.0))
    believed = float(np.random.default_rng([seed, 1]).uniform(-math.pi, math.pi))
    bench = _Bench(law, constants, believed, seed)
    counts: dict[str, int] = {}
    segments: list[dict[str, Any]] = []
    for ask in _plan(PM400, Campaign()):
        number = counts.get(ask.stage, 0)
        counts[ask.stage] = number + 1
        if ask.off:
            start, (current, voltage) = bench.time_s, bench.stretch(OFF, np.zeros((ask.off, 2)))
        else:
            settling = np.tile(ask.settle_a, (int(0.25 * PM400.sampling_hz), 1))
            _, volts = bench.stretch(CONTROL, settling)
            start = bench.time_s
            if ask.path_a is not None:
                current, voltage = bench.stretch(CONTROL, ask.path_a)
            else:
                c, s = math.cos(believed), math.sin(believed)
                mean = volts[-len(volts) // 5 :].mean(axis=0) @ np.array([[c, -s], [s, c]])
                current, voltage = bench.stretch(OPEN, mean + ask.wave_v)
        single = (current.astype(np.float32), voltage.astype(np.float32))
        rows = _Rows(*single, np.full(len(current), PM400.bus_v, np.float32), None)
        name = f"{ask.stage}-{number:03d}"
        segments.append(
            {
                "id": name, "stage": ask.stage, "start_s": start, "samples": len(current),
                "rotor_angle_rad": believed, "settings": ask.settings,
                "sha256": _write(directory / "captures" / f"{name}.parquet", rows),
            }
        )  # fmt: skip
    text = json.dumps(manifest(PM400, 0.0, "hidden-law", segments), indent=1)
    (directory / "recording.json").write_text(text, encoding="utf-8")
    return directory
