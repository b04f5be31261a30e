"""Run a plan on a foreign bench, write its recording, and work out what is hidden in it by the plant itself."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from tests.blind.campaign import _Rows, _write, manifest
from tests.blind.foreign.inverter import CHARGE_POINTS
from tests.blind.foreign.iron import Array, flux_of
from tests.blind.foreign.machines import Motor
from tests.blind.foreign.plans import FAST_HZ, PLANS, SLOW_HZ, Bench, Segment
from tests.blind.foreign.plant import CONTROL, COPPER_PER_K, HEAT, OFF, OPEN, PSI, STATES, Plant, run
from tests.blind.foreign.preisach import DIRECTIONS, ROW

SETTLING_S = 0.25
WINDOW_S = 0.01
LOSS_STEP_S = 0.25


@dataclass(frozen=True)
class Rig:
    """A motor on a bench, the drive, the plan, and what the operator believes.

    Attributes
    ----------
    relays, charge, hall : array
        Everett table, charge table and transition of a Hall sensor, where the plant has them.
    lost_rows : float
        Part of the rows that the logger loses without a trace.
    """

    motor: Motor
    plant: Plant
    plan: str
    seed: int
    believed_rad: float = 0.0
    declared_delay: float = 0.0
    relays: Array = field(default_factory=lambda: np.zeros((2, 2)))
    charge: Array = field(default_factory=lambda: np.zeros(CHARGE_POINTS))
    hall: Array = field(default_factory=lambda: np.zeros((2, 4)))
    lost_rows: float = 0.0


@dataclass(frozen=True)
class Captured:
    """One segment as it is captured, and when."""

    segment: Segment
    start_s: float
    believed_rad: float
    current: Array
    voltage: Array


class Drive:
    """The plant's state from segment to segment."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.noise = rig, np.random.default_rng([rig.seed, 1])
        self.y, self.memory = np.zeros(STATES), np.zeros((DIRECTIONS, ROW))
        iron, plate = rig.motor.iron, rig.motor.plate
        self.y[PSI], self.y[PSI + 1] = iron.flux(0.0, 0.0)
        self.time_s = 0.0
        self.loss_w: list[float] = []
        bandwidth = max(1.0, plate.resistance_ohm / plate.l_q_h / 300.0)
        # Saturated iron answers faster: its control is laid out for half of the nameplate's inductances.
        inductance = 0.5 * np.array([plate.l_d_h, plate.l_q_h])
        self.gains = [
            np.concatenate([1.4 * w * inductance, w**2 * inductance])
            for w in (2 * np.pi * FAST_HZ * bandwidth, 2 * np.pi * SLOW_HZ * bandwidth)
        ]

    def stretch(
        self, mode: int, wanted: Array, believed: float, wave: Array | None, ratio: float
    ) -> tuple[Array, Array]:
        """Currents and voltages of a stretch, shape (samples, 2)."""
        rig, rows = self.rig, len(wanted)
        plant = rig.plant._replace(
            delay_samples=rig.plant.delay_samples + rig.declared_delay, dead_v=rig.plant.dead_v * ratio
        )
        current, voltage = np.empty((rows, 2)), np.empty((rows, 2))
        noise = plant.noise_a * self.noise.standard_normal((rows, 3))
        gains = self.gains[0 if wave is None else 1]
        run(
            plant, rig.motor.iron.coefficients, rig.motor.iron.grid, rig.relays, self.memory, rig.charge, rig.hall,
            self.y, believed, mode, gains, np.ascontiguousarray(wanted),
            np.zeros_like(wanted) if wave is None else wave, noise, current, voltage,
        )  # fmt: skip
        self.time_s += rows * plant.sample_s
        power = 1.5 * plant.resistance * np.sum(current**2, axis=1) * (mode != OFF)
        self.loss_w.extend(power.tolist())
        return current, voltage


def captured(rig: Rig, *, silent: bool = False) -> tuple[list[Captured], Drive]:
    """Run the plan; the segments, and the drive in its end. `silent` sensors have neither noise nor quantum."""
    if silent:
        rig = replace(rig, plant=rig.plant._replace(noise_a=0.0, quantum_a=0.0), lost_rows=0.0)
    plate, drive = rig.motor.plate, Drive(rig)
    bench = Bench(plate, rig.motor.span_d, np.random.default_rng([rig.seed, 2]))
    found = []
    for segment in PLANS[rig.plan](bench):
        believed = rig.believed_rad + segment.angle_rad
        if segment.before_s > 0.0:
            rest = np.zeros((round(segment.before_s * plate.sampling_hz), 2))
            drive.stretch(CONTROL, rest, believed, None, 1.0)
        if segment.stage == "gates_off":
            start = drive.time_s
            rows = drive.stretch(OFF, segment.path_a, believed, None, 1.0)
        else:
            settling = np.tile(segment.path_a[0], (round(SETTLING_S * plate.sampling_hz), 1))
            _, volts = drive.stretch(CONTROL, settling, believed, None, segment.pwm_ratio)
            start = drive.time_s
            if segment.wave_v is not None and segment.open_loop:
                c, s = np.cos(believed), np.sin(believed)
                mean = volts[-len(volts) // 5 :].mean(axis=0) @ np.array([[c, -s], [s, c]])
                wanted = np.tile(mean, (len(segment.path_a), 1))
                rows = drive.stretch(OPEN, wanted, believed, segment.wave_v, segment.pwm_ratio)
            else:
                rows = drive.stretch(CONTROL, segment.path_a, believed, segment.wave_v, segment.pwm_ratio)
        found += [
            Captured(segment, start + at, believed, *part) for at, part in _parts(rows, segment, plate.sampling_hz)
        ]
    return found, drive


def _parts(rows: tuple[Array, Array], segment: Segment, hz: float) -> Iterator[tuple[float, tuple[Array, Array]]]:
    """What is captured of a segment: all, or what is before a gap and after it."""
    if segment.gap_s is None:
        yield 0.0, rows
        return
    first, last = (round(at * hz) for at in segment.gap_s)
    yield 0.0, (rows[0][:first], rows[1][:first])
    yield last / hz, (rows[0][last:], rows[1][last:])


def record(rig: Rig, directory: Path, name: str = "bench") -> Path:
    """Run the plan and write the recording; returns its directory."""
    (directory / "captures").mkdir(parents=True, exist_ok=True)
    plate, rng = rig.motor.plate, np.random.default_rng([rig.seed, 3])
    counts: dict[str, int] = {}
    entries: list[dict[str, Any]] = []
    for one in captured(rig)[0]:
        stage = one.segment.stage
        number = counts.get(stage, 0)
        counts[stage] = number + 1
        there = rng.random(len(one.current)) >= rig.lost_rows
        current, voltage = (rows[there].astype(np.float32) for rows in (one.current, one.voltage))
        rows = _Rows(current, voltage, np.full(len(current), plate.bus_v, np.float32), None)
        entries.append(
            {
                "id": f"{stage}-{number:03d}", "stage": stage, "start_s": one.start_s, "samples": len(current),
                "rotor_angle_rad": one.believed_rad, "settings": one.segment.settings,
                "sha256": _write(directory / "captures" / f"{stage}-{number:03d}.parquet", rows),
            }
        )  # fmt: skip
    (directory / "recording.json").write_text(json.dumps(manifest(plate, rig.declared_delay, name, entries), indent=1))
    return directory


@njit(cache=True, nogil=True)
def _flux_along(c: Array, grid: Array, current: Array, psi_d: float, psi_q: float) -> Array:
    """Flux at each of the currents (n, 2), each from the one before."""
    out = np.empty_like(current)
    for k in range(current.shape[0]):
        psi_d, psi_q = flux_of(c, grid, current[k, 0], current[k, 1], psi_d, psi_q)
        out[k, 0], out[k, 1] = psi_d, psi_q
    return out


def measured_truth(rig: Rig) -> dict[str, Any]:
    """What all that is hidden does, to whoever knows the true map and R_s and none of it.

    Returns
    -------
    dict
        `voltage_mv`: rms of the missing voltage in means of 10 ms; `voltage_percent`: of the excitation's;
        `flux_percent`: rms of the flux by the voltage against that of the map, in units of the rated flux, without each
        segment's straight line; `watts`: copper loss in steps of `LOSS_STEP_S` from the start; `rise_percent`: of R_s
        in the end.
    """
    found, drive = captured(rig, silent=True)
    plate, iron = rig.motor.plate, rig.motor.iron
    ts, late = 1.0 / plate.sampling_hz, round(rig.declared_delay)
    window = round(WINDOW_S * plate.sampling_hz)
    missing, excitation, fluxes = [], [], []
    for one in found:
        if one.segment.stage == "gates_off" or len(one.current) < 3 * window:
            continue
        c, s = np.cos(one.believed_rad), np.sin(one.believed_rad)
        turn = np.array([[c, -s], [s, c]])
        current, voltage = one.current[late:] @ turn, one.voltage[: len(one.voltage) - late] @ turn
        flux = _flux_along(iron.coefficients, iron.grid, current, *iron.flux(*current[0]))
        rest = voltage[:-1] - rig.plant.resistance * 0.5 * (current[1:] + current[:-1])
        lag = np.cumsum(rest, axis=0) * ts - (flux[1:] - flux[0])
        whole = len(rest) // window * window
        lost = (rest - np.diff(flux, axis=0) / ts)[:whole].reshape(-1, window, 2).mean(axis=1)
        missing.append(lost.ravel())
        excitation.append(voltage[:whole].ravel())
        if one.segment.stage != "resistance":
            t = np.linspace(-1.0, 1.0, len(lag))
            straight = np.stack([np.ones_like(t), t], axis=1)
            fluxes.append((lag - straight @ np.linalg.lstsq(straight, lag, rcond=None)[0]).ravel())
    volts = float(np.sqrt(np.mean(np.concatenate(missing) ** 2)))
    excited = float(np.sqrt(np.mean(np.concatenate(excitation) ** 2)))
    flux_rms = float(np.sqrt(np.mean(np.concatenate(fluxes) ** 2))) if fluxes else 0.0
    step = round(LOSS_STEP_S * plate.sampling_hz)
    loss = np.array(drive.loss_w)
    steps = loss[: len(loss) // step * step].reshape(-1, step).mean(axis=1)
    return {
        "voltage_mv": 1e3 * volts,
        "voltage_percent": 100.0 * volts / excited,
        "flux_percent": 100.0 * flux_rms / plate.rated_flux_wb,
        "rise_percent": 100.0 * COPPER_PER_K * float(drive.y[HEAT]),
        "watts": [round(float(w), 4) for w in steps],
    }
