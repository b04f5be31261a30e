"""Derive omitted settings of a stage from nameplate, limits and sampling frequency.

With I the rated current (peak), L and R the nameplate's, f_s the drive's sampling frequency:
amplitudes are 1.25 I within 0.8 of the limit; injection is at f_s/20 with the voltage that
swings the flux by 0.2 I L_d, I no more here than 1/1.25 of those amplitudes; settling takes five
time constants of the current control and of L/R, and as long again, since the second half of it
is averaged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeVar

from orchestrator.stages._ripple import flux_swing_wb, injection_voltage_v, ripple_a
from protocols import CurrentControl, Motor, ProcedureError, StageContext

T = TypeVar("T")

NOMINAL_SAMPLING_HZ = 10_000.0
"""Sampling frequency without a drive."""


@dataclass(frozen=True)
class ScalingRules:
    """Amplitudes and durations relative to the nameplate and the limits."""

    over_rated: float = 1.25
    """Amplitudes relative to the rated current: far enough into saturation for the map's edge."""
    of_limit: float = 0.8
    """Amplitudes relative to a limit: noise and overshoot can trip a drive as well."""
    headroom: float = 0.95
    """Longest swept current vector relative to limits.current_a."""
    samples_per_period: int = 20
    """Samples in each period of the injection."""
    periods_per_turn: int = 250
    """Periods of the injection per rotation of its direction."""
    rows_per_turn: int = 60
    """Samples per turn of a rotating rotor, which moves little while a voltage is held."""
    turns: int = 2
    """Rotations of the injection's direction at each point."""
    time_constants: float = 5.0
    """Time constants after which a transient has decayed (to 0.7 %)."""
    of_ripple: float = 3.0
    """A d-axis current that keeps phase currents from zero, against the ripple: two phases carry half of it, and a
    saturated motor has half as much ripple again."""
    weak_saliency: float = 1.15
    """Ratio of the inductances below which noise of a few turns of an injection may hide where the d axis is."""
    shortest_hold_s: float = 0.5
    """A hold averages over several periods of the mains."""


class Scaling:
    """The rules for one stage of a procedure; `setting` is the name of the omitted setting.

    Parameters
    ----------
    context : StageContext
    rules : ScalingRules, optional

    Raises
    ------
    ProcedureError
        From all methods, where the nameplate lacks a value that a setting depends on; the error names both.
    """

    def __init__(self, context: StageContext, rules: ScalingRules | None = None) -> None:
        self._context, self._rules = context, rules or ScalingRules()
        self._motor, self._limits = context.procedure.motor, context.procedure.limits

    def control(self, given: CurrentControl | None) -> CurrentControl:
        """The current control: the stage's own or the procedure's."""
        return given if given is not None else self._context.procedure.control

    def rated_current_a(self, setting: str) -> float:
        """Rated current as the length of its vector [A]."""
        return self._needed("rated_current_rms_a", self._motor.rated_current_a, setting)

    def amplitude_a(self, setting: str) -> float:
        """Amplitude of a sweep on an axis [A]: a quarter more than the rated current, within the limit."""
        return self.within_limit_a(self._rules.over_rated * self.rated_current_a(setting))

    def within_limit_a(self, current_a: float) -> float:
        """The current, limited to the largest one allowed by limits.current_a [A]."""
        return tidy(min(current_a, self._rules.of_limit * self._limits.current_a))

    @property
    def stiffest_hold_a(self) -> float:
        """d-axis current with the largest holding stiffness for a free rotor [A]; see `stiffest_hold_a`."""
        return stiffest_hold_a(self._motor)

    @property
    def is_weakly_salient(self) -> bool:
        """Whether the nameplate's L_q is within 15 % of L_d."""
        d, q = self._motor.d_inductance_h, self._motor.q_inductance_h
        return d is not None and q is not None and max(d, q) <= self._rules.weak_saliency * min(d, q)

    @property
    def reach_a(self) -> float:
        """Longest swept current vector, ripple included [A]."""
        return self._rules.headroom * self._limits.current_a

    def beside_ripple_a(self, setting: str, ripple_a: float) -> float:
        """Longest current with a margin for an injection's ripple [A]; raises where there is none."""
        room = self.reach_a - ripple_a
        if room <= 0:
            limit, needed = self._limits.current_a, ripple_a / self._rules.headroom
            problem = f"the injection's ripple of {ripple_a:.3g} A leaves no room below limits.current_a of {limit:g} A"
            raise self.error(setting, f"{problem}: weaken the injection, or allow well above {needed:.3g} A")
        return room

    def clear_of_zero_a(self, setting: str, ripple_a: float) -> float:
        """d-axis current at which an injection takes no phase current through zero [A].

        At most half of the current without ripple, since the torque current adds to it.
        """
        return tidy(min(self._rules.of_ripple * ripple_a, 0.5 * self.beside_ripple_a(setting, ripple_a)))

    def injection_hz(self, given: float | None) -> float:
        """Frequency of an injection."""
        return given if given is not None else self._context.sampling_frequency_hz / self._rules.samples_per_period

    def injection_v(self, setting: str, frequency_hz: float, waveform: Literal["square", "sine"] = "square") -> float:
        """Amplitude of an injection [V], within the room that R_s i leaves below limits.voltage_v."""
        inductance = self._needed("d_inductance_h", self._motor.d_inductance_h, setting)
        # Where the limit shortens the sweeps, the ripple shrinks in proportion.
        swept = min(
            self.rated_current_a(setting), self._rules.of_limit / self._rules.over_rated * self._limits.current_a
        )
        wanted = injection_voltage_v(swept, inductance, frequency_hz, waveform)
        resistance, limits = self._motor.stator_resistance_ohm or 0.0, self._limits
        drop = resistance * limits.current_a
        if drop >= limits.voltage_v:
            ohmic = f"{resistance:g} ohm x limits.current_a of {limits.current_a:g} A = {drop:.4g} V"
            enough = f"raise it to {float(f'{drop + wanted / self._rules.of_limit:.3g}'):g} V"
            lower = f"lower limits.current_a below {limits.voltage_v / resistance:.3g} A"
            problem = f"{limits.voltage_v:g} V leave no room for an injection beside {ohmic}: {enough}, or {lower}"
            place = f"stages.{self._context.index}.{setting}"
            raise ProcedureError(self._context.procedure.name, "limits.voltage_v", f"{problem} ({place})")
        return tidy(min(wanted, self._rules.of_limit * (limits.voltage_v - drop)))

    def ripple_a(self, amplitude_v: float, frequency_hz: float, waveform: Literal["square", "sine"]) -> float:
        """Peak of an injection's current ripple [A]; 0 where no inductance is known."""
        return ripple_a(flux_swing_wb(amplitude_v, frequency_hz, waveform), self._motor)

    def step_v(self, setting: str, axis: Literal["d", "q"], turn_a: float, swing_s: float, least_ohmic: float) -> float:
        """Voltage that moves the current between its limits in the given time, and exceeds R_s i by a factor [V].

        The voltage limit caps the result where R_s i allows it.
        """
        inductance = self._needed("d_inductance_h", self._inductance(axis), setting)
        wanted = 2.0 * turn_a * inductance / swing_s
        ohmic = least_ohmic * (self._motor.stator_resistance_ohm or 0.0) * turn_a
        return tidy(min(max(wanted, ohmic), self._rules.of_limit * self._limits.voltage_v))

    def swing_s(self, axis: Literal["d", "q"], turn_a: float, voltage_v: float) -> float | None:
        """Time that a voltage takes from one current limit to the other; None where no inductance is known."""
        inductance = self._inductance(axis)
        return None if inductance is None else 2.0 * turn_a * inductance / voltage_v

    def spin_rad_s(self, setting: str, current_a: float) -> float:
        """Electrical speed at which half of the voltage's limit turns the flux, half the rated speed at most.

        An unknown magnet flux counts as the flux of the current.
        """
        motor, limits = self._motor, self._limits
        own = self._needed("q_inductance_h", self._inductance("q"), setting) * current_a
        flux = own + (own if motor.pm_flux_wb is None else motor.pm_flux_wb)
        room = self._rules.of_limit * limits.voltage_v - (motor.stator_resistance_ohm or 0.0) * current_a
        if room <= 0.0 or flux <= 0.0:
            raise self.error(setting, "limits.voltage_v leave no room for a back-EMF, or there is no flux: give it")
        rows = self._rules.rows_per_turn
        fastest = 2.0 * math.pi * self._context.sampling_frequency_hz / rows
        rated = motor.rated_speed_rpm and 0.5 * motor.rated_speed_rpm * motor.pole_pairs * math.pi / 30.0
        return min(0.6 * room / flux, fastest, rated or math.inf)

    def turns(self, rotation_hz: float | None, duration_s: float | None, frequency_hz: float) -> tuple[float, float]:
        """Rotation and duration with whole turns in the duration, where either is free."""
        usual = frequency_hz / self._rules.periods_per_turn
        if duration_s is None:
            rotation_hz = rotation_hz if rotation_hz is not None else usual
            return rotation_hz, max(1, round(self._rules.turns * rotation_hz / usual)) / rotation_hz
        if rotation_hz is None:
            return max(1, round(usual * duration_s)) / duration_s, duration_s
        return rotation_hz, duration_s

    def settle_s(self, given: float | None, control: CurrentControl | None) -> float:
        """Settling time of an operating point."""
        if given is not None:
            return given
        used = self.control(control)
        of_control = 1 / (used.damping * 2 * math.pi * used.bandwidth_hz)
        return tidy(2 * self._rules.time_constants * (of_control + self._time_constant_s("settle_s")))

    def hold_s(self, given: float | None) -> float:
        """Capture time of a direct current."""
        if given is not None:
            return given
        settled = tidy(2 * self._rules.time_constants * self._time_constant_s("duration_s"))
        return max(self._rules.shortest_hold_s, settled)

    def note(self, text: str) -> None:
        """Note a remark on the derived settings for the operator."""
        self._context.notes.append(f"stages.{self._context.index} {text}")

    def error(self, setting: str, problem: str) -> ProcedureError:
        """The error of an unusable setting."""
        return ProcedureError(self._context.procedure.name, f"stages.{self._context.index}.{setting}", problem)

    def _inductance(self, axis: Literal["d", "q"]) -> float | None:
        d, q = self._motor.d_inductance_h, self._motor.q_inductance_h
        return d if axis == "d" else q or d

    def _time_constant_s(self, setting: str) -> float:
        resistance = self._needed("stator_resistance_ohm", self._motor.stator_resistance_ohm, setting)
        inductance = max(self._motor.d_inductance_h or 0.0, self._motor.q_inductance_h or 0.0) or None
        return self._needed("q_inductance_h", inductance, setting) / resistance

    def _needed(self, name: str, value: float | None, setting: str) -> float:
        if value is None:
            place = f"stages.{self._context.index}.{setting}"
            problem = f"missing, and {place} is derived from it: give one of the two"
            raise ProcedureError(self._context.procedure.name, f"motor.{name}", problem)
        return value


def stiffest_hold_a(motor: Motor) -> float:
    """d-axis current with the largest holding stiffness for a free rotor [A]; infinite where stiffness always rises.

    The magnet draws the d axis onto the current, L_q - L_d draws the q axis onto it. By the torque

        T = 3/2 p (psi_m i sin g - (L_q - L_d) i^2 sin g cos g),

    g from the magnet to the current (J. R. Hendershot, T. J. E. Miller, Design of Brushless Permanent-Magnet
    Machines, 2010), the stiffness dT/dg at g = 0 is largest at psi_m / 2 (L_q - L_d), and gone at twice that.
    """
    if not motor.pm_flux_wb or motor.d_inductance_h is None or motor.q_inductance_h is None:
        return math.inf
    outweighing_h = motor.q_inductance_h - motor.d_inductance_h
    return 0.5 * motor.pm_flux_wb / outweighing_h if outweighing_h > 0.0 else math.inf


def given(setting: T | None) -> T:
    """A setting that has a value after `filled`."""
    assert setting is not None
    return setting


def tidy(value: float) -> float:
    """Rounded to two significant digits, for readable settings."""
    return float(f"{value:.2g}")
