"""The descent along kept columns ends where the one that makes them anew ends, and never climbs."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.chords import fit_with_frozen_jacobian
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from plugins.effects.inverter import VoltageBias
from protocols import Contrast, Correction, EffectLayer, EffectParameters, Signals, amplitude
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage


@pytest.fixture(scope="module")
def maker() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, -0.1])))


def test_both_descents_end_in_the_same_place(maker: Fitter) -> None:
    model = with_free(free_model(), maker, VoltageBias())
    anew = maker.fit(model, steps=8, relinearisations=3, tolerance=1e-6)
    kept = fit_with_frozen_jacobian(maker, model, rounds=10, tolerance=1e-6)
    assert kept.objective == pytest.approx(anew.objective, rel=1e-3)
    for name in ("bias_a_v", "bias_b_v"):
        assert kept.model.active[0].values[name] == pytest.approx(anew.model.active[0].values[name], rel=0.01)


def test_more_rounds_do_not_climb(maker: Fitter) -> None:
    model = with_free(free_model(), maker, VoltageBias())
    ends = [fit_with_frozen_jacobian(maker, model, rounds=rounds, tolerance=1e-4).objective for rounds in (0, 1, 3)]
    assert all(after <= before for before, after in itertools.pairwise(ends))
    assert ends[-1] < 0.01 * ends[0]


def test_a_model_without_effects_is_evaluated(maker: Fitter) -> None:
    fit = fit_with_frozen_jacobian(maker, free_model(), rounds=3, tolerance=1e-4)
    assert fit.objective == pytest.approx(maker.evaluate(free_model(), maker.linearise(free_model())).objective)


def test_what_is_taken_from_an_earlier_fit_leads_to_the_same_place(maker: Fitter) -> None:
    model = with_free(free_model(), maker, VoltageBias())
    first = fit_with_frozen_jacobian(maker, model, rounds=1, tolerance=1e-6)
    away = model.with_active([model.active[0].moved("bias_a_v", 5.0)])
    known = fit_with_frozen_jacobian(maker, away, rounds=10, tolerance=1e-6, known=first)
    anew = fit_with_frozen_jacobian(maker, away, rounds=10, tolerance=1e-6)
    assert known.objective == pytest.approx(anew.objective, rel=1e-3)


class BentBias:
    """A voltage along alpha that hardly grows beyond a tenth of its typical size: the secant from nothing is flat."""

    name: ClassVar[str] = "bent_bias"
    summary: ClassVar[str] = "A voltage that soon stops growing."
    signature: ClassVar[str] = "A constant residual."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        size: float = amplitude("1", typical=1.0, prior_width=1.0, low=0.0, high=4.0)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        return Correction(v_ab=signals.v_ab - [0.5 * float(np.tanh(10.0 * p.size)), 0.0])


def test_an_amplitude_that_is_no_multiple_of_its_secant_is_reached() -> None:
    maker = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.15, 0.0])))
    begun = with_free(free_model(), maker, BentBias())
    reached = fit_with_frozen_jacobian(maker, begun, rounds=10, tolerance=1e-4)
    assert 0.5 * np.tanh(10.0 * reached.model.active[0].values["size"]) == pytest.approx(0.15, rel=0.02)


@pytest.mark.slow
def test_steps_that_a_new_frame_undoes_are_not_made_again_and_again(maker: Fitter) -> None:
    tried: list[float] = []

    @dataclass
    class Undoing(Fitter):
        def relinearise(self, model: Model, *args: Any, **known: Any) -> Fit:
            made = super().relinearise(model, *args, **known)
            tried.append(made.model.active[0].values["bias_a_v"])
            return replace(made, objective=made.objective + (1e9 if len(tried) > 1 else 0.0))

    undoing = Undoing(maker.prepared, maker.noise, maker.pm_flux_wb)
    fit = fit_with_frozen_jacobian(undoing, with_free(free_model(), maker, VoltageBias()), rounds=20, tolerance=1e-4)
    assert fit.model.active[0].values["bias_a_v"] == 0.0
    assert 1 < len(tried) < 8
