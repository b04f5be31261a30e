"""A motor from its flux map: torque, inductance, errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from protocols import InputError
from tests.orchestrator.tuning.machines import linear, machine, saturated


def test_torque_is_that_of_the_textbook() -> None:
    made = machine(linear(0.04, 0.07, 0.3), pole_pairs=3)
    i_dq = np.array([[-1.0, 2.0], [0.5, -1.5], [0.0, 3.0]])
    expected = 1.5 * 3 * (0.3 * i_dq[:, 1] + (0.04 - 0.07) * i_dq[:, 0] * i_dq[:, 1])
    assert made.torque_nm(i_dq) == pytest.approx(expected, rel=1e-9)


def test_inductance_is_the_slope_of_the_flux_and_symmetric() -> None:
    flux = saturated()
    made = machine(flux)
    at, step = np.array([[-1.3, 1.7], [0.4, 2.2]]), 1e-4
    slopes = np.stack([(flux(at + step * e) - flux(at - step * e)) / (2.0 * step) for e in np.eye(2)], axis=-1)
    assert made.inductance(at) == pytest.approx(slopes, rel=2e-3, abs=1e-5)
    assert made.inductance(at) == pytest.approx(made.inductance(at).transpose(0, 2, 1), rel=1e-12)


def test_errors_of_the_map_come_with_it() -> None:
    made = machine(linear(0.04, 0.07, 0.3), std=0.01)
    assert made.inductance_std(np.array([[1.0, 1.0]])) == pytest.approx(
        np.array([[4e-4, 0.0, 7e-4]]), rel=1e-6, abs=1e-9
    )


def test_a_resistance_of_zero_is_refused() -> None:
    with pytest.raises(InputError, match="expected a positive resistance"):
        machine(linear(0.04, 0.07, 0.3), r_s_ohm=0.0)


def test_an_infinite_error_is_refused() -> None:
    made = machine(linear(0.04, 0.07, 0.3), std=0.01)
    unknown = dataclasses.replace(
        made, flux_map=made.flux_map.model_copy(update={"l_dd_std": np.full((25, 25), np.inf)})
    )
    with pytest.raises(InputError, match="l_dd_std: a standard deviation is infinite"):
        unknown.inductance_std(np.zeros((1, 2)))
