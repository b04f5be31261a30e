"""Effects that say by themselves how large they are: in the model first, as far as the equations ask for them."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis._prepare import setup_of
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.selection.first_models import include_measured
from orchestrator.diagnosis.selection.search_state import AcceptedModel
from orchestrator.diagnosis.weak_form.noise import sensor_noise
from plugins.effects.inverter import VoltageBias
from protocols import Effect, PluginError, Signals
from tests.orchestrator.diagnosis.pieces import free_model, plan, prepared, with_voltage


class Sure(VoltageBias):
    """A bias that it says it has measured."""

    says = 0.2

    def measured(self, signals: list[Signals]) -> VoltageBias.Parameters | None:
        return self.Parameters(bias_a_v=self.says) if len(signals) > 1 else None


class Wrong(Sure):
    def measured(self, signals: list[Signals]) -> VoltageBias.Parameters | None:
        raise ValueError("no idea")


def _setup(bias_v: float) -> DiagnosisSetup:
    made = with_voltage(prepared(plan(sparse=True)), np.array([bias_v, 0.0]))
    return setup_of(made, sensor_noise(made.pieces))


def _steps(bias_v: float, effect: Effect) -> list[AcceptedModel]:
    setup = _setup(bias_v)
    bare = AcceptedModel(None, setup.fitter.fit(free_model()))
    return include_measured(setup, [bare], scaled_library([effect], setup.prepared.manifest))


def test_what_was_measured_is_in_the_model_and_fitted_from_there() -> None:
    bare, named = _steps(0.3, Sure())
    assert (bare.added, named.added) == (None, "voltage_bias")
    assert named.fit.model.active[0].values["bias_a_v"] == pytest.approx(0.3, rel=0.02)
    assert named.log_evidence > 100.0


def test_what_the_equations_do_not_ask_for_is_left_out() -> None:
    assert [step.added for step in _steps(0.0, Sure())] == [None]


def test_an_effect_that_says_nothing_is_left_to_the_search() -> None:
    assert [step.added for step in _steps(0.3, VoltageBias())] == [None]


def test_an_effect_that_fails_to_say_is_named() -> None:
    with pytest.raises(PluginError, match="measured: ValueError: no idea"):
        _steps(0.3, Wrong())
