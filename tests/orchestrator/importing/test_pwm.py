"""The PWM frequency of a segment, by a column or by the edges of the switching states."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.recording import open_recording
from protocols import InputError
from tests.orchestrator.importing.benches import Bench, held_current


def frequencies_hz(bench: Bench) -> list[object]:
    """What the settings of each segment state."""
    return [s.settings.get("pwm_frequency_hz") for s in open_recording(bench.folder / "recording").segments()]


@pytest.mark.parametrize(("unit", "factor"), [("Hz", 1.0), ("kHz", 1e-3)])
def test_a_column_splits_a_hold_at_two_frequencies(bench: Bench, unit: str, factor: float) -> None:
    n = len(next(iter(bench.columns.values())))
    bench.columns["f_pwm"] = np.where(np.arange(n) < n // 2, 10e3, 20e3) * factor
    bench.mapping["drive"] = {**bench.mapping["drive"], "pwm_frequency_hz": 10e3}
    bench.mapping["pwm_frequency"] = {"column": "f_pwm", "unit": unit}
    bench.run()
    assert frequencies_hz(bench) == [None, 20e3]


def test_a_column_that_contradicts_a_rule_is_an_error(bench: Bench) -> None:
    bench.columns["f_pwm"] = np.full(len(next(iter(bench.columns.values()))), 10e3)
    bench.mapping["pwm_frequency"] = {"column": "f_pwm", "unit": "Hz"}
    bench.mapping["segments"] = [{"stage": "resistance", "settings": {"pwm_frequency_hz": 20e3}}]
    with pytest.raises(InputError, match=r"segments\.0\.settings\.pwm_frequency_hz: the rows show .* 10000 Hz, this"):
        bench.run()


@pytest.mark.parametrize("pwm_hz", [5e3, 12.5e3])
def test_switching_states_show_their_own_frequency(bench: Bench, pwm_hz: float) -> None:
    rate, n = 1e6, 40000
    i, v = held_current(n)
    carrier = 2.0 * np.abs(np.arange(n) * pwm_hz / rate % 1.0 - 0.5)
    axes = np.array([0.0, 2.0, 4.0]) * np.pi / 3.0
    duty = 0.5 + (v[:, :1] * np.cos(axes) + v[:, 1:] * np.sin(axes)) / 540.0
    state = (duty > carrier[:, None]) @ [4, 2, 1]
    bench.columns = {"t": np.arange(n) / rate, "i_alpha": i[:, 0], "i_beta": i[:, 1], "sv": state.astype(float)}
    alpha_beta = {"alpha": "i_alpha", "beta": "i_beta"}
    bench.mapping |= {
        "drive": {**bench.mapping["drive"], "pwm_frequency_hz": 10e3},
        "time": {"column": "t", "unit": "s"},
        "current": {"frame": "alpha_beta", "columns": alpha_beta, "unit": "A", "scaling": "amplitude_invariant"},
        "voltage": {"frame": "switching", "columns": {"state": "sv"}, "unit": "duty", "numbering": "bits_abc"},
    }
    bench.run()
    (found,) = frequencies_hz(bench)
    assert found == pytest.approx(pwm_hz, rel=0.005)
