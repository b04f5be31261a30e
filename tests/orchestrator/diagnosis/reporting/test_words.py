"""A diagnosis in words: five slots, with units, names and what to do next."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from orchestrator.diagnosis import Diagnosis, in_words
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.guarded import guarded
from orchestrator.diagnosis.reporting.ladder import rung
from orchestrator.diagnosis.reporting.resemblance import inseparable_remark
from orchestrator.diagnosis.selection.contrasts import CONTRASTS
from orchestrator.diagnosis.selection.search_state import AcceptedModel, SearchResult
from orchestrator.formatting.quantities import operating_point
from plugins.effects.inverter import VoltageBias
from plugins.effects.iron import SlotHarmonics
from plugins.effects.sensors import CurrentOffset
from protocols import Contrast, Effect, Inseparable
from tests.orchestrator.diagnosis.fitting.test_fit import fitted_bias, with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, setup_of, with_voltage
from tests.orchestrator.diagnosis.reporting.test_parameter_bounds import Narrow
from tests.plugins.streams.report.example_diagnosis import a_diagnosis

MAKER = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.0])))
BIAS: dict[str, Any] = {
    "name": "voltage_bias",
    "parameters": {"bias_a_v": {"value": 0.3, "low": 0.299, "high": 0.301, "unit": "V"}},
    "twins": [],
    "relative_size": 0.05,
    "log_evidence": 5e5,
}


@pytest.fixture(scope="module")
def search() -> SearchResult:
    """The map alone, then with the bias that is really there."""
    bare = AcceptedModel(None, MAKER.fit(free_model()))
    return SearchResult([bare, AcceptedModel("voltage_bias", fitted_bias(MAKER))])


def stated(search: SearchResult, **changes: Any) -> Any:
    """The words for a report of this search."""
    ladder = [rung(step).model_dump() for step in search.steps]
    report = a_diagnosis(**{"ladder": ladder, "effects": [BIAS], "next_experiment": None, **changes})
    setup = setup_of(MAKER)
    library = scaled_library([VoltageBias(), CurrentOffset()], MAKER.prepared.manifest)
    return in_words(Diagnosis(report, setup, search, library))


def test_a_clean_recording_has_nothing_to_say(search: SearchResult) -> None:
    ladder = [rung(search.steps[0]).model_dump()]
    words = stated(SearchResult(search.steps[:1]), verdict="clean", effects=[], ladder=ladder)
    assert words.where_it_fails == "nowhere beyond the noise"
    assert words.what_it_looks_like == "noise"
    assert words.likely_cause == "none: the model fits within the noise"
    assert words.if_added == "nothing was added"
    assert words.to_decide == "nothing left to decide"


def test_what_is_too_faint_to_be_a_cause_is_stated(search: SearchResult) -> None:
    words = stated(search, verdict="clean", effects=[], minor=[BIAS])
    assert words.likely_cause == "none that counts; voltage bias shows, and is in the model"


def test_what_was_found_is_named_with_its_size_and_its_signature(search: SearchResult) -> None:
    words = stated(search)
    assert words.likely_cause == "voltage bias (bias a 300.0 mV, 95 %: 299.0 to 301.0)"
    assert words.what_it_looks_like == VoltageBias.signature
    assert words.to_decide == "nothing left to decide"


def test_the_size_of_a_setting_of_the_drive_is_stated_with_the_frequency_and_voltage_that_it_holds_at(
    search: SearchResult,
) -> None:
    setting = {"dead_time": {"value": 2e-7, "low": None, "high": None, "unit": "s"}}
    drive = MAKER.prepared.manifest.drive
    assert stated(search, effects=[{**BIAS, "derived": setting}]).likely_cause == (
        f"voltage bias (bias a 300.0 mV at {operating_point(drive)}, 95 %: 299.0 to 301.0; "
        "dead time 200 ns, to enter as compensation; leave the inverter's own dead time as it is)"
    )
    with_twin = {**BIAS, "derived": setting, "twins": ["current_offset"]}
    assert "to enter" not in stated(search, effects=[with_twin]).likely_cause


def test_the_worst_segment_is_named_with_its_currents_and_the_noise(search: SearchResult) -> None:
    where = stated(search).where_it_fails
    assert any(
        where.startswith(f"before the effects were added, worst in a {kind} at 10 kHz PWM ({piece.segment.id}, ")
        for piece in MAKER.prepared.pieces
        for kind in ("hold", "sweep")
    )
    assert "gates_off" not in where
    alone = stated(SearchResult([search.steps[0]]), verdict="unknown_remains", effects=[])
    assert alone.where_it_fails.startswith("worst in ")
    assert "|i_d| to " in where
    assert "noise alone leaves " in where
    assert where.endswith(" in this segment")


def test_what_adding_it_does_is_stated_of_data_that_were_held_out(search: SearchResult) -> None:
    gain = stated(search).if_added
    assert gain.startswith("held-out error ")
    assert "the model's R_s" in gain
    alone = AcceptedModel("voltage_bias", search.steps[0].fit)
    assert "the model's R_s stays " in stated(SearchResult([search.steps[0], alone])).if_added
    nothing = [{**rung(step).model_dump(), "heldout_rms_v": None} for step in search.steps]
    assert stated(search, ladder=nothing).if_added.startswith("error ")


def test_twins_are_named_with_what_would_tell_them_apart(search: SearchResult, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orchestrator.diagnosis.reporting.words.holds", lambda *_: False)
    words = stated(search, effects=[{**BIAS, "twins": ["current_offset"]}])
    needed = CONTRASTS[Contrast.GATES_OFF].text
    assert "indistinguishable from current offset here" in words.likely_cause
    alike = "In its place current offset would leave the same residual, within the noise."
    parts = f"What would tell it from current offset, {needed}, was not measured."
    assert f"{alike} {parts}" in words.what_it_looks_like
    assert needed in words.to_decide


def test_a_twin_that_is_in_the_model_too_is_no_alternative(search: SearchResult) -> None:
    offset = {**BIAS, "name": "current_offset", "twins": ["voltage_bias"]}
    words = stated(search, effects=[BIAS, offset])
    assert "acts like voltage bias here, which is in the model too" in words.likely_cause
    assert "indistinguishable" not in words.likely_cause
    assert "Here it acts like voltage bias, which is in the model too: a part of its size may be theirs." in (
        words.what_it_looks_like
    )


def test_twins_that_no_measurement_has_separated_are_too_small_for_it(search: SearchResult) -> None:
    words = stated(search, effects=[{**BIAS, "twins": ["current_offset"]}])
    measured = f"What tells them apart, {CONTRASTS[Contrast.GATES_OFF].text}, was measured, but too short or too small."
    assert f"At this size the recording does not tell it from current offset. {measured}" in words.what_it_looks_like
    assert words.to_decide == "voltage bias or current offset: too small to be separated by the measurements"


def test_the_next_experiment_is_a_stage_with_its_time_and_its_purpose(search: SearchResult) -> None:
    proposal = {"stage": {"kind": "gates_off"}, "separates": ["voltage_bias", "current_offset"], "minutes": 0.5}
    words = stated(search, next_experiment=proposal)
    assert words.to_decide == "gates off stage of 30 s, tells voltage bias from current offset"


@pytest.mark.parametrize(
    ("verdict", "cause", "next_step"),
    [
        (
            "unknown_remains",
            "and something that no effect of the library explains",
            "`fluxbench discover RUN` looks for the law that is missing; no experiment",
        ),
        ("mostly_explained", "% of the error remains", "a part of the error remains that nothing"),
    ],
)
def test_what_is_left_unexplained_is_stated(search: SearchResult, verdict: str, cause: str, next_step: str) -> None:
    words = stated(search, verdict=verdict)
    assert words.likely_cause.startswith("voltage bias (")
    assert cause in words.likely_cause
    assert words.to_decide.startswith(next_step)


def test_no_cause_is_named_while_most_of_the_error_remains(search: SearchResult) -> None:
    words = stated(search, verdict="unknown_remains", unexplained={"fraction": 0.8, "shape": []})
    assert words.likely_cause.startswith("none can be named while chi2 is ")
    before, after = words.if_added.removeprefix("held-out error ").split(" (")[0].split(" -> ")
    assert words.likely_cause.endswith(f"; voltage bias takes up a part ({before} -> {after})")


def test_what_a_recording_lacks_stands_in_the_words(search: SearchResult) -> None:
    reasons = [
        {"quantity": "map_error_percent", "value": 0.5, "limit": 0.2, "sentence": "The map is uncertain by 0.5 %."},
        {"quantity": "chi2_per_dof", "value": 1.0, "limit": 1.1, "sentence": "chi2 is 1.0."},
    ]
    words = stated(search, verdict="cannot_tell", effects=[], reasons=reasons)
    assert words.to_decide == "another recording: The map is uncertain by 0.5 %."


def test_an_unknown_of_a_winding_too_fast_for_its_samples_asks_for_faster_ones_first(
    search: SearchResult,
) -> None:
    note = "L / R is 2.8 samples; sample at 10800 Hz or more"
    remarks = [{"code": "time_constant", "values": {}, "text": note}]
    words = stated(search, verdict="unknown_remains", effects=[], remarks=remarks)
    assert words.likely_cause == "not known: the readings are too slow for this winding to tell"
    assert words.to_decide == f"the same once more with faster readings: {note}"


def test_an_unknown_is_described_by_its_shape(search: SearchResult) -> None:
    shape = [{"group": "periodic", "share": 0.8}, {"group": "constant", "share": 0.2}]
    words = stated(search, verdict="unknown_remains", effects=[], unexplained={"fraction": 0.9, "shape": shape})
    assert words.what_it_looks_like.startswith("80 % periodic at the mains frequency; 20 % constant")
    assert words.likely_cause == "something that no effect of the library explains"


@pytest.mark.parametrize(
    ("effect", "advice"),
    [
        (guarded(Narrow()), "bias of narrow bias: declare a wider bound in its class and fit again"),
        (Narrow(), "bias of narrow bias: beyond it the effect is not plausible, so look for another cause as well"),
    ],
)
def test_a_cause_at_its_bound_is_stated_with_the_bound_and_what_to_do(effect: Effect, advice: str) -> None:
    bare = MAKER.fit(free_model())
    after = MAKER.fit(with_free(bare.model, MAKER, effect))
    found = {**BIAS, "name": "narrow_bias", "parameters": {"bias_v": {**BIAS["parameters"]["bias_a_v"], "value": 0.1}}}
    words = stated(SearchResult([AcceptedModel(None, bare), AcceptedModel("narrow_bias", after)]), effects=[found])
    assert "; bias at its bound " in words.likely_cause
    assert "(high = 100 mV" in words.likely_cause
    assert words.to_decide == advice


def test_a_cause_in_whose_place_another_fits_better_is_no_certain_one(search: SearchResult) -> None:
    values = {"effect": "voltage_bias", "other": "current_offset", "gain_nat": 20.0}
    words = stated(search, remarks=[{"code": "fits_better_in_place", "text": "fits better", "values": values}])
    assert words.likely_cause.endswith("; current offset fits better in its place)")
    assert words.to_decide == "`fluxbench diagnose RUN --without voltage_bias`: current offset fits better in its place"


def test_a_proposal_states_how_far_it_separates_at_the_size_found(search: SearchResult) -> None:
    proposal = {
        "stage": {"kind": "gates_off", "duration_s": 30.0},
        "separates": ["voltage_bias", "current_offset"],
        "minutes": 0.5,
        "sigmas": {"value": 12.34, "low": 10.2, "high": 14.7, "unit": "1"},
        "least_sigmas": 5.0,
    }
    text = stated(search, next_experiment=proposal).to_decide
    assert text.endswith("from current offset: by 12 sigma at the size found (95 %: 10 to 15; 5 are enough)")


def test_what_no_experiment_separates_is_stated_with_the_best_one_s_separation(search: SearchResult) -> None:
    pair = Inseparable(separates=("voltage_bias", "current_offset"), best_sigmas=1.26, least_sigmas=5.0)
    words = stated(search, remarks=[inseparable_remark(pair).model_dump()])
    assert words.to_decide == (
        "voltage bias and current offset: not separable by any experiment this bench can make: at the size found the "
        "best would separate them by 1.3 sigma, and 5 are needed"
    )


def test_a_size_that_belongs_to_one_rotor_angle_is_stated_so_and_a_second_angle_is_proposed() -> None:
    bare = MAKER.fit(free_model())
    after = MAKER.fit(with_free(bare.model, MAKER, SlotHarmonics()))
    slots = {
        **BIAS,
        "name": "slot_harmonics",
        "parameters": {"relative": {**BIAS["parameters"]["bias_a_v"], "unit": "1"}},
    }
    search = SearchResult([AcceptedModel(None, bare), AcceptedModel("slot_harmonics", after)])
    words = stated(search, effects=[slots])
    assert words.likely_cause.endswith("; at this angle; other angles unknown)")
    angle = "the rotor locked at a second angle: size and sign of slot harmonics belong to this angle alone"
    assert words.to_decide == angle
    every = dict.fromkeys(("relative", "across", "along_d", "along_q"), slots["parameters"]["relative"])
    assert "other angles" not in stated(search, effects=[{**slots, "parameters": every}]).likely_cause
