"""Current control: bandwidth and phase margin over the map's errors."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from orchestrator.tuning.current_control import (
    INTEGRAL_RATIO,
    PHASE_MARGIN_RAD,
    current_control,
    phase_margin,
    phase_margin_at,
)
from orchestrator.tuning.limits import DriveLimits
from protocols import InputError
from tests.orchestrator.tuning.machines import linear, machine, saturated

LIMITS = DriveLimits(current_a=2.8, bus_v=300.0, speed_rad_s=1500.0, sampling_hz=10e3, pwm_hz=10e3)


def test_the_phase_margin_is_that_of_the_open_loop() -> None:
    alpha, delay, factor = 2500.0, 1.8e-4, 1.3
    w = np.geomspace(10.0, 1e5, 400_001)
    loop = factor * alpha * (1.0 + INTEGRAL_RATIO * alpha / (1j * w)) / (1j * w) * np.exp(-1j * w * delay)
    crossing = int(np.argmax(np.abs(loop) < 1.0))
    assert phase_margin(alpha, delay, factor) == pytest.approx(math.pi + float(np.angle(loop[crossing])), abs=1e-3)


def test_the_margin_holds_over_the_band_and_costs_bandwidth() -> None:
    sure, unsure = (current_control(machine(saturated(), std=std), LIMITS) for std in (0.0, 0.05))
    for made in (sure, unsure):
        assert made.least_phase_margin_deg == pytest.approx(math.degrees(PHASE_MARGIN_RAD), abs=1e-6)
    assert unsure.bandwidth_rad_s < 0.95 * sure.bandwidth_rad_s
    assert unsure.phase_margin_deg > sure.phase_margin_deg


def test_a_delay_costs_bandwidth_in_proportion() -> None:
    made = machine(linear(0.04, 0.07, 0.3))
    plain, late = current_control(made, LIMITS), current_control(made, LIMITS, 1.5e-4)
    assert plain.delay_s == pytest.approx(1.5e-4)
    assert late.bandwidth_rad_s == pytest.approx(0.5 * plain.bandwidth_rad_s)


def test_the_margin_at_speed_is_that_of_standstill_there_and_falls_with_speed_and_errors() -> None:
    sure, unsure = (current_control(machine(saturated(), std=std), LIMITS) for std in (0.0, 0.05))
    for made in (sure, unsure):
        margins = [math.degrees(phase_margin_at(made, speed)) for speed in (0.0, 500.0, 1500.0, 3000.0)]
        assert margins[0] == pytest.approx(made.least_phase_margin_deg, abs=1.0)
        assert margins == sorted(margins, reverse=True)
        assert margins[-1] < margins[0] - 10.0
    same_gains = dataclasses.replace(sure, model_factor=1.1)
    assert phase_margin_at(same_gains, 1500.0) < phase_margin_at(sure, 1500.0)


def test_a_filter_s_delay_takes_from_the_margin_at_speed_in_proportion_to_the_crossover() -> None:
    control = current_control(machine(saturated()), LIMITS)
    later = dataclasses.replace(control, delay_s=control.delay_s + 2e-5)
    lost = phase_margin_at(control, 0.0) - phase_margin_at(later, 0.0)
    assert lost == pytest.approx(2e-5 * control.bandwidth_rad_s, rel=0.03)


def test_flux_and_inductance_tables_are_the_map_s() -> None:
    made = machine(saturated())
    control = current_control(made, LIMITS)
    at = np.array([[control.i_d_a[5], control.i_q_a[20]]])
    assert control.psi_wb[5, 20] == pytest.approx(made.psi(at)[0])
    gains = np.array([[control.gain_i_d_a[3], control.gain_i_q_a[7]]])
    matrix = made.inductance(gains)[0]
    assert control.inductance_h[3, 7] == pytest.approx([matrix[0, 0], matrix[0, 1], matrix[1, 1]])


def test_a_map_that_does_not_know_its_inductance_is_refused() -> None:
    with pytest.raises(InputError, match="may be zero within its error"):
        current_control(machine(linear(0.04, 0.07, 0.3), std=0.6), LIMITS)
