"""The signals of a current of one's own."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.testing import signals_of
from plugins.effects.inverter import DeviceDrop
from protocols import InputError


def test_signals_are_of_the_given_current_and_voltage() -> None:
    signals = signals_of([[1, 2]] * 3, v_ab=[[10, 0]] * 3)
    np.testing.assert_array_equal(signals.i_ab, [[1.0, 2.0]] * 3)
    np.testing.assert_array_equal(signals.v_ab, [[10.0, 0.0]] * 3)
    np.testing.assert_allclose(signals.heat_j, np.arange(1, 4) * 1.5 * 4.0 * 5.0 / 10000.0)


def test_an_effect_of_the_library_has_its_sign_there() -> None:
    signals, effect = signals_of([[3.0, 0.0]] * 3), DeviceDrop()
    assert effect.correct(signals, effect.Parameters(voltage_v=1.0)).arrays["v_ab"][-1, 0] < 0.0


def test_another_shape_is_refused() -> None:
    with pytest.raises(InputError, match="i_ab"):
        signals_of([1.0, 2.0])
