"""Drive checks: its clock, sensors and power stage, compared with references independent of its statements.

That is the host's clock, the equation of a winding whatever its numbers, and what one reading says of another.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from orchestrator.numerics.alignment import alignment_of
from orchestrator.testing._drive_bench import DISCARDED_PERIODS, ROWS_PER_PERIOD, DriveBench, Session
from orchestrator.testing._waveforms import complex_dq, folded, share_at_the_end_of_the_scale
from protocols import Drive


@dataclass(frozen=True)
class _Tolerances:
    """Largest errors of a drive's time, rows and readings."""

    clock_error_ratio: float = 0.005
    """A quartz is off by 1e-4; at a hundred times that the flux map is still within half a per cent."""
    lag_error_rows: float = 0.25
    """Largest apparent shift by the ripple's own shape."""
    min_explained_ratio: float = 0.93
    """Smallest explained share of steps; simulated: 0.9999, 0.97 with a mean over 3 rows, 0.95 over 4, 0.86 over 8."""
    max_clipped_ratio: float = 0.03
    """Largest share of rows at the largest reading; simulated: 0.003 of a rotating ripple."""
    max_injection_ratio: float = 5.0
    """Largest multiple of the kit's injection, however small the ripple."""


_TOLERANCES = _Tolerances()

BUS_LIMITS_RATIO = (0.6, 1.6)
"""Measured over nominal bus voltage: rectified mains and batteries vary by a third."""
HELD_CURRENT_RATIO = 0.55
"""Current at which the kit injects, over the rated one."""
PEAK_CURRENT_RATIO = 0.9
"""Peak of that ripple over the rated current: the check sees readings up to there."""


@dataclass(frozen=True)
class ClockReading:
    """The drive's clock between two looks at the host's [s]."""

    sent_s: float
    reading_s: float
    answered_s: float

    @classmethod
    def of(cls, drive: Drive) -> ClockReading:
        sent_s = time.monotonic()
        reading_s = drive.telemetry().time_s
        return cls(sent_s, reading_s, time.monotonic())


class DriveInstrumentChecks(DriveBench):
    """Faults that a drive cannot detect itself."""

    def test_clock_keeps_the_host_s_time(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            if session.capabilities.clock_is_simulated:
                pytest.skip("the drive says that its time is its own (clock_is_simulated)")
            before = [ClockReading.of(session.drive) for _ in range(4)]
            self._require_no_haste(session)
            time.sleep(max(0.0, before[0].sent_s + 2.0 - time.monotonic()))
            after = [ClockReading.of(session.drive) for _ in range(4)]
        off = clock_off(before, after)
        assert abs(off) <= _TOLERANCES.clock_error_ratio, (
            f"the drive's clock runs {100 * off:+.2f} % against the host's: a wrong sampling frequency, or a time that "
            "is its own (then say clock_is_simulated)"
        )

    def _require_no_haste(self, session: Session) -> None:
        """Rows cannot arrive before they are sampled; the host's clock shows a wrong rate of the drive's."""
        if "hold" not in session.capabilities.excitations:
            return
        hold = session.sizes.hold()
        begun = time.monotonic()
        session.measure(hold)
        took, least = time.monotonic() - begun, hold.settling_s + hold.captured_s
        assert took >= (1.0 - _TOLERANCES.clock_error_ratio) * least - 2e-3, (
            f"a hold of {least:.3f} s was over after {took:.3f} s: rows come faster than the sampling frequency says"
        )

    def test_voltage_and_current_are_of_the_same_row(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("injection")
            ohm = self.setup().motor.stator_resistance_ohm
            if session.sizes.waveform != "square" and ohm is None:
                pytest.skip("a sine tells one row from the next with the nameplate's resistance only")
            excitation = session.sizes.injection(discard_s=DISCARDED_PERIODS / session.sizes.frequency_hz)
            measured = session.measure(excitation)
            turn = excitation.rotation_hz / session.capabilities.sampling_frequency_hz
            i_ab, v_ab = (folded(x, turn, ROWS_PER_PERIOD) for x in (measured.i_ab, measured.v_ab))
            fit = alignment_of(i_ab, v_ab, ohm=ohm)
            assert fit is not None, "the steps of the current are explained by the voltage of no row near to them"
            assert fit.explained >= _TOLERANCES.min_explained_ratio, (
                f"after an edge of the voltage the current's slope takes several rows to change ({fit.explained:.0%} "
                "of its steps are the voltage's): the readings are smoothed"
            )
            declared = session.capabilities.voltage_delay_samples
            assert abs(fit.lag_rows - declared) <= _TOLERANCES.lag_error_rows, (
                f"v = R i + L di/dt holds with v[k] acting from t_k + {fit.lag_rows:.2f} Ts, the drive says "
                f"{declared:g} (voltage_delay_samples): its voltage stands in the wrong row, or the delay is missing"
            )

    def test_bus_voltage_is_the_same_wherever_it_is_read(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            kinds = session.capabilities.excitations
            short = session.sizes.hold(duration_s=0.2 * session.sizes.duration_s)
            blocks = session.measure(short if "hold" in kinds else session.sizes.one_of(max(kinds))).blocks
            bus_v = float(np.median(np.concatenate([block.v_dc for block in blocks])))
            shown_v, nominal_v = session.drive.telemetry().v_dc_v, session.capabilities.dc_bus_voltage_v
            assert abs(bus_v - shown_v) <= 0.1 * shown_v, (
                f"captures have a bus of {bus_v:.1f} V, telemetry {shown_v:.1f} V"
            )
            assert BUS_LIMITS_RATIO[0] * nominal_v <= bus_v <= BUS_LIMITS_RATIO[1] * nominal_v, (
                f"captures have a bus of {bus_v:.1f} V, the drive says {nominal_v:.1f} V of itself: a scale is wrong"
            )

    def test_every_claimed_pwm_frequency_is_at_work(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            choices = sorted(session.capabilities.pwm_frequencies_hz)
            held = [self._voltage_at(session, frequency) for frequency in choices]
            if len(choices) > 1 and session.drive.telemetry().pwm_frequency_hz is None:
                (low, noise), (high, _), (again, _) = held[0], held[-1], self._voltage_at(session, choices[0])
                # Twice at the lowest one: what the winding's warming changes is between the two.
                apart, drift = abs(high - 0.5 * (low + again)), abs(again - low)
                assert apart > drift + 6.0 * noise, (
                    f"nothing shows that the PWM frequency was changed: at {choices[0]:g} and {choices[-1]:g} Hz a "
                    "current takes the same voltage, as if there were no dead time, and telemetry has no "
                    "pwm_frequency_hz"
                )

    def _voltage_at(self, session: Session, frequency_hz: float) -> tuple[complex, float]:
        """Mean voltage of a hold at a PWM frequency, and its standard error."""
        measured = session.measure(session.sizes.hold(pwm_frequency_hz=frequency_hz))
        off = abs(complex_dq(measured.i_ab, 0.0).mean() - complex(1.0, 0.5) * session.sizes.current_a)
        assert off <= self.tolerance_a(session), f"misses its target by {off:.3f} A at {frequency_hz} Hz"
        reported_hz = session.drive.telemetry().pwm_frequency_hz
        assert reported_hz is None or math.isclose(reported_hz, frequency_hz, rel_tol=1e-4), (
            f"a PWM frequency of {frequency_hz:g} Hz was requested, {reported_hz:g} Hz is at work"
        )
        v = complex_dq(measured.v_ab, 0.0)
        parts = np.array([part.mean() for part in np.array_split(v, min(10, len(v)))])
        return complex(v.mean()), float(np.abs(parts - v.mean()).std()) / math.sqrt(len(parts))

    def test_no_current_flows_unseen_while_disarmed(self, tmp_path: Path) -> None:
        """A current that telemetry denies still flows in the first rows after arming."""
        with self.connected(tmp_path) as session:
            session.requires("hold")
            with self.beating(session):
                self._require_nothing_flows(session, "connecting")
                session.measure(session.sizes.hold())
                session.drive.disarm()
            time.sleep(0.3)
            with self.beating(session):
                self._require_nothing_flows(session, "disarming under current")
                session.drive.ramp_down()

    def _require_nothing_flows(self, session: Session, after: str) -> None:
        at_zero = session.sizes.hold(0.0, 0.0, settle_s=0.0)
        first = complex_dq(session.measure(at_zero).i_ab, 0.0)[:3].mean()
        assert abs(first) <= 2.0 * self.tolerance_a(session), (
            f"{abs(first):.3f} A flow in the first rows after {after} and arming: the power stage was on, whatever "
            "telemetry gave"
        )

    def test_bridge_is_on_only_while_armed(self, tmp_path: Path) -> None:
        with self.connected(tmp_path) as session:
            after_connecting = self.bridge_is_on(session.drive)
            if after_connecting is None:
                pytest.skip("no instrument beside the drive says whether its bridge is on (override bridge_is_on)")
            assert after_connecting is False, "connecting switches the power stage on, whatever telemetry says"
            with self.beating(session):
                assert self.bridge_is_on(session.drive) is True, "armed, but the power stage is off"
                session.drive.disarm()
                assert self.bridge_is_on(session.drive) is False, "disarmed, but the power stage is on"

    def test_currents_up_to_the_rated_one_are_read_whole(self, tmp_path: Path) -> None:
        """Checked by the ripple of an open-loop voltage, as a clipped reading would mislead current control."""
        with self.armed(tmp_path) as session:
            session.requires("injection")
            sizes = session.sizes
            target_a = 0.0 if session.capabilities.injects_at_zero_only else HELD_CURRENT_RATIO * sizes.rated_a
            discard_s = DISCARDED_PERIODS / sizes.frequency_hz
            excitation = sizes.injection(target_d_a=target_a, target_q_a=0.0, discard_s=discard_s)
            ripple = complex_dq(session.measure(excitation).i_ab, 0.0)
            reach_a = float(np.abs(ripple - ripple.mean()).max())
            times = min((PEAK_CURRENT_RATIO * sizes.rated_a - target_a) / reach_a, _TOLERANCES.max_injection_ratio)
            times = min(times, 0.4 * session.capabilities.max_voltage_v / excitation.amplitude_v)
            if times > 1.0:
                excitation = excitation.model_copy(update={"amplitude_v": times * excitation.amplitude_v})
            measured = session.measure(excitation)
            if any(block.clipped_rows for block in measured.blocks):
                return  # declared in its capabilities
            share, name = share_at_the_end_of_the_scale(measured.i_ab)
            peak_a = float(np.hypot(*measured.i_ab.T).max())
            assert share <= _TOLERANCES.max_clipped_ratio, (
                f"{share:.0%} of the rows stand at the largest reading of {name}, in a ripple up to {peak_a:.3g} A: "
                f"clipped below the rated {session.sizes.rated_a:.3g} A, and clipped_rows does not say so"
            )


def clock_off(before: list[ClockReading], after: list[ClockReading]) -> float:
    """By which part the drive's clock is off, at least; 0 where late answers could be the reason.

    A reading was taken between question and answer. What is the same by the earliest questions and by the latest
    answers is not the host's business.
    """
    host_s = after[0].sent_s - before[0].sent_s
    by_questions = min(r.reading_s - r.sent_s for r in after) - min(r.reading_s - r.sent_s for r in before)
    by_answers = max(r.reading_s - r.answered_s for r in after) - max(r.reading_s - r.answered_s for r in before)
    if by_questions * by_answers <= 0.0:
        return 0.0
    return min(by_questions, by_answers, key=abs) / host_s
