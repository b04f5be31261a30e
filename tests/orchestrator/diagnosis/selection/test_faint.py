"""What is too faint to be a cause is measured all the same."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.selection.faint import with_faint
from orchestrator.diagnosis.selection.forward_search import Search, Step
from plugins.effects.inverter import VoltageBias
from plugins.effects.resistance import PhaseResistanceImbalance
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, many_holds, prepared, setup_of, with_voltage

SEEN = ["voltage_bias", "phase_resistance_imbalance"]


def test_what_shows_is_in_the_model_with_its_size_and_no_cause() -> None:
    setup = setup_of(fitter(with_voltage(prepared(many_holds()), np.array([0.003, 0.0]))))
    library = scaled_library([VoltageBias(), PhaseResistanceImbalance()], setup.prepared.manifest)
    bare = Search([Step(None, setup.fitter.fit(free_model()))])
    search = with_faint(setup, bare, library, SEEN)
    (bias,) = search.fit.model.active
    assert search.minor == (bias.name,) == ("voltage_bias",)
    assert bias.values["bias_a_v"] == pytest.approx(0.003, rel=0.2)
    assert search.fit.chi2_per_dof < bare.fit.chi2_per_dof
    assert [step.added for step in search.steps] == [None, "voltage_bias"]
    assert search.steps[-1].log_evidence > search.fit.criteria.selection.log_evidence


def test_what_chance_could_have_made_stays_out() -> None:
    setup = setup_of(fitter(prepared(many_holds())))
    library = scaled_library([VoltageBias(), PhaseResistanceImbalance()], setup.prepared.manifest)
    search = Search([Step(None, setup.fitter.fit(free_model()))])
    assert with_faint(setup, search, library, SEEN) is search


def test_beside_a_cause_it_may_be_the_form_of_that_one() -> None:
    setup = setup_of(fitter(with_voltage(prepared(many_holds()), np.array([0.3, 0.0]))))
    library = scaled_library([VoltageBias(), PhaseResistanceImbalance()], setup.prepared.manifest)
    first = setup.fitter.fit(free_model())
    found = setup.fitter.fit(with_free(first.model, setup.fitter, VoltageBias()))
    search = Search([Step(None, first), Step("voltage_bias", found, 100.0)])
    assert with_faint(setup, search, library, SEEN) is search
