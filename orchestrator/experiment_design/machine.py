"""The machine that a plan is rehearsed on: currents of an excitation, and the voltages that they take."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.numerics.types import Array
from protocols import Excitation, GatesOff, Hold, Motor, ProcedureError, Spin, Trapezoid, VoltageSteps


@dataclass(frozen=True)
class Machine:
    """The machine that a plan is rehearsed on.

    Attributes
    ----------
    motor : Motor
    r_s : float
        [ohm]
    magnetics : Magnetics or None
        None: the nameplate's constant inductances.
    """

    motor: Motor
    r_s: float
    magnetics: Magnetics | None = None

    @classmethod
    def of(cls, motor: Motor, procedure: str) -> Machine:
        """The machine of a nameplate; raises `ProcedureError` where that lacks resistance or inductance."""
        for name in ("stator_resistance_ohm", "d_inductance_h"):
            if getattr(motor, name) is None:
                raise ProcedureError(procedure, f"motor.{name}", "missing: a plan is rehearsed by it")
        return cls(motor, motor.stator_resistance_ohm or 0.0)

    def flux(self, i_dq: Array) -> Array:
        """psi (n, 2) without the magnet's own [Wb] at currents (n, 2) [A]."""
        if self.magnetics is not None:
            return self.magnetics.flux_and_inductance(i_dq)[0]
        l_d = self.motor.d_inductance_h or 0.0
        return np.asarray(i_dq * np.array([l_d, self.motor.q_inductance_h or l_d]))

    def ripple(self, i_dq: Array, swing_wb: Array) -> Array:
        """The current (n, 2) that swings the flux by `swing_wb` (n, 2) about an operating point (2,)."""
        step = 1e-3 * max(float(np.abs(i_dq).max()), self.motor.rated_current_a or 1.0)
        ahead, behind = (self.flux(i_dq + side * step * np.eye(2)) for side in (0.5, -0.5))
        return np.asarray(i_dq + swing_wb @ np.linalg.inv((ahead - behind) / step))

    def voltage(self, i_dq: Array, fs: float) -> Array:
        """Voltage (n, 2) that takes a current (n + 1, 2) from each sample to the next [V]."""
        return np.asarray(0.5 * self.r_s * (i_dq[1:] + i_dq[:-1]) + np.diff(self.flux(i_dq), axis=0) * fs)


def current_of(excitation: Excitation, machine: Machine, t: Array) -> Array:
    """The current of an excitation at times t (n,), in the manifest's rotor frame, shape (n, 2) [A]."""
    i_dq = np.tile(np.array(excitation.start_dq_a), (len(t), 1))
    if isinstance(excitation, Hold | GatesOff | Spin):
        return i_dq
    if isinstance(excitation, VoltageSteps):
        return _triangles(excitation, machine, t)
    if isinstance(excitation, Trapezoid):
        corners, values = np.array([0, 1, 3, 5, 7, 8]) / 8, np.array([0, 1, 1, -1, -1, 0])
        swept = excitation.amplitude_a * np.interp(t / excitation.period_s % 1.0, corners, values)
        along = {"d": (1.0, 0.0), "q": (0.0, 1.0), "dq": (math.sqrt(0.5), math.sqrt(0.5))}[excitation.swept_axis]
        return np.asarray(i_dq + swept[:, None] * np.array(along))
    turn = 2.0 * math.pi * excitation.rotation_hz * t
    part = (t * excitation.frequency_hz + 1e-9) % 1.0
    if excitation.waveform == "square":
        wave = np.abs(part - 0.5) * -1.0 + 0.25
    else:
        wave = -np.cos(2.0 * math.pi * part) / (2.0 * math.pi)
    swing = excitation.amplitude_v / excitation.frequency_hz * wave
    return machine.ripple(i_dq[0], swing[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1))


def _triangles(e: VoltageSteps, machine: Machine, t: Array) -> Array:
    """The current of steps of voltage in a motor that does not saturate, shape (n, 2) [A]."""
    out = np.zeros((len(t), 2))
    for axis, (volts, turn_a) in enumerate(((e.voltage_d_v, e.turn_d_a), (e.voltage_q_v, e.turn_q_a))):
        if volts:
            small = 1e-3 * turn_a * np.eye(2)[axis : axis + 1]
            inductance = float((machine.flux(small) - machine.flux(-small))[0, axis]) / (2e-3 * turn_a)
            quarters = volts * t / (4.0 * turn_a * inductance)
            out[:, axis] = turn_a * (1.0 - 4.0 * np.abs((quarters + 0.25) % 1.0 - 0.5))
    return out
