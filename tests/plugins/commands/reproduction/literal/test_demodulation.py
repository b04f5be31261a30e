"""The printed demodulator on currents that are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from orchestrator.numerics.types import Array
from plugins.commands.reproduction.literal._demodulation import VirtualMeasurement, hessian, virtual_measurement
from protocols import Capture, NotMeasuredError, Segment, SegmentStage

RATE_HZ, FREQUENCY_HZ, AMPLITUDE_V = 10_000.0, 500.0, 40.0
HESSIAN = np.array([[30.0, 2.0], [2.0, 15.0]])
MEAN = np.array([1.5, -0.7])


def injected(
    seconds: float, *, rotation_hz: float = 1.0, angle_rad: float = 0.0, frequency_hz: float = FREQUENCY_HZ
) -> tuple[Segment, Capture]:
    """A linear motor without resistance, its current in the frame of angle zero."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    phase = (t * frequency_hz) % 1.0
    triangle = np.where(phase < 0.5, phase - 0.25, 0.75 - phase) / frequency_hz
    turned = 2.0 * np.pi * rotation_hz * t + angle_rad
    psi = AMPLITUDE_V * triangle[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=1)
    settings: dict[str, Any] = {"amplitude_v": AMPLITUDE_V, "frequency_hz": frequency_hz, "rotation_hz": rotation_hz}
    segment = Segment(
        id="injection-000",
        stage=SegmentStage.INJECTION,
        start_s=0.0,
        samples=len(t),
        rotor_angle_rad=angle_rad,
        settings=settings,
    )
    nothing = np.zeros((len(t), 2), np.float32)
    capture = Capture(
        start_s=0.0, sampling_frequency_hz=RATE_HZ, i_ab=MEAN + psi @ HESSIAN, v_ab=nothing, v_dc=nothing[:, 0]
    )
    return segment, capture


def measured(seconds: float, **settings: float) -> VirtualMeasurement:
    return virtual_measurement(*injected(seconds, **settings), angle_rad=0.0)


def worst(found: Array) -> float:
    return float(np.abs(found - HESSIAN).max() / np.abs(HESSIAN).max())


def test_the_ripple_is_the_hessian_times_the_injected_vector_at_every_instant() -> None:
    signal = measured(1.0)
    assert np.abs(signal.ripple - signal.swing @ HESSIAN).max() < 2e-3 * np.abs(signal.ripple).max()
    assert np.abs(signal.mean - MEAN).max() < 1e-3


def test_a_vector_that_turns_gives_the_whole_matrix() -> None:
    assert worst(hessian([measured(1.0)])) < 1e-4


def test_two_vectors_that_stand_give_the_whole_matrix() -> None:
    stood = [measured(0.2, rotation_hz=0.0, angle_rad=angle) for angle in (0.0, np.pi / 2.0)]
    assert worst(hessian(stood)) < 1e-6


def test_one_vector_that_stands_gives_none() -> None:
    with pytest.raises(NotMeasuredError, match="along one axis"):
        hessian([measured(0.2, rotation_hz=0.0)])


def test_periods_of_odd_samples_are_refused() -> None:
    with pytest.raises(NotMeasuredError, match="an even number"):
        measured(0.2, frequency_hz=RATE_HZ / 15)


def test_captures_shorter_than_three_periods_are_refused() -> None:
    with pytest.raises(NotMeasuredError, match="fewer than three periods"):
        measured(0.005)
