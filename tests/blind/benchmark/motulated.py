"""A third plant: motulator's machine model behind an inverter and sensors of this module's own.

The machine is `motulator.drive.model.SynchronousMachine` (Aalto University, MIT), whose equations are

    dpsi/dt = u - R_s i(psi) - j w psi,  i(psi) the machine's own saturation,

here at standstill. All segments of an experiment are simulated at once, as arrays: each begins at rest, so nothing but
the drive's settings goes from one to the next. No code of the other plants is used but that which writes the files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[np.float64]]
Complex = np.ndarray[Any, np.dtype[np.complex128]]

STEPS = 2
"""Runge-Kutta steps a sample, beside the one until a late voltage acts."""
BANDWIDTH_HZ = 30.0
PHASES = np.exp(-2j * np.pi / 3 * np.arange(3))[:, None]
"""Re(PHASES * i) are the currents of the phases."""


@dataclass(frozen=True)
class Saturation:
    """i_d = (1/L_d + s_d |psi_d|^4 + c |psi_d| psi_q^2 / 2) psi_d - i_f, and alike on q; from an energy.

    Source of the form: M. Hinkkanen, P. Pescetto, E. Molsa, S. E. Saarakkala, G. Pellegrino, R. Bojoi, IEEE Trans.
    Ind. Appl. 53 (2017), doi:10.1109/TIA.2016.2644624; a magnet is a constant current i_f beside it.
    """

    per_h_d: float
    per_h_q: float
    steep_d: float
    steep_q: float
    cross: float
    magnet_a: float

    def current(self, psi: Complex) -> Complex:
        """Stator current [A] at a flux [Wb], both d + jq."""
        x, y = np.abs(psi.real), np.abs(psi.imag)
        square = x * x
        d = (self.per_h_d + self.steep_d * square * square + 0.5 * self.cross * x * y * y) * psi.real - self.magnet_a
        q = (self.per_h_q + self.steep_q * y + self.cross / 3.0 * x * square) * psi.imag
        return np.asarray(d + 1j * q)

    def flux(self, i_d: float, i_q: float) -> tuple[float, float]:
        """psi [Wb] at a current [A], by Newton's method."""
        psi = np.array([(i_d + self.magnet_a) / self.per_h_d, i_q / self.per_h_q]) * 0.7
        for _ in range(60):
            off = self.current(np.array([complex(*psi)]))[0] - complex(i_d, i_q)
            columns = []
            for k in range(2):
                step = np.zeros(2)
                step[k] = 1e-6 * max(abs(psi[k]), 1e-4)
                moved = self.current(np.array([complex(*(psi + step)), complex(*(psi - step))]))
                columns.append((moved[0] - moved[1]) / (2 * step[k]))
            jacobian = np.array([[c.real for c in columns], [c.imag for c in columns]])
            change = np.linalg.solve(jacobian, [off.real, off.imag])
            psi = psi - change
            if np.abs(change).max() < 1e-13:
                break
        return float(psi[0]), float(psi[1])


@dataclass(frozen=True)
class Defects:
    """What is wrong with the drive; zero is absent. Volts, amperes, seconds, radians."""

    dead_v: float = 0.0
    dead_knee_a: float = 1.0
    drop_v: float = 0.0
    drop_knee_a: float = 1.0
    bias_v: tuple[float, float] = (0.0, 0.0)
    late_samples: float = 0.0
    """Below one."""
    sag_per_watt: float = 0.0
    gain: tuple[float, float] = (1.0, 1.0)
    offset_a: tuple[float, float] = (0.0, 0.0)
    cubic_per_a2: float = 0.0
    filter_s: float = 0.0
    angle_rad: float = 0.0
    eddy_siemens: float = 0.0
    extra_ohm: tuple[float, float] = (0.0, 0.0)
    """Of phases a and b."""
    even_v: float = 0.0
    """Foreign: each leg loses this at the rated current, by the square of its current."""
    even_a: float = 1.0
    crosstalk: float = 0.0
    """Foreign: part of phase b's current that sensor a reads."""


@dataclass(frozen=True)
class Drive:
    """Machine, inverter and sensors.

    Attributes
    ----------
    believed_rad : float
        The rotor's angle as the operator believes it.
    delay : int
        Samples by which each command acts late, and the drive says so.
    """

    saturation: Saturation
    resistance_ohm: float
    pole_pairs: int
    sampling_hz: float
    bus_v: float
    noise_a: float
    quantum_a: float
    believed_rad: float
    delay: int
    tuning_h: tuple[float, float]
    """Inductances that the current control is laid out for."""
    defects: Defects = field(default_factory=Defects)


@dataclass(frozen=True)
class Task:
    """One segment: set-points of the control in its believed dq frame, or a voltage on top of where these settled.

    Attributes
    ----------
    path_a : array (samples,), complex
    wave_v : array (samples,), complex, or None
    pwm_ratio : float
        Its PWM frequency over the usual one.
    off : bool
        Whether the gates are off.
    """

    stage: str
    settings: dict[str, Any]
    path_a: Complex
    wave_v: Complex | None = None
    pwm_ratio: float = 1.0
    off: bool = False


def simulate(
    drive: Drive, tasks: Sequence[Task], settling: int, rng: np.random.Generator
) -> list[tuple[Complex, Complex]]:
    """Read currents and commanded voltages of each task, stator frame, shape (samples,); all tasks at once."""
    from motulator.drive.model import SynchronousMachine
    from motulator.drive.utils import SynchronousMachinePars

    count, longest = len(tasks), max(len(task.path_a) for task in tasks)
    at_rest = complex(*drive.saturation.flux(0.0, 0.0))
    machine = SynchronousMachine(
        SynchronousMachinePars(n_p=drive.pole_pairs, R_s=drive.resistance_ohm),
        i_s=_Remembering(drive.saturation),
        psi_s0=at_rest,
    )
    off, injected = np.array([task.off for task in tasks]), np.array([task.wave_v is not None for task in tasks])
    bench = _Bench(drive, machine, np.array([task.pwm_ratio for task in tasks]), off, at_rest)
    path, wave = np.empty((settling + longest, count), complex), np.zeros((longest, count), complex)
    for n, task in enumerate(tasks):
        path[:settling, n], path[settling:, n] = task.path_a[0], task.path_a[-1]
        path[settling : settling + len(task.path_a), n] = task.path_a
        if task.wave_v is not None:
            wave[: len(task.wave_v), n] = task.wave_v
    turn, (straight, summed) = np.exp(1j * drive.believed_rad), _gains(drive)
    noise = drive.noise_a * rng.standard_normal((settling + longest, 2, count))
    limit, integral = drive.bus_v / np.sqrt(3.0), np.zeros(count, complex)
    pending = [np.zeros(count, complex)] * (drive.delay + 1)
    currents, voltages = np.empty((longest, count), complex), np.empty((longest, count), complex)
    for k in range(settling + longest):
        read = bench.read(noise[k])
        error = path[k] - read * np.conj(turn)
        rise = (summed.real * error.real + 1j * summed.imag * error.imag) / drive.sampling_hz
        held = injected & (k >= settling)
        integral = integral + np.where(held | off, 0.0, rise)
        command = integral + np.where(held | off, 0.0, straight.real * error.real + 1j * straight.imag * error.imag)
        if k >= settling:
            command = command + wave[k - settling]
        command = turn * command * np.minimum(1.0, limit / np.maximum(np.abs(command), 1e-12))
        if k >= settling:
            currents[k - settling], voltages[k - settling] = read, command
        pending.append(command)
        bench.advance(pending[-1 - drive.delay], pending[-2 - drive.delay])
        pending = pending[-drive.delay - 2 :]
    return [(currents[: len(task.path_a), n], voltages[: len(task.path_a), n]) for n, task in enumerate(tasks)]


class _Remembering:
    """The current of a flux, for which motulator's machine asks several times in a row."""

    def __init__(self, saturation: Saturation) -> None:
        self._saturation = saturation
        self._last: tuple[Any, Any] = (None, None)

    def __call__(self, psi: Any) -> Any:
        if psi is not self._last[0]:
            self._last = psi, self._saturation.current(psi)
        return self._last[1]


def _gains(drive: Drive) -> tuple[complex, complex]:
    """Proportional and integral gain, each d + jq."""
    l_d, l_q = drive.tuning_h
    w = 2 * np.pi * max(BANDWIDTH_HZ, drive.resistance_ohm / l_q / 10.0)
    return complex(1.4 * w * l_d, 1.4 * w * l_q), complex(w * w * l_d, w * w * l_q)


class _Bench:
    """The machine with what surrounds it, from sample to sample."""

    def __init__(self, drive: Drive, machine: Any, pwm_ratio: Array, off: Any, at_rest: complex) -> None:
        self.drive, self.machine, self.pwm_ratio, self.off, self.at_rest = drive, machine, pwm_ratio, off, at_rest
        self.turn = np.exp(1j * (drive.believed_rad + drive.defects.angle_rad))
        machine.state.psi_s = np.full(len(pwm_ratio), at_rest)
        machine.state.exp_j_theta_m = self.turn
        machine.inp.w_M = 0.0
        self.lagging = np.zeros(len(pwm_ratio), complex)
        self.eddy = np.zeros(len(pwm_ratio), complex)

    def winding(self) -> Complex:
        """Current of the terminals in the stator frame: the machine's, and what its iron takes beside it."""
        return np.asarray((self.machine.i_s + self.eddy) * self.turn)

    def advance(self, command: Complex, before: Complex) -> None:
        """One sample under a command, which until it is late enough is the one before."""
        late, sample_s = self.drive.defects.late_samples, 1.0 / self.drive.sampling_hz
        if late > 0.0:
            self._step(before, late * sample_s)
        for _ in range(STEPS):
            self._step(command, (1.0 - late) * sample_s / STEPS)

    def _step(self, command: Complex, h: float) -> None:
        machine, psi = self.machine, self.machine.state.psi_s
        slopes: list[Complex] = []
        for part in (0.0, 0.5, 0.5, 1.0):
            machine.state.psi_s = psi + part * h * slopes[-1] if slopes else psi
            machine.set_outputs(None)
            machine.inp.u_ss = self._terminal(command)
            slopes.append(machine.rhs()[0])
        rise = (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3]) / 6
        machine.state.psi_s = np.where(self.off, self.at_rest, psi + h * rise)
        d = self.drive.defects
        if d.eddy_siemens > 0.0:
            self.eddy = np.where(self.off, 0.0, d.eddy_siemens * rise)
        fade = np.exp(-h / d.filter_s) if d.filter_s > 0.0 else 0.0
        now = self.winding()
        self.lagging = now + (self.lagging - now) * fade

    def _terminal(self, command: Complex) -> Complex:
        """The voltage at the machine: what the inverter loses in each leg, and its link."""
        d, current = self.drive.defects, self.winding()
        phases = np.real(PHASES * current)
        loss = d.dead_v * self.pwm_ratio * _saturating(phases / d.dead_knee_a, 3.0)
        loss = loss + d.drop_v * _saturating(phases / d.drop_knee_a, 1.5) + d.even_v * (phases / d.even_a) ** 2
        loss[0] += d.bias_v[0] + d.extra_ohm[0] * phases[0]
        loss[1] += d.bias_v[1] + d.extra_ohm[1] * phases[1]
        loss[2] -= d.bias_v[0] + d.bias_v[1]
        scale = 1.0 - d.sag_per_watt * 1.5 * np.real(command * np.conj(current))
        volts = scale * command - 2.0 / 3.0 * np.sum(np.conj(PHASES) * loss, axis=0)
        # The eddy currents pass the winding's resistance, too; the machine's model knows of its own current alone.
        return np.asarray(volts - self.drive.resistance_ohm * self.eddy * self.turn)

    def read(self, noise: Array) -> Complex:
        """What two sensors say of phases a and b."""
        d = self.drive.defects
        current = self.lagging if d.filter_s > 0.0 else self.winding()
        phases = np.real(PHASES * current)[:2]
        crossed = phases[0] + d.crosstalk * phases[1], phases[1]
        read = []
        for n, phase in enumerate(crossed):
            value = d.gain[n] * (phase + d.cubic_per_a2 * phase**3) + d.offset_a[n] + noise[n]
            quantum = self.drive.quantum_a
            read.append(quantum * np.round(value / quantum) if quantum > 0.0 else value)
        return np.asarray(read[0] + 1j * (read[0] + 2 * read[1]) / np.sqrt(3.0))


def _saturating(x: Array, power: float) -> Array:
    """An odd step of height one, the sharper the higher the power."""
    return np.asarray(x / (1.0 + np.abs(x) ** power) ** (1.0 / power))
