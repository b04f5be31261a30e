"""Angles that are not what was believed: each correction undoes the catalogue's equation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.effects.frame import BrakeBacklash, BrakeCompliance, RotorMisalignment
from tests.plugins.effects.readings import FS, corrected, readings, reads
from tests.support.close import assert_close


def test_misalignment_is_true_minus_believed() -> None:
    out = corrected(RotorMisalignment(), readings(), angle_rad=-0.03)
    assert out.theta_rad[0] == pytest.approx(0.17)


def test_a_brake_with_play_lies_at_the_end_that_the_torque_points_to() -> None:
    signals = readings()
    flux = 0.3 * np.array([math.cos(0.2), math.sin(0.2)])
    quarter = np.array([-math.sin(0.2), math.cos(0.2)])
    for q in (2.0, -2.0, 1e-3):
        at = replace(signals, psi_ab=np.tile(flux, (400, 1)), i_ab=np.tile(q * quarter, (400, 1)))
        turned = corrected(BrakeBacklash(), at, gap_rad=0.01, friction_nm=0.05, lag_s=1e-3).theta_rad - 0.2
        torque = 1.5 * 2 * 0.3 * q
        expected = 0.005 * torque / math.hypot(torque, 0.05)
        assert_close(turned, np.full(400, expected), 1e-9, of=[0.01])


def test_brake_twists_with_the_torque() -> None:
    signals = readings()
    axis = np.array([math.cos(0.2), math.sin(0.2)])
    psi = np.tile(0.3 * axis, (400, 1))
    out = corrected(BrakeCompliance(), replace(signals, psi_ab=psi), rad_per_nm=0.005)
    i_q = -math.sin(0.2) * signals.i_ab[0, 0] + math.cos(0.2) * signals.i_ab[0, 1]
    assert out.theta_rad[0] - 0.2 == pytest.approx(0.005 * 1.5 * 2 * 0.3 * i_q)


@pytest.mark.parametrize("hz", [20.0, 159.0, 700.0])
def test_a_rotor_swings_on_its_brake_as_a_spring_with_inertia_and_friction(hz: float) -> None:
    """The torque's amplitude and phase, 1 / (1 + j w lag - w^2 inertia), once what began it has died away."""
    n, lag_s, inertia_s2 = 4000, 4e-4, 1e-6
    omega = 2.0 * math.pi * hz
    time_s = np.arange(n) / FS
    along = np.stack([np.cos(np.full(n, 0.2)), np.sin(np.full(n, 0.2))], axis=1)
    signals = reads(readings(n), np.sin(omega * time_s)[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1))
    signals = replace(signals, psi_ab=0.3 * along)
    out = corrected(BrakeCompliance(), signals, rad_per_nm=0.005, lag_s=lag_s, inertia_s2=inertia_s2)
    twist = 0.005 * 1.5 * 2 * 0.3 / (1.0 + 1j * omega * lag_s - omega**2 * inertia_s2)
    expected = np.imag(twist * np.exp(1j * omega * time_s))
    # A reading every 14th of a period is a chord of the sine.
    assert_close((out.theta_rad - 0.2)[n // 2 :], expected[n // 2 :], 0.02, of=[abs(twist)])
    light = corrected(BrakeCompliance(), signals, rad_per_nm=0.005, lag_s=lag_s, inertia_s2=1e-14)
    without = corrected(BrakeCompliance(), signals, rad_per_nm=0.005, lag_s=lag_s)
    assert_close(light.theta_rad, without.theta_rad, 1e-6, of=[abs(twist)])


@given(
    hz=st.floats(1e3, 1e5),
    lag_s=st.floats(math.log(1e-5), math.log(0.1)).map(math.exp),
    inertia_s2=st.floats(math.log(1e-30), math.log(1e-3)).map(math.exp),
)
def test_a_rotor_at_rest_stays_at_rest_whatever_its_inertia(hz: float, lag_s: float, inertia_s2: float) -> None:
    along = np.tile([math.cos(0.2), math.sin(0.2)], (400, 1))
    signals = reads(readings(), 2.0 * np.stack([-along[:, 1], along[:, 0]], axis=1))
    signals = replace(signals, psi_ab=0.3 * along, sampling_frequency_hz=hz)
    out = corrected(BrakeCompliance(), signals, rad_per_nm=0.005, lag_s=lag_s, inertia_s2=inertia_s2)
    assert_close(out.theta_rad - 0.2, np.full(400, 0.005 * 1.5 * 2 * 0.3 * 2.0), 1e-6, of=[0.01])


@pytest.mark.parametrize("friction_nm", [0.1, 0.5, 1.5])
@pytest.mark.parametrize("elastic", [0.0, 0.3])
def test_a_brake_with_dry_friction_loses_its_work_at_each_turn(friction_nm: float, elastic: float) -> None:
    """The loop of torque and twist has the area 4 F (T - F) kappa of a spring behind a friction F; none below it."""
    n, period = 4000, 1000
    along = np.tile([math.cos(0.2), math.sin(0.2)], (n, 1))
    wave = np.sin(2.0 * math.pi * np.arange(n) / period)
    signals = reads(readings(n), wave[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1))
    signals = replace(signals, psi_ab=0.3 * along)
    parameters = {"rad_per_nm": 0.005, "lag_s": 1e-5, "friction_nm": friction_nm, "elastic": elastic}
    twist = corrected(BrakeCompliance(), signals, **parameters).theta_rad - 0.2
    largest = 1.5 * 2 * 0.3
    slides = max(largest - friction_nm, 0.0)
    area = float(np.sum(twist[-period:] * np.gradient(largest * wave)[-period:]))
    assert abs(area) == pytest.approx(4.0 * friction_nm * slides * 0.005 * (1.0 - elastic), rel=0.01, abs=1e-5)
    reached = 0.005 * (elastic * largest + (1.0 - elastic) * slides)
    assert np.ptp(twist[-period:]) == pytest.approx(2.0 * reached, rel=0.01, abs=1e-9)


def test_a_brake_with_dry_friction_remembers_from_where_the_torque_came() -> None:
    along = np.tile([math.cos(0.2), math.sin(0.2)], (400, 1))
    across = np.array([-math.sin(0.2), math.cos(0.2)])
    signals = replace(reads(readings(), np.tile(2.0 * across, (400, 1))), psi_ab=0.3 * along)
    for came_from_a, sign in ((0.0, -1.0), (4.0, 1.0)):
        at = replace(signals, came_from_ab=came_from_a * across[None])
        twist = corrected(BrakeCompliance(), at, rad_per_nm=0.005, lag_s=1e-5, friction_nm=0.2).theta_rad - 0.2
        assert_close(twist, np.full(400, 0.005 * (1.5 * 2 * 0.3 * 2.0 + sign * 0.2)), 1e-6, of=[0.01])
