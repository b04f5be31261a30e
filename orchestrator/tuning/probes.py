"""What an effect does to a drive at rest, read off its response to known signals; knows no effect by name.

An effect gets currents, voltages and angles through its contract (`protocols.Effect.correct`):

========= ============================================================= ===============================================
probe     signals                                                       read off
========= ============================================================= ===============================================
holds     constant currents, one phase without any, two bus voltages    gain and offset of readings, lost voltage, bias
triangles current, and voltage, rise and fall slowly                    their group delays
angles    no current, the rotor all around                              angle of the d axis
courses   triangles, slow and fast, beside holds of the same values     what depends on earlier currents or voltages
========= ============================================================= ===============================================

With i_a = 0 and i_b = -i_c = x, the legs lose e(x) and e(-x) = -e(x): a vector of length 2/sqrt(3) e(x) along beta.
The even part of the losses is a bias. Voltages of effects other than the inverter's are no loss.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.corrections import apply_effect
from orchestrator.diagnosis.reporting.motor_model import magnetics_of
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.numerics.frames import from_phases, inductance_to_ab, to_ab, to_dq, to_phases
from orchestrator.numerics.types import Array
from protocols import DriveRecord, EffectLayer, MotorModel, RealArray, SignalBatch, Signals

TABLE_POINTS = 401
"""Currents of the table of lost voltages: a knee of a hundredth of the largest current has two on each side."""
LOWER_BUS_RATIO = 0.9
"""Bus voltage of the second probe over the nominal one: mains may fall by 10 % (IEC 60038)."""
HOLD_ROWS = 8
"""Rows of a held current: an effect that averages over neighbouring rows has some on both sides of the middle."""
RAMP_ROWS = 4096
"""Rows of a slow rise: lags of up to a hundred rows have settled in its middle."""
FAST_RAMP_ROWS = 128
"""Rows of a fast rise: that of a motor at 40 Hz electrical where the drive samples at 10 kHz."""
HELD_PER_RAMP = 16
"""Values in the middle half of a rise, and of a fall, that are also held."""
RAMP_VOLTAGE_RATIO = 0.05
"""Height of the voltage's triangle over the bus voltage: the duties stay near one half."""
BACK_EMF_RATIO = 0.2
"""Voltage beside that of R_s over the bus voltage, as of a turning motor's magnets."""
GROWS_WITH_VOLTAGE = 1.5
"""Growth of a reading's change from half the voltage to the whole: 2 in proportion to it, 1 by its direction alone."""
PROBED_ANGLES = 24
"""Angles of a turn at which the d axis is probed: harmonics of a turn up to the 23rd average out."""
LATE_S = 3600.0
"""Second instant of the probes [s]: an effect that differs an hour later drifts."""
TRACE_RATIO = 1e-6
"""Change relative to largest current, bus voltage or a radian below which an effect leaves no trace."""
TRACE_DELAY_S = 1e-9
"""Delay below which an effect leaves no trace [s]: a hundredth of a timer's step."""
SIGMAS_OF_INTERVAL = 1.96
"""Half a 95 % interval in standard deviations."""
DIRECTIONS: Array = from_phases(np.array([[0.0, 1.0, -1.0], [-1.0, 0.0, 1.0], [1.0, -1.0, 0.0]]))
"""Current vectors at which one phase has none and the others +-1 A, shape (3, 2) [A]."""


@dataclass(frozen=True)
class Response:
    """What one effect, or several one after the other, do to a drive's readings and commands.

    Attributes
    ----------
    gain : array, shape (2, 2)
    offset_a : array, shape (2,)
        i_ab true = gain @ i_ab read + offset.
    lost_v, lost_low_bus_v : array, shape (k,)
        Voltage lost in a leg at each current of the table, at the nominal and at the lower bus voltage [V]; odd.
    bias_v : array, shape (2,)
        Voltage lost at every current [V].
    angle_rad : float
        Turn of the d axis.
    voltage_delay_s, current_delay_s : float
        Delay of the voltage, and of the readings.
    lost_variance : array, shape (k,); bias_variance, delay_variance : float
        Variances of `lost_v`, of the length of `bias_v` and of both delays' sum.
    outside_ratio : float
        Largest part of a change (rms) that the numbers above do not describe; of a single effect.
    """

    gain: Array
    offset_a: Array
    lost_v: Array
    lost_low_bus_v: Array
    bias_v: Array
    angle_rad: float
    voltage_delay_s: float
    current_delay_s: float
    lost_variance: Array
    bias_variance: float = 0.0
    delay_variance: float = 0.0
    outside_ratio: float = 0.0

    @property
    def leaves_trace(self) -> bool:
        """Whether anything is done."""
        changes = (self.gain - np.eye(2), self.offset_a, self.lost_v, self.bias_v, self.angle_rad)
        delays = (self.voltage_delay_s, self.current_delay_s)
        return any(bool(np.any(change)) for change in (*changes, *delays))

    @property
    def delay_s(self) -> float:
        """Delay of the voltage plus that of the readings."""
        return self.voltage_delay_s + self.current_delay_s

    def followed_by(self, later: Response) -> Response:
        """Both effects, one after the other: readings are mapped in turn, all else adds up."""
        mapped: dict[str, Any] = {
            "gain": later.gain @ self.gain,
            "offset_a": later.gain @ self.offset_a + later.offset_a,
        }
        names = [f.name for f in dataclasses.fields(self) if f.name not in mapped]
        return Response(**mapped, **{name: getattr(self, name) + getattr(later, name) for name in names})

    def with_variances(self, ends: Sequence[tuple[Response, Response]]) -> Response:
        """With variances, from the responses at both ends of each parameter's 95 % interval."""
        per_sigma = 0.5 / SIGMAS_OF_INTERVAL

        def variances(name: str) -> list[Array]:
            return [(per_sigma * (getattr(high, name) - getattr(low, name))) ** 2 for low, high in ends]

        return dataclasses.replace(
            self,
            lost_variance=sum(variances("lost_v"), np.zeros_like(self.lost_v)),
            bias_variance=float(np.sum(variances("bias_v"))),
            delay_variance=float(np.sum(variances("delay_s"))),
        )


class Course(NamedTuple):
    """What a response, which knows no history, lacks on a rise and fall."""

    rise_s: float
    """From one end to the other [s]."""
    ratio: float
    """rms of what is lacking over that of what the effect changes, of current or voltage, whichever is larger."""


class Probes:
    """Known signals of a drive at rest, and what effects make of them.

    Parameters
    ----------
    model : MotorModel
        Its flux and inductance are in the signals, for effects that depend on them.
    drive : DriveRecord
        The one of the recording: its sampling and PWM frequencies, and the nominal bus voltage.
    current_a : float
        Largest phase current [A].
    pwm_frequency_hz : float, optional
        Of the probes [Hz]; by default the drive's.
    clarke_of_three : bool or None
        Whether current vectors are computed from three sensors.

    Attributes
    ----------
    current_a : array, shape (k,)
        Phase currents of the table, evenly spaced [A].
    bus_v, low_bus_v : float
        Bus voltages of the holds [V].
    """

    def __init__(
        self,
        model: MotorModel,
        drive: DriveRecord,
        current_a: float,
        *,
        pwm_frequency_hz: float | None = None,
        clarke_of_three: bool | None = None,
    ) -> None:
        self.current_a: Array = np.linspace(-current_a, current_a, TABLE_POINTS)
        self.bus_v = drive.dc_bus_voltage_v
        self.low_bus_v = LOWER_BUS_RATIO * self.bus_v
        self._model, self._drive, self._of_three = model, drive, clarke_of_three
        self._pwm_hz = pwm_frequency_hz or drive.pwm_frequency_hz or drive.sampling_frequency_hz
        self._magnetics: Magnetics = magnetics_of(model.magnetics)

    @property
    def none(self) -> Response:
        """The response without any effect."""
        zeros = np.zeros_like(self.current_a)
        return Response(np.eye(2), np.zeros(2), zeros, zeros, np.zeros(2), 0.0, 0.0, 0.0, zeros)

    def response(self, term: EffectTerm) -> Response:
        """What an effect does; raises `PluginError` where it fails."""
        holds, low_holds = self._both_holds
        answer, low_answer = apply_effect(holds, term).signals, apply_effect(low_holds, term).signals
        gain, offset, curved = _affine(_middle(holds.i_ab), _middle(answer.i_ab))
        of_legs = float(term.candidate.effect.layer is EffectLayer.INVERTER)
        lost, bias, unlike = self._legs(of_legs * _middle(holds.v_ab - answer.v_ab))
        low_lost, _, _ = self._legs(of_legs * _middle(low_holds.v_ab - low_answer.v_ab))
        angle, uneven = self._angle(term)
        of_current, of_voltage = self._delays(term)
        volts = TRACE_RATIO * self.bus_v
        return Response(
            gain=np.eye(2) + without_rounding(gain - np.eye(2), TRACE_RATIO),
            offset_a=without_rounding(offset, TRACE_RATIO * self.current_a[-1]),
            lost_v=without_rounding(lost, volts),
            lost_low_bus_v=without_rounding(low_lost, volts),
            bias_v=without_rounding(bias, volts),
            angle_rad=angle if abs(angle) > TRACE_RATIO else 0.0,
            # A corrected reading is ahead of the one that lags; a corrected command is behind the one that was given.
            voltage_delay_s=-of_voltage if abs(of_voltage) > TRACE_DELAY_S else 0.0,
            current_delay_s=of_current / float(gain[0, 0]) if abs(of_current) > TRACE_DELAY_S else 0.0,
            lost_variance=np.zeros_like(lost),
            outside_ratio=max(curved, unlike, uneven),
        )

    def courses(self, term: EffectTerm, response: Response) -> tuple[Course, Course]:
        """What an effect does on a slow and on a fast rise and fall beside what it does to the same values held, and
        to the readings and voltages that the response's delays shift; raises `PluginError` where it fails."""
        slow, fast = (self._course(term, response, rows) for rows in (RAMP_ROWS, FAST_RAMP_ROWS))
        return slow, fast

    def _course(self, term: EffectTerm, response: Response, rise: int) -> Course:
        flank = np.linspace(rise // 4, 3 * rise // 4, HELD_PER_RAMP, dtype=np.intp)
        at = np.concatenate([flank, 2 * rise - 1 - flank])
        sign = np.repeat([1.0, -1.0], HELD_PER_RAMP)[:, None]
        rise_s = rise / self._drive.sampling_frequency_hz
        leads = {"i_ab": response.gain[0, 0] * response.current_delay_s, "v_ab": -response.voltage_delay_s}
        ratios = []
        for moving in self._triangles_of(rise):
            i_ab, v_ab = (np.repeat(x[at], HOLD_ROWS, axis=0) for x in (moving.i_ab, moving.v_ab))
            held = _holds_of(self._signals(i_ab, v_ab, self.bus_v))
            after, settled = apply_effect(moving, term).signals, apply_effect(held, term).signals
            for name, lead_s in leads.items():
                before, course, still = (np.asarray(getattr(x, name)) for x in (moving, after, settled))
                step = (before[rise // 2 + 1] - before[rise // 2]) * self._drive.sampling_frequency_hz
                lacking = course[at] - _middle(still) - sign * lead_s * step
                whole = np.stack([course[at] - before[at], _middle(still) - before[at]])
                trace = TRACE_RATIO * (self.current_a[-1] if name == "i_ab" else self.bus_v)
                size = max(float(np.sqrt(np.mean(x**2))) for x in whole)
                ratios.append(float(np.sqrt(np.mean(lacking**2))) / size if size > trace else 0.0)
        return Course(rise_s, max(ratios))

    def drifts(self, term: EffectTerm) -> bool:
        """Whether an effect does something else later; raises `PluginError` where it fails."""
        some = self.current_a[:: len(self.current_a) // 4]
        early, late = (apply_effect(self._holds(some, self.bus_v, t), term).signals for t in (0.0, LATE_S))
        sizes = {"i_ab": self.current_a[-1], "v_ab": self.bus_v, "theta_rad": 1.0}
        changes = [np.abs(getattr(late, name) - getattr(early, name)).max() / size for name, size in sizes.items()]
        return bool(max(changes) > TRACE_RATIO)

    def reads_voltage(self, term: EffectTerm) -> bool:
        """Whether what an effect does to readings grows with the voltage; raises `PluginError` where it fails.

        At rest the voltage is R_s i, so that such a reading seems to have a gain, which a turning motor's has not.
        """
        some = self.current_a[:: len(self.current_a) // 4]
        beside = [self._holds(some, self.bus_v, beside_v=x * BACK_EMF_RATIO * self.bus_v) for x in (0.0, 0.5, 1.0)]
        still, half, whole = (apply_effect(holds, term).signals.i_ab - holds.i_ab for holds in beside)
        at_half, at_whole = (float(np.abs(change - still).max()) for change in (half, whole))
        return at_whole > max(GROWS_WITH_VOLTAGE * at_half, TRACE_RATIO * float(self.current_a[-1]))

    def leg_losses(self, term: EffectTerm) -> Array:
        """Voltage that each leg loses over its own current at the nominal bus voltage [V], odd, shape (3, k)."""
        holds = self._both_holds[0]
        lost_ab = _middle(holds.v_ab - apply_effect(holds, term).signals.v_ab).reshape(3, -1, 2)
        odd = 0.5 * (lost_ab - lost_ab[:, ::-1])
        # Each direction shows two legs by two components: six equations for three losses.
        legs = np.concatenate([from_phases(np.diag(signs)).T for signs in to_phases(DIRECTIONS)])
        return np.asarray(np.linalg.pinv(legs) @ odd.transpose(0, 2, 1).reshape(6, -1))

    def voltages_taken(self, term: EffectTerm) -> tuple[float, float]:
        """Largest voltage that an effect takes from constant currents, and from one that changes [V]."""
        constant, changing = self._both_holds[0], self._triangles[0]
        of_constant = _middle(constant.v_ab - apply_effect(constant, term).signals.v_ab)
        of_changing = changing.v_ab - apply_effect(changing, term).signals.v_ab
        return float(np.abs(of_constant).max()), float(np.abs(of_changing).max())

    def _legs(self, lost_ab: Array) -> tuple[Array, Array, float]:
        """Loss of a leg (k,), bias (2,) and the part of lost vectors (3 k, 2) that these do not describe."""
        bias = lost_ab.mean(axis=0)
        # A vector of legs (0, e, -e) along (0, 1, -1) A: their product is 4/3 e.
        along = np.sum(lost_ab.reshape(3, -1, 2) * DIRECTIONS[:, None, :], axis=(0, 2)) / 4.0
        lost: Array = 0.5 * (along - along[::-1])
        legs = np.interp(to_phases(_middle(self._both_holds[0].i_ab)), self.current_a, lost)
        return lost, bias, _relative_rms(lost_ab - bias - from_phases(legs), lost_ab, TRACE_RATIO * self.bus_v)

    def _angle(self, term: EffectTerm) -> tuple[float, float]:
        """Mean turn of the d axis over a turn of the rotor, and the part that differs from it."""
        turn = apply_effect(self._angles, term).signals.theta_rad - self._angles.theta_rad
        return float(turn.mean()), _relative_rms(turn - turn.mean(), turn, TRACE_RATIO)

    def _delays(self, term: EffectTerm) -> tuple[float, float]:
        """Lead of readings and of voltages: half the distance of rise and fall at one value, over the slope."""
        delays = []
        for batch, name in zip(self._triangles, ("i_ab", "v_ab"), strict=True):
            before, after = (getattr(one, name)[:, 0] for one in (batch, apply_effect(batch, term).signals))
            rise = len(before) // 4
            slope = (before[rise + 1] - before[rise]) * self._drive.sampling_frequency_hz
            delays.append(0.5 * float(after[rise] - after[len(before) - 1 - rise]) / slope)
        return delays[0], delays[1]

    @cached_property
    def _both_holds(self) -> tuple[SignalBatch, SignalBatch]:
        """All currents of the table at the nominal and at the lower bus voltage."""
        return self._holds(self.current_a, self.bus_v), self._holds(self.current_a, self.low_bus_v)

    @cached_property
    def _angles(self) -> SignalBatch:
        theta = 2.0 * math.pi * np.arange(PROBED_ANGLES) / PROBED_ANGLES
        nothing = np.zeros((PROBED_ANGLES * HOLD_ROWS, 2))
        return _holds_of(self._signals(nothing, nothing, self.bus_v, theta_rad=np.repeat(theta, HOLD_ROWS)))

    @cached_property
    def _triangles(self) -> tuple[SignalBatch, SignalBatch]:
        """A slow rise along alpha and back: of the current alone, and of the voltage alone."""
        return self._triangles_of(RAMP_ROWS)

    def _triangles_of(self, rows: int) -> tuple[SignalBatch, SignalBatch]:
        rise = np.linspace(-1.0, 1.0, rows)
        triangle = np.outer(np.concatenate([rise, rise[::-1]]), [1.0, 0.0])
        nothing, volts = np.zeros_like(triangle), RAMP_VOLTAGE_RATIO * self.bus_v * triangle
        current = self._signals(self.current_a[-1] * triangle, nothing, self.bus_v)
        return SignalBatch.of([current]), SignalBatch.of([self._signals(nothing, volts, self.bus_v)])

    def _holds(self, phase_a: Array, bus_v: float, start_s: float = 0.0, beside_v: float = 0.0) -> SignalBatch:
        """Constant currents (3 k) in the directions at which one phase has none; two have +- `phase_a` (k,).

        The voltage is that of R_s, and `beside_v` along alpha and along beta.
        """
        held = np.repeat((DIRECTIONS[:, None, :] * phase_a[:, None]).reshape(-1, 2), HOLD_ROWS, axis=0)
        return _holds_of(self._signals(held, self._model.r_s_ohm * held + beside_v, bus_v, start_s=start_s))

    def _signals(
        self, i_ab: Array, v_ab: Array, bus_v: float, *, start_s: float = 0.0, theta_rad: Array | float = 0.0
    ) -> Signals:
        rows = len(i_ab)
        psi, inductance = self._magnetics.flux_and_inductance(np.vstack([to_dq(i_ab, theta_rad), np.zeros((1, 2))]))
        psi_dq = psi[:-1] - psi[-1] + np.array([self._model.pm_flux_wb, 0.0])
        return Signals(
            start_s=start_s,
            sampling_frequency_hz=self._drive.sampling_frequency_hz,
            pwm_frequency_hz=self._pwm_hz,
            i_ab=i_ab,
            v_ab=v_ab,
            v_dc=np.full(rows, bus_v),
            theta_rad=np.broadcast_to(theta_rad, (rows,)).copy(),
            resistance_ohm=np.full(rows, self._model.r_s_ohm),
            i_m_ab=i_ab,
            heat_j=np.zeros(rows),
            psi_ab=to_ab(psi_dq, theta_rad),
            inductance_ab=inductance_to_ab(inductance[:-1], theta_rad),
            clarke_of_three=self._of_three,
            motor=self._model.motor,
            drive=self._drive,
        )


def _holds_of(whole: Signals) -> SignalBatch:
    """Signals of many holds as a segment each, all of which begin at one time."""
    arrays = {name: array for name in Signals.__slots__ if isinstance(array := getattr(whole, name), np.ndarray)}
    rows = (slice(k, k + HOLD_ROWS) for k in range(0, len(whole.v_dc), HOLD_ROWS))
    return SignalBatch.of([whole.replaced({name: array[at] for name, array in arrays.items()}) for at in rows])


def _middle(held: RealArray) -> Array:
    """The middle row of each hold, shape (holds, 2)."""
    return np.asarray(held[HOLD_ROWS // 2 :: HOLD_ROWS], dtype=np.float64)


def _affine(read: Array, true: Array) -> tuple[Array, Array, float]:
    """Gain (2, 2) and offset (2,) of true = gain @ read + offset in least squares, and the part that is not affine."""
    design = np.column_stack([read, np.ones(len(read))])
    solution = np.linalg.lstsq(design, true, rcond=None)[0]
    gain, offset = (np.asarray(x, dtype=np.float64) for x in (solution[:2].T, solution[2]))
    return gain, offset, _relative_rms(true - design @ solution, true - read, TRACE_RATIO * float(np.abs(read).max()))


def without_rounding(change: Array, trace: float) -> Array:
    """The change, or zeros where all of it is below a trace."""
    return change if np.abs(change).max() > trace else np.zeros_like(change)


def _relative_rms(lacking: Array, whole: Array, trace: float) -> float:
    """rms of what is lacking over that of the whole; 0 where the whole leaves no trace."""
    size = float(np.sqrt(np.mean(whole**2)))
    return float(np.sqrt(np.mean(lacking**2))) / size if size > trace else 0.0
