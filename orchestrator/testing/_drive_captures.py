"""Drive checks: the capture fits the excitation, in the right frame and on one time base."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from orchestrator.testing._drive_bench import DISCARDED_PERIODS, ROWS_PER_PERIOD, DriveBench, Session
from orchestrator.testing._kit import bounded
from orchestrator.testing._waveforms import (
    angle_between,
    complex_dq,
    find_injection,
    ripple_follows_flux,
    trapezoid_reference,
)

SIXTY_DEGREES = math.pi / 3.0


class DriveCaptureChecks(DriveBench):
    """Time base, frames, and the shape of every excitation."""

    def test_clock_only_goes_forward(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            row_s = 1.0 / session.capabilities.sampling_frequency_hz
            first = session.measure(session.sizes.hold())
            second = session.measure(session.sizes.hold(d=-1.0))
            waited = second.start_s - first.end_s
            assert waited >= session.sizes.settle_s - row_s, (
                f"the second hold starts {waited:.4f} s after the first ends, with {session.sizes.settle_s} s to settle"
            )
            assert session.drive.telemetry().time_s >= second.end_s - row_s, "telemetry's clock is behind the captures"

    def test_gates_off_shows_the_sensors_alone(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("gates_off")
            if "hold" in session.capabilities.excitations:
                session.measure(session.sizes.hold())
            measured = session.measure(session.sizes.gates_off())
            assert not measured.v_ab.any(), "a voltage is commanded with the gates off"
            flowing = abs(complex(*measured.i_ab.mean(axis=0)))
            assert flowing <= 2.0 * self.tolerance_a(session), f"{flowing:.3f} A flow with the gates off"

    @pytest.mark.parametrize(("d", "q"), [(1.0, 0.5), (-0.5, 1.0)])
    def test_hold_reaches_its_target_by_a_voltage_that_points_there(self, tmp_path: Path, d: float, q: float) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            measured = session.measure(session.sizes.hold(d, q))
            i_dq = complex_dq(measured.i_ab, 0.0)
            target = complex(d, q) * session.sizes.current_a
            off = abs(i_dq.mean() - target)
            assert off <= self.tolerance_a(session), f"holds {i_dq.mean():.3f} A instead of {target:.3f} A"
            halves = np.array_split(i_dq, 2)
            assert abs(halves[1].mean() - halves[0].mean()) <= self.tolerance_a(session), "captured before settling"
            v, i = (complex(*x.mean(axis=0)) for x in (measured.v_ab, measured.i_ab))
            assert (v * i.conjugate()).real > 0.0, f"mean v.i is negative at {i:.3f} A: polarity is wrong"
            apart = angle_between(np.angle(v), np.angle(i))
            assert apart < SIXTY_DEGREES, f"voltage and direct current point {math.degrees(apart):.0f} degrees apart"

    def test_captures_turn_with_the_rotor_angle(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            measured = session.measure(session.sizes.hold(rotor_angle_rad=SIXTY_DEGREES))
            direction = float(np.angle(complex(*measured.i_ab.mean(axis=0))))
            expected = SIXTY_DEGREES + math.atan2(0.5, 1.0)
            allowed = bounded("angle_tolerance_rad", self.angle_tolerance_rad, 0.2)
            assert angle_between(direction, expected) <= allowed, (
                f"at a rotor angle of 60 degrees the captured current points to {math.degrees(direction):.0f}, "
                f"expected {math.degrees(expected):.0f}"
            )

    @pytest.mark.parametrize("swept_axis", ["q", "d", "dq"])
    def test_trapezoid_follows_its_reference(self, tmp_path: Path, swept_axis: str) -> None:
        with self.armed(tmp_path) as session:
            session.requires("trapezoid")
            periods = 2 if swept_axis == "q" else 1
            excitation = session.sizes.trapezoid(swept_axis=swept_axis, periods=periods, rotor_angle_rad=SIXTY_DEGREES)
            measured = session.measure(excitation)
            i_dq = complex_dq(measured.i_ab, SIXTY_DEGREES)
            reference = trapezoid_reference(excitation, len(i_dq), session.capabilities.sampling_frequency_hz)
            distance = float(np.sqrt(np.mean(np.abs(i_dq - reference) ** 2)))
            allowed = bounded("tracking_tolerance", self.tracking_tolerance, 0.4) * excitation.amplitude_a
            assert distance <= allowed, f"{distance:.3f} A rms from the commanded trapezoid ({allowed:.3f} A allowed)"
            self._require_plateaus(session, i_dq, reference)

    def _require_plateaus(self, session: Session, i_dq: np.ndarray, reference: np.ndarray) -> None:
        """The last half of each constant phase must be reached within the tolerance of a hold."""
        rows = round(session.sizes.period_s * session.capabilities.sampling_frequency_hz)
        for begin, end in ((0.25, 0.375), (0.75, 0.875)):
            plateau = slice(round(begin * rows), round(end * rows) - 1)
            off = abs((i_dq[plateau] - reference[plateau]).mean())
            assert off <= self.tolerance_a(session), f"a constant phase of the trapezoid is off by {off:.3f} A"

    @pytest.mark.parametrize("waveform", ["square", "sine"])
    def test_injection_is_found_in_the_captured_voltage(self, tmp_path: Path, waveform: str) -> None:
        with self.armed(tmp_path) as session:
            session.requires("injection")
            if waveform not in session.capabilities.injection_waveforms:
                pytest.skip(f"this drive claims no {waveform} wave")
            late_s = DISCARDED_PERIODS / session.sizes.frequency_hz
            excitation = session.sizes.injection(waveform=waveform, rotor_angle_rad=SIXTY_DEGREES, discard_s=late_s)
            measured = session.measure(excitation)
            ripple = find_injection(
                measured.v_ab, session.capabilities.sampling_frequency_hz, excitation.waveform, ROWS_PER_PERIOD
            )
            assert math.isclose(ripple.frequency_hz, excitation.frequency_hz, rel_tol=1e-3), (
                f"injects {ripple.frequency_hz:.2f} Hz instead of {excitation.frequency_hz:.2f} Hz"
            )
            assert abs(ripple.rotation_hz - excitation.rotation_hz) < 0.1 * excitation.rotation_hz, (
                f"rotates at {ripple.rotation_hz:.3f} Hz instead of {excitation.rotation_hz:.3f} Hz"
            )
            allowed = bounded("voltage_tolerance", self.voltage_tolerance, 0.1)
            assert math.isclose(ripple.amplitude_v, excitation.amplitude_v, rel_tol=allowed), (
                f"injects {ripple.amplitude_v:.2f} V instead of {excitation.amplitude_v:.2f} V"
            )
            expected = SIXTY_DEGREES + 2.0 * math.pi * excitation.rotation_hz * late_s
            assert angle_between(ripple.direction_rad, expected) <= bounded(
                "angle_tolerance_rad", self.angle_tolerance_rad, 0.2
            ), f"starts at {math.degrees(ripple.direction_rad):.1f} degrees, expected {math.degrees(expected):.1f}"

    def test_injection_ripples_about_its_target(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("injection")
            excitation = session.sizes.injection(discard_s=session.sizes.late_s)
            measured = session.measure(excitation)
            target = complex(excitation.target_d_a, excitation.target_q_a)
            reached = complex_dq(measured.i_ab, 0.0).mean()
            allowed = 0.5 * abs(target) or 2.0 * self.tolerance_a(session)
            assert abs(reached - target) < allowed, f"ripples about {reached:.3f} A instead of {target:.3f} A"
            follows = ripple_follows_flux(measured.v_ab, measured.i_ab, ROWS_PER_PERIOD)
            assert follows > 0.5, f"the ripple current follows the integral of the voltage with {follows:.2f} only"

    def test_steps_turn_round_where_the_current_meets_its_limit(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("steps")
            excitation = session.sizes.voltage_steps(rotor_angle_rad=SIXTY_DEGREES)
            measured = session.measure(excitation)
            v_dq, i_dq = (complex_dq(x, SIXTY_DEGREES) for x in (measured.v_ab, measured.i_ab))
            allowed = bounded("voltage_tolerance", self.voltage_tolerance, 0.1) * excitation.voltage_d_v
            off = float(np.abs(np.abs(v_dq.real) - excitation.voltage_d_v).max() + np.abs(v_dq.imag).max())
            assert off <= allowed, f"the voltage is off +-{excitation.voltage_d_v:.2f} V on d by {off:.2f} V"
            turned = np.flatnonzero(np.diff(np.sign(v_dq.real)) != 0) + 1
            assert len(turned) >= 4, f"turned {len(turned)} times only"
            reached = np.abs(i_dq.real[turned])
            least = excitation.turn_d_a - self.tolerance_a(session)
            assert reached.min() >= least, f"turned at {reached.min():.3f} A, before the {excitation.turn_d_a:.3f} A"
            most = 1.5 * excitation.turn_d_a
            assert np.abs(i_dq.real).max() <= most, f"goes on to {np.abs(i_dq.real).max():.3f} A after a turn"

    @pytest.mark.parametrize("bridge", ["off", "on"])
    def test_a_rotor_that_turns_says_its_angle(self, tmp_path: Path, bridge: str) -> None:
        with self.connected(tmp_path) as session:
            session.requires("spin")
            if session.capabilities.has_brake:
                session.drive.set_brake(False)
            with self.beating(session) as beating:
                excitation = session.sizes.spin(bridge=bridge)
                measured = beating.measure(excitation)
                assert all(block.theta_rad is not None for block in measured.blocks), "no theta_rad is captured"
                theta = np.unwrap(np.concatenate([np.asarray(block.theta_rad) for block in measured.blocks]))
                fs = session.capabilities.sampling_frequency_hz
                speed = float(np.polyfit(np.arange(len(theta)) / fs, theta, 1)[0])
                assert math.isclose(speed, excitation.speed_rad_s, rel_tol=0.02), f"turns at {speed:.3f} rad/s"
                i_dq = (measured.i_ab[:, 0] + 1j * measured.i_ab[:, 1]) * np.exp(-1j * theta)
                assert abs(i_dq.mean()) <= self.tolerance_a(beating), f"{abs(i_dq.mean()):.3f} A without a command"
                ahead = (measured.v_ab[:, 0] + 1j * measured.v_ab[:, 1]) * np.exp(-1j * theta)
                if (flux := self.setup().motor.pm_flux_wb or 0.0) > 0.0:
                    least = 0.5 * excitation.speed_rad_s * flux
                    assert abs(ahead.mean()) > least, "the voltage has no back-EMF in it that turns with the rotor"
                beating.drive.ramp_down()
