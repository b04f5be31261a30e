"""What a search has found so far is reported once, in a sentence, and remembered as it was then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.search_state import AcceptedModel, Checkpoint, InterimRecorder, InterimResult
from plugins.effects.inverter import VoltageBias
from plugins.effects.timing import VoltageDelay
from protocols import Verdict
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage
from tests.orchestrator.diagnosis.selection.states import joint_state, state_of


@pytest.mark.parametrize(
    ("effects", "verdict", "chi2", "is_part", "sentence"),
    [
        (
            ("dead_time", "winding_heating"),
            "explained",
            1.03,
            True,
            "so far: dead time, winding heating; explains the part of the recording that was searched (chi2 1.03)",
        ),
        (("dead_time",), "unknown_remains", 791.0, True, "so far: dead time; something unknown remains (chi2 791)"),
        (
            ("dead_time",),
            "mostly_explained",
            1.5,
            False,
            "so far: dead time; explains most of the recording (chi2 1.5)",
        ),
        ((), "clean", 0.99, False, "so far: no effect found; the model alone explains the recording (chi2 0.99)"),
        (
            tuple("abcdefgh"),
            "explained",
            1.0,
            False,
            "so far: a, b, c, d, e and 3 more; explains the recording (chi2 1)",
        ),
    ],
)
def test_the_sentence_is_plain(
    effects: tuple[str, ...], verdict: Verdict, chi2: float, is_part: bool, sentence: str
) -> None:
    assert InterimResult(effects, verdict, chi2, is_part).sentence == sentence


def test_a_joint_fit_without_a_clear_effect_says_how_many_it_has() -> None:
    result = InterimResult((), "unknown_remains", 10.84, True, fitted_together=22)
    assert result.sentence == "so far: 22 effects fitted together, none named yet (chi2 10.84)"


@pytest.fixture(scope="module")
def fits() -> tuple[Fit, Fit]:
    """Of a biased voltage: without the effect, and with it."""
    maker = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.0])))
    bare = maker.fit(free_model())
    return bare, maker.fit(with_free(bare.model, maker, VoltageBias()))


def test_an_answer_is_reported_when_it_changes_and_not_again(fits: tuple[Fit, Fit]) -> None:
    bare, biased = fits
    state = state_of(fitter(bare.prepared), bare)
    reported: list[InterimResult] = []
    recorder = InterimRecorder(reported.append)
    first = [AcceptedModel(None, bare)]
    recorder.record(state, first)
    for _ in range(2):
        recorder.record(state.after(biased), first)
    whole = replace(state.after(biased), is_part=False)
    recorder.record(whole, first)
    assert [(one.effects, one.is_part) for one in reported] == [
        ((), True),
        (("voltage_bias",), True),
        (("voltage_bias",), False),
    ]
    assert reported[0].verdict == "unknown_remains"
    assert reported[1].verdict == "explained"
    assert reported[1].chi2 == biased.chi2_per_dof
    assert recorder.checkpoint == Checkpoint(whole, tuple(first))


def test_of_effects_that_are_fitted_together_those_are_named_that_the_data_ask_for(fits: tuple[Fit, Fit]) -> None:
    bare, _ = fits
    maker = fitter(bare.prepared)
    library = scaled_library([VoltageBias(), VoltageDelay()], bare.prepared.manifest)
    state = joint_state(maker, [c.absent() for c in library])
    reported: list[InterimResult] = []
    InterimRecorder(reported.append).record(state, [AcceptedModel(None, bare)])
    assert [(one.effects, one.fitted_together) for one in reported] == [(("voltage_bias",), 2)]
