"""An effect of one's own that declares nothing is compared by its signal; installed effects by their contrasts."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.guarded import guarded
from orchestrator.diagnosis.selection.adding import add_moves
from orchestrator.diagnosis.selection.separation import inseparable_from
from plugins.effects.inverter import DeadTime, VoltageBias
from protocols import Contrast, Effect
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage
from tests.orchestrator.diagnosis.selection.states import made, state_of, view_of


class Undeclared(VoltageBias):
    name: ClassVar[str] = "undeclared"
    needs: ClassVar[tuple[Contrast, ...]] = ()


@pytest.fixture(scope="module")
def biased() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, -0.1])))


@pytest.mark.parametrize(
    ("present", "other", "inseparable"),
    [
        (VoltageBias(), guarded(Undeclared()), {"undeclared"}),
        (guarded(Undeclared()), VoltageBias(), {"voltage_bias"}),
        (VoltageBias(), Undeclared(), set()),  # installed: what it declares holds
        (VoltageBias(), DeadTime(), set()),
    ],
)
def test_an_own_effect_is_inseparable_from_what_it_resembles(
    biased: Fitter, present: Effect, other: Effect, inseparable: set[str]
) -> None:
    fit = biased.fit(with_free(free_model(), biased, present))
    (candidate,) = scaled_library([other], biased.prepared.manifest)
    assert inseparable_from(biased, fit, fit.model.active[0], [candidate]) == inseparable


def test_an_own_effect_that_resembles_the_one_added_is_its_twin_and_is_not_added_beside_it(biased: Fitter) -> None:
    library = scaled_library([VoltageBias(), guarded(Undeclared())], biased.prepared.manifest)
    state = state_of(biased)
    (move,) = add_moves(state, view_of(state, library), library)
    after = made(move)
    (name,) = after.fit.model.names
    assert {name, *after.indistinguishable[name]} == {"voltage_bias", "undeclared"}
    assert not list(add_moves(after, view_of(after, library), library))
