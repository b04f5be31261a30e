"""Effects that resemble each other are reported with the one that fits better, whatever their declarations."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.guarded import guarded
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.benefit import added_remark
from orchestrator.diagnosis.reporting.resemblance import (
    Alternative,
    alternative_remarks,
    inseparable_remark,
    needed_remarks,
    own_alternatives,
    pair_remarks,
    refitted_ties,
    resembling_pairs,
    separated_remarks,
    separately_needed,
    with_tied,
)
from plugins.effects.inverter import DeadTime, VoltageBias
from protocols import Contrast, Correction, Effect, EffectLayer, EffectParameters, Inseparable, Signals, amplitude
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, setup_of, with_effects, with_voltage


class SameBias(VoltageBias):
    name: ClassVar[str] = "same_bias"
    needs: ClassVar[tuple[Contrast, ...]] = ()


class AlphaBias:
    """A constant voltage along one axis alone."""

    name: ClassVar[str] = "alpha_bias"
    summary: ClassVar[str] = "A constant voltage along alpha."
    signature: ClassVar[str] = "A constant residual along alpha."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        bias_v: float = amplitude("V", typical=0.1, prior_width=0.2, low=-10.0, high=10.0)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        return Correction(v_ab=signals.v_ab - np.array([p.bias_v, 0.0]))


@pytest.fixture(scope="module")
def maker() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.1])))


def fitted(maker: Fitter, *effects: Effect) -> Fit:
    terms = [with_free(free_model(), maker, effect).active[0] for effect in effects]
    return maker.fit(free_model().with_active(terms))


def remarks(maker: Fitter, effect: Effect, *others: Effect) -> list[tuple[str, str]]:
    library = scaled_library([effect, *others], maker.prepared.manifest)
    fit = maker.fit(free_model().with_active([library[0].absent()]))
    return [(one.code, one.text) for one in alternative_remarks(own_alternatives(setup_of(maker), fit, library))]


def test_an_own_effect_like_one_of_the_model_is_indistinguishable_from_it(maker: Fitter) -> None:
    ((code, text),) = remarks(maker, VoltageBias(), guarded(SameBias()))
    assert code == "indistinguishable"
    assert text.startswith("voltage bias and same bias are indistinguishable here: chi2 ")
    assert text.endswith("; what was measured leaves the same residual with either, within the noise")


def test_an_installed_effect_that_fits_better_takes_an_own_one_s_certainty(maker: Fitter) -> None:
    ((code, text),) = remarks(maker, guarded(AlphaBias()), VoltageBias())
    assert code == "fits_better_in_place"
    assert text.startswith("voltage bias resembles alpha bias and fits better in its place: chi2 ")
    assert text.endswith(" nat); alpha bias is no certain cause")


def test_log_evidence_that_contradicts_chi2_says_what_else_it_counts(maker: Fitter) -> None:
    library = scaled_library([VoltageBias(), AlphaBias()], maker.prepared.manifest)
    better, worse = fitted(maker, VoltageBias()), fitted(maker, AlphaBias())
    assert better.chi2_per_dof < worse.chi2_per_dof
    names = [candidate.name for candidate in library]
    (agrees,) = alternative_remarks([Alternative(names[1], names[0], worse, better, 50.0)])
    (contradicts,) = alternative_remarks([Alternative(names[0], names[1], better, worse, 50.0)])
    assert "how many parameters" not in agrees.text
    assert "+50 nat, which counts also how many parameters fit" in contradicts.text


def test_installed_effects_alone_are_not_refitted(maker: Fitter) -> None:
    assert remarks(maker, VoltageBias(), DeadTime()) == []


def test_two_alike_in_one_model_are_one_pair_and_each_other_s_twins(maker: Fitter) -> None:
    fit = fitted(maker, VoltageBias(), guarded(SameBias()))
    pairs = resembling_pairs(maker, fit, ["same_bias", "voltage_bias"])
    assert pairs == [("same_bias", "voltage_bias")]
    (remark,) = pair_remarks(pairs)
    assert "does not determine their sizes separately" in remark.text
    assert with_tied({}, [], pairs) == {"same_bias": ["voltage_bias"], "voltage_bias": ["same_bias"]}


def test_a_pair_of_which_the_data_need_both_is_no_pair_of_undetermined_sizes(maker: Fitter) -> None:
    alike = ("voltage_bias", "same_bias")
    fit = fitted(maker, VoltageBias(), guarded(SameBias()))
    assert separately_needed(maker, fit, [alike]) == ([alike], [])
    (hidden,) = with_free(free_model(), maker, DeadTime(), voltage_v=-2.0).active
    both = fitter(with_effects(maker.prepared, [hidden]))
    fit, different = fitted(both, VoltageBias(), DeadTime()), ("voltage_bias", "dead_time")
    tied, needed = separately_needed(both, fit, [different])
    assert tied == []
    (text,) = [one.text for one in needed_remarks(needed)]
    assert text.startswith("voltage bias and dead time resemble each other, and the recording needs both: chi2 rises ")
    assert min(needed[0].chi2_without) > 2.0 * needed[0].chi2


def test_an_effect_that_helps_beside_its_like_only_may_help(maker: Fitter) -> None:
    before, after = maker.fit(free_model()), fitted(maker, VoltageBias())
    assert added_remark("voltage_bias", before, after, None).code == "helps"
    reported = added_remark("voltage_bias", before, after, None, ["same_bias"])
    assert reported.code == "helps_besides"
    assert reported.text.endswith("; but it resembles same bias: their sizes are not determined separately")


def test_what_is_tied_already_is_stated_once(maker: Fitter) -> None:
    (one,) = own_alternatives(
        setup_of(maker),
        fitted(maker, VoltageBias()),
        scaled_library([VoltageBias(), guarded(SameBias())], maker.prepared.manifest),
    )
    assert with_tied({"voltage_bias": ["same_bias"]}, [one], []) == {"voltage_bias": ["same_bias"]}


def test_what_the_search_could_not_distinguish_is_refitted_in_the_final_model(maker: Fitter) -> None:
    fit = fitted(maker, VoltageBias())
    library = scaled_library([VoltageBias(), SameBias(), AlphaBias(), DeadTime()], maker.prepared.manifest)
    of_search = {"voltage_bias": ["same_bias", "alpha_bias"], "dead_time": ["alpha_bias"]}
    refitted = refitted_ties(setup_of(maker), fit, of_search, library, [])
    assert {one.other: one.is_tied for one in refitted} == {"same_bias": True, "alpha_bias": False}
    assert with_tied(of_search, refitted, [])["voltage_bias"] == ["same_bias"]
    (remark,) = separated_remarks(refitted)
    assert remark.text.startswith("voltage bias and alpha bias are separated, by ")
    (worse,) = (one for one in refitted if one.other == "alpha_bias")
    assert worse.sigmas**2 == pytest.approx((worse.in_place.objective - fit.objective) / max(1.0, fit.chi2_per_dof))


def test_a_pair_whose_stage_was_measured_states_the_separation_that_was_reached() -> None:
    pair = Inseparable(separates=("dead_time", "device_drop"), best_sigmas=1.2, least_sigmas=5.0, reached_sigmas=3.6)
    text = inseparable_remark(pair).text
    assert "measured already, and the recording separates them by 3.6 sigma where 5 are needed" in text
    assert (
        "not separable by any experiment" in inseparable_remark(pair.model_copy(update={"reached_sigmas": None})).text
    )
