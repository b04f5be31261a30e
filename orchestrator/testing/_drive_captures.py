"""Drive checks: what is asked for is what is captured, in the right frame and on one time base."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from orchestrator.testing._drive_bench import SAMPLES_PER_PERIOD, DriveBench, Measured, Session, measure
from orchestrator.testing._kit import bounded
from orchestrator.testing._waveforms import (
    angle_between,
    complex_dq,
    find_injection,
    ripple_follows_flux,
    trapezoid_reference,
)
from protocols import DriveState

KINDS = ("gates_off", "hold", "trapezoid", "injection")
SIXTY_DEGREES = math.pi / 3.0


class DriveCaptureChecks(DriveBench):
    """Time base, frames, and the shape of every excitation."""

    @pytest.mark.parametrize("kind", KINDS)
    def test_rows_are_finite_uniform_and_as_many_as_asked(self, tmp_path: Path, kind: str) -> None:
        with self.armed(tmp_path) as session:
            session.requires(kind)
            excitation = session.sizes.one_of(kind)
            measured = measure(session.drive, excitation)
            fs = session.capabilities.sampling_frequency_hz
            assert len(measured.i_ab) == excitation.rows(fs), (
                f"{kind} of {excitation.captured_s} s at {fs} Hz gave {len(measured.i_ab)} rows"
            )
            for block in measured.blocks:
                assert block.sampling_frequency_hz == fs, "a block's sampling frequency is not the one claimed"
                assert len(block) <= 0.5 * fs + 1, f"a block of {len(block) / fs:.2f} s; half a second at most"
                arrays = (block.i_ab, block.v_ab, block.v_dc)
                assert all(np.isfinite(array).all() for array in arrays), "a sample is not finite"
                assert block.v_dc.min() > 0.0, "v_dc is not positive"
            longest = float(np.hypot(*measured.v_ab.T).max())
            assert longest <= session.sizes.limits.voltage_v * 1.001, f"commanded {longest:.1f} V, above the limit"

    def test_blocks_follow_each_other_without_gap(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            for kind in sorted(session.capabilities.excitations):
                _require_contiguous(measure(session.drive, session.sizes.one_of(kind)))

    def test_clock_only_goes_forward(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            row_s = 1.0 / session.capabilities.sampling_frequency_hz
            first = measure(session.drive, session.sizes.hold())
            second = measure(session.drive, session.sizes.hold(d=-1.0))
            waited = second.start_s - first.end_s
            assert waited >= session.sizes.settle_s - row_s, (
                f"the second hold starts {waited:.4f} s after the first ends, with {session.sizes.settle_s} s to settle"
            )
            assert session.drive.telemetry().time_s >= second.end_s - row_s, "telemetry's clock is behind the captures"

    def test_gates_off_shows_the_sensors_alone(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("gates_off")
            if "hold" in session.capabilities.excitations:
                measure(session.drive, session.sizes.hold())
            measured = measure(session.drive, session.sizes.gates_off())
            assert not measured.v_ab.any(), "a voltage is commanded with the gates off"
            flowing = abs(complex(*measured.i_ab.mean(axis=0)))
            assert flowing <= 2.0 * self.near(session), f"{flowing:.3f} A flow with the gates off"

    @pytest.mark.parametrize(("d", "q"), [(1.0, 0.5), (-0.5, 1.0)])
    def test_hold_reaches_its_target(self, tmp_path: Path, d: float, q: float) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            measured = measure(session.drive, session.sizes.hold(d, q))
            i_dq = complex_dq(measured.i_ab, 0.0)
            target = complex(d, q) * session.sizes.current_a
            off = abs(i_dq.mean() - target)
            assert off <= self.near(session), f"holds {i_dq.mean():.3f} A instead of {target:.3f} A"
            halves = np.array_split(i_dq, 2)
            assert abs(halves[1].mean() - halves[0].mean()) <= self.near(session), "captured before it had settled"

    def test_drive_goes_on_holding_after_the_last_block(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            measure(session.drive, session.sizes.hold(1.0, 0.0))
            assert session.drive.telemetry().state is DriveState.ARMED
            off = abs(session.current_now() - session.sizes.current_a)
            assert off <= 2.0 * self.near(session), "the operating point is not held after the excitation"

    def test_voltage_drives_the_current_that_it_points_at(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            for d, q in ((1.0, 0.0), (0.0, 1.0)):
                measured = measure(session.drive, session.sizes.hold(d, q))
                v, i = (complex(*x.mean(axis=0)) for x in (measured.v_ab, measured.i_ab))
                assert (v * i.conjugate()).real > 0.0, f"mean v.i is negative at {i:.3f} A: polarity is wrong"
                off = angle_between(np.angle(v), np.angle(i))
                assert off < SIXTY_DEGREES, f"voltage and direct current point {math.degrees(off):.0f} degrees apart"

    def test_captures_turn_with_the_rotor_angle(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            for turned in (SIXTY_DEGREES, -SIXTY_DEGREES):
                measured = measure(session.drive, session.sizes.hold(rotor_angle_rad=turned))
                direction = float(np.angle(complex(*measured.i_ab.mean(axis=0))))
                expected = turned + math.atan2(0.5, 1.0)
                allowed = bounded("angle_tolerance_rad", self.angle_tolerance_rad, 0.2)
                assert angle_between(direction, expected) <= allowed, (
                    f"at a rotor angle of {math.degrees(turned):.0f} degrees the captured current points to "
                    f"{math.degrees(direction):.0f}, expected {math.degrees(expected):.0f}"
                )

    def test_every_claimed_pwm_frequency_works(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            for frequency in session.capabilities.pwm_frequencies_hz:
                measured = measure(session.drive, session.sizes.hold(pwm_frequency_hz=frequency))
                off = abs(complex_dq(measured.i_ab, 0.0).mean() - complex(1.0, 0.5) * session.sizes.current_a)
                assert off <= self.near(session), f"misses its target by {off:.3f} A at {frequency} Hz"

    @pytest.mark.parametrize("swept_axis", ["q", "d", "dq"])
    def test_trapezoid_follows_its_reference(self, tmp_path: Path, swept_axis: str) -> None:
        with self.armed(tmp_path) as session:
            session.requires("trapezoid")
            excitation = session.sizes.trapezoid(swept_axis=swept_axis, rotor_angle_rad=SIXTY_DEGREES)
            measured = measure(session.drive, excitation)
            i_dq = complex_dq(measured.i_ab, SIXTY_DEGREES)
            reference = trapezoid_reference(excitation, len(i_dq), session.capabilities.sampling_frequency_hz)
            distance = float(np.sqrt(np.mean(np.abs(i_dq - reference) ** 2)))
            allowed = bounded("tracking_tolerance", self.tracking_tolerance, 0.4) * excitation.amplitude_a
            assert distance <= allowed, f"{distance:.3f} A rms from the trapezoid asked for ({allowed:.3f} A allowed)"
            self._require_plateaus(session, i_dq, reference)

    def _require_plateaus(self, session: Session, i_dq: np.ndarray, reference: np.ndarray) -> None:
        """The last half of each constant phase must be reached within the tolerance of a hold."""
        rows = round(session.sizes.period_s * session.capabilities.sampling_frequency_hz)
        for begin, end in ((0.25, 0.375), (0.75, 0.875)):
            plateau = slice(round(begin * rows), round(end * rows) - 1)
            off = abs((i_dq[plateau] - reference[plateau]).mean())
            assert off <= self.near(session), f"a constant phase of the trapezoid is off by {off:.3f} A"

    @pytest.mark.parametrize("waveform", ["square", "sine"])
    def test_injection_is_found_in_the_captured_voltage(self, tmp_path: Path, waveform: str) -> None:
        with self.armed(tmp_path) as session:
            session.requires("injection")
            late_s = 10.0 / session.sizes.frequency_hz
            excitation = session.sizes.injection(waveform=waveform, rotor_angle_rad=SIXTY_DEGREES, discard_s=late_s)
            measured = measure(session.drive, excitation)
            found = find_injection(
                measured.v_ab, session.capabilities.sampling_frequency_hz, excitation.waveform, SAMPLES_PER_PERIOD
            )
            assert math.isclose(found.frequency_hz, excitation.frequency_hz, rel_tol=1e-3), (
                f"injects {found.frequency_hz:.2f} Hz instead of {excitation.frequency_hz:.2f} Hz"
            )
            assert abs(found.rotation_hz - excitation.rotation_hz) < 0.1 * excitation.rotation_hz, (
                f"rotates at {found.rotation_hz:.3f} Hz instead of {excitation.rotation_hz:.3f} Hz"
            )
            allowed = bounded("voltage_tolerance", self.voltage_tolerance, 0.1)
            assert math.isclose(found.amplitude_v, excitation.amplitude_v, rel_tol=allowed), (
                f"injects {found.amplitude_v:.2f} V instead of {excitation.amplitude_v:.2f} V"
            )
            expected = SIXTY_DEGREES + 2.0 * math.pi * excitation.rotation_hz * late_s
            assert angle_between(found.direction_rad, expected) <= bounded(
                "angle_tolerance_rad", self.angle_tolerance_rad, 0.2
            ), f"starts at {math.degrees(found.direction_rad):.1f} degrees, expected {math.degrees(expected):.1f}"

    def test_injection_ripples_about_its_target(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("injection")
            excitation = session.sizes.injection(discard_s=session.sizes.settle_s)
            measured = measure(session.drive, excitation)
            target = complex(excitation.target_d_a, excitation.target_q_a)
            reached = complex_dq(measured.i_ab, 0.0).mean()
            assert abs(reached - target) < 0.5 * abs(target), f"ripples about {reached:.3f} A instead of {target:.3f} A"
            follows = ripple_follows_flux(measured.v_ab, measured.i_ab, SAMPLES_PER_PERIOD)
            assert follows > 0.5, f"the ripple current follows the integral of the voltage with {follows:.2f} only"


def _require_contiguous(measured: Measured) -> None:
    for before, after in zip(measured.blocks, measured.blocks[1:], strict=False):
        fs = before.sampling_frequency_hz
        gap = (after.start_s - before.start_s) * fs - len(before)
        assert abs(gap) < 0.01, f"{gap:+.3f} rows between a block and the next"
