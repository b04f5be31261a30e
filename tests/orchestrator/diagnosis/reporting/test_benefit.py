"""What is stated of an effect that was added or taken out follows from stages that no fit has seen."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting import benefit
from orchestrator.diagnosis.reporting.benefit import added_remark, helps, removed_remark
from orchestrator.diagnosis.reporting.findings import found_effects
from plugins.effects.inverter import DeadTime, VoltageBias
from protocols import Effect
from tests.orchestrator.diagnosis.fitting.test_fit import ERROR_V, with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage


def refitted(maker: Fitter, effect: Effect | None = None) -> tuple[Fit, Fit]:
    before = maker.fit(free_model())
    return before, maker.fit(with_free(before.model, maker, effect or VoltageBias()))


@pytest.fixture(scope="module")
def biased() -> tuple[Fit, Fit]:
    return refitted(fitter(with_voltage(prepared(plan()), ERROR_V)))


@pytest.fixture(scope="module")
def clean() -> tuple[Fitter, Fit, Fit]:
    maker = fitter(prepared(plan()))
    return maker, *refitted(maker, DeadTime())


def test_an_effect_that_is_there_helps_and_is_needed(biased: tuple[Fit, Fit]) -> None:
    before, after = biased
    reported = added_remark("voltage_bias", before, after, None)
    assert reported.code == "helps"
    assert reported.text.startswith("voltage bias helps: the held-out error falls from ")
    assert float(reported.values["after_v"] or 0.0) < 0.5 * float(reported.values["before_v"] or 0.0)
    reported = removed_remark("voltage_bias", after, before)
    assert reported.code == "needed"
    assert "rises from" in reported.text


def test_an_effect_that_is_not_there_does_not_help_and_its_interval_holds_zero(clean: tuple[Fitter, Fit, Fit]) -> None:
    maker, before, after = clean
    (found,) = found_effects(maker, after, {}, {})
    reported = added_remark("dead_time", before, after, found)
    assert reported.code == "does_not_help"
    assert reported.text.endswith("and the 95 % interval of its voltage holds 0")
    assert removed_remark("dead_time", after, before).code == "not_needed"


def test_without_held_out_stages_the_fitted_error_judges() -> None:
    before, after = refitted(fitter(with_voltage(prepared([p for p in plan() if not p.held_out]), ERROR_V)))
    reported = added_remark("voltage_bias", before, after, None)
    assert reported.values["judged_on"] == "fitted"
    assert "the error (nothing was held out) falls from" in reported.text
    assert reported.code == "helps"


@pytest.mark.parametrize(("rest_v", "warns"), [(2.1, True), (0.9, False)])
def test_a_benefit_beside_most_of_the_error_says_little(
    biased: tuple[Fit, Fit], rest_v: float, warns: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, after = biased
    errors = {id(before): 2.66, id(after): rest_v}
    monkeypatch.setattr(benefit, "mean_rms_v", lambda fit, _: errors[id(fit)])
    monkeypatch.setattr(benefit, "noise_rms_v", lambda *_: 0.004)
    added, removed = added_remark("voltage_bias", before, after, None), removed_remark("voltage_bias", after, before)
    assert (added.code, removed.code) == ("helps", "needed")
    assert [("says little" in one.text) for one in (added, removed)] == [warns, warns]


@pytest.mark.parametrize(
    ("after_v", "course"),
    [
        (0.356, "rises from 339 mV to 356 mV"),
        (0.3399, "rises from 339 mV to 340 mV"),
        (0.339, "stays at 339 mV"),
        (0.337, "only falls from 339 mV to 337 mV"),
    ],
)
def test_far_from_the_noise_an_effect_helps_only_where_the_error_falls_whatever_the_likelihood(
    after_v: float, course: str, biased: tuple[Fit, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    before, after = biased
    assert helps(before, after)
    errors = {id(before): 0.339, id(after): after_v}
    monkeypatch.setattr(benefit, "mean_rms_v", lambda fit, _: errors[id(fit)])
    monkeypatch.setattr(benefit, "noise_rms_v", lambda *_: 0.0035)
    assert not helps(before, after)
    reported = added_remark("voltage_bias", before, after, None)
    assert reported.code == "does_not_help"
    assert reported.text == (
        f"voltage bias does not help by itself: the held-out error {course}; noise alone leaves 3.5 mV, so that "
        "something else is missing"
    )


@pytest.mark.parametrize(("after_v", "course"), [(0.00401, "rises from 4 mV to 4.01 mV"), (0.004, "stays at 4 mV")])
def test_close_to_the_noise_an_effect_without_which_the_rms_stays_is_certain_by_its_evidence_and_no_more(
    after_v: float, course: str, biased: tuple[Fit, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    before, after = biased
    errors = {id(before): 0.004, id(after): after_v}
    monkeypatch.setattr(benefit, "mean_rms_v", lambda fit, _: errors[id(fit)])
    monkeypatch.setattr(benefit, "noise_rms_v", lambda *_: 0.0035)
    added, removed = added_remark("voltage_bias", before, after, None), removed_remark("voltage_bias", after, before)
    assert (added.code, removed.code) == ("certain", "needed")
    assert added.text.startswith("voltage bias is certain by its evidence (+")
    assert added.text.endswith(f"are enough), though the held-out error {course}; noise alone leaves 3.5 mV")
    assert "help" not in added.text
    assert removed.text.startswith("voltage bias is needed by its evidence (+")


def test_what_does_not_help_is_not_needed_either(biased: tuple[Fit, Fit], monkeypatch: pytest.MonkeyPatch) -> None:
    before, after = biased
    errors = {id(before): 0.0285, id(after): 0.0315}
    monkeypatch.setattr(benefit, "mean_rms_v", lambda fit, _: errors[id(fit)])
    reported = removed_remark("voltage_bias", after, before)
    assert reported.code == "not_needed"
    assert reported.text == "voltage bias is not needed: without it the held-out error falls from 31.5 mV to 28.5 mV"
