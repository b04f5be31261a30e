from __future__ import annotations

import numpy as np
import pytest

from orchestrator.validation.plausibility import (
    MAX_VOLTAGE_RATIO,
    PLAUSIBLE_BOUNDS,
    POSSIBLE_BOUNDS,
    is_reversed,
    outside,
    rms,
    slow_part,
    suspicious_phase_rad,
    within,
)


def test_what_is_refused_was_doubted_before() -> None:
    for name in ("rated_currents", "bus_voltages", "bus", "resistance", "inductance"):
        (low, high), (lowest, highest) = getattr(PLAUSIBLE_BOUNDS, name), getattr(POSSIBLE_BOUNDS, name)
        assert lowest <= low < high <= highest
        assert high / low >= 10.0


def test_a_bridge_can_make_what_is_not_doubted() -> None:
    assert within(MAX_VOLTAGE_RATIO, PLAUSIBLE_BOUNDS.bus_voltages)
    assert within(1.0, PLAUSIBLE_BOUNDS.bus)
    assert within(540.0, PLAUSIBLE_BOUNDS.bus, 540.0)
    assert not within(0.54, PLAUSIBLE_BOUNDS.bus, 540.0)


def test_only_numbers_that_are_there_are_out_of_their_range() -> None:
    ranges = {"a": (0.0, 1.0), "b": (0.0, 1.0), "c": (0.0, 1.0), "d": (0.0, 1.0)}
    found = dict(outside({"a": 0.5, "b": 2.0, "c": "2.0"}, ranges, "why"))
    assert found == {"b": "2 is not between 0 and 1: why"}


@pytest.mark.parametrize("degrees", [0.0, 59.0, -59.0])
def test_a_winding_takes_power(degrees: float) -> None:
    assert suspicious_phase_rad(np.exp(1j * np.radians(degrees)), 1.0, 1.0) is None


@pytest.mark.parametrize(("degrees", "reverse"), [(180.0, True), (-170.0, True), (120.0, False), (-61.0, False)])
def test_voltage_and_current_far_apart_are_reversed_or_exchanged(degrees: float, reverse: bool) -> None:
    angle = suspicious_phase_rad(6.0 * np.exp(1j * np.radians(degrees)), 4.0, 9.0)
    assert angle is not None
    assert angle == pytest.approx(np.radians(degrees))
    assert is_reversed(angle) == reverse


def test_voltage_that_does_not_go_with_the_current_says_nothing() -> None:
    assert suspicious_phase_rad(-0.4 + 0j, 1.0, 1.0) is None
    assert suspicious_phase_rad(0j, 0.0, 1.0) is None


def test_the_slow_part_is_without_the_ripple_and_rms_is_of_lengths() -> None:
    time = np.arange(10_000) / 10_000.0
    wave = np.stack([np.cos(2 * np.pi * 500.0 * time), np.sin(2 * np.pi * 500.0 * time)], axis=1)
    assert rms(wave) == pytest.approx(1.0, rel=1e-12)
    assert rms(slow_part(wave, 10_000.0)) < 1e-12
    np.testing.assert_allclose(
        slow_part(wave + np.array([3.0, -4.0]), 10_000.0), np.tile([3.0, -4.0], (50, 1)), rtol=1e-12
    )
