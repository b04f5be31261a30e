"""Unequal gains as rivals: what they do to currents and voltages."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.screening.unequal_gains import Stretch, UnequalCurrentGains, UnequalVoltageGains
from orchestrator.testing import exciting_signals

S = np.array([[1.03, 0.01], [0.01, 0.97]])


@pytest.mark.parametrize(("effect", "array"), [(UnequalCurrentGains(), "i_ab"), (UnequalVoltageGains(), "v_ab")])
def test_each_axis_has_its_gain_and_both_together_have_none(
    effect: UnequalCurrentGains | UnequalVoltageGains, array: str
) -> None:
    signals = exciting_signals()
    corrected = getattr(effect.correct(signals, Stretch(along_a=0.03, between=0.01)), array)
    np.testing.assert_allclose(corrected, getattr(signals, array) @ S, rtol=1e-12)
    np.testing.assert_array_equal(
        getattr(effect.correct(signals, Stretch(along_a=0.0, between=0.0)), array), getattr(signals, array)
    )
    other = "v_ab" if array == "i_ab" else "i_ab"
    assert getattr(effect.correct(signals, Stretch(along_a=0.03, between=0.01)), other) is None
