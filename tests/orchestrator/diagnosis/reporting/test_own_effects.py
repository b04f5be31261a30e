"""Each effect that was given beside the installed ones is in the model, or a remark states what became of it."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.guarded import guarded
from orchestrator.diagnosis.reporting import own_effects
from orchestrator.diagnosis.reporting.own_effects import contract_remarks, own_effect_remarks
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from protocols import Contrast, Correction, Effect, SearchDecision, SearchEvent, SearchMove, Signals
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage

MAKER = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.0])))
BARE = MAKER.fit(free_model())


class Own(DeadTime):
    name: ClassVar[str] = "own_drop"


def event(
    step: int,
    move: SearchMove,
    *effects: str,
    chi2: tuple[float | None, float | None] = (None, None),
    score: float | None = None,
    threshold: float | None = None,
    decision: SearchDecision = "tested",
) -> SearchEvent:
    return SearchEvent(
        step=step,
        move=move,
        effects=effects,
        data="whole",
        measure="log_evidence",
        score=score,
        threshold=threshold,
        chi2_before=chi2[0],
        chi2_after=chi2[1],
        decision=decision,
        evaluations=0.0,
        seconds=0.0,
    )


SCREEN = event(1, "screen", "dead_time", score=5.0, threshold=32.0)
REFITS = [
    event(2, "refit", "dead_time", chi2=(90.0, 3.0), score=120.0, threshold=16.0),
    event(3, "refit", "own_drop", chi2=(90.0, 4.0), score=110.0, threshold=16.0),
    event(4, "add", "dead_time", chi2=(90.0, 3.0), score=120.0, threshold=16.0, decision="accepted"),
]
REMOVED = event(5, "remove", "own_drop", chi2=(1.07, 1.06), score=5.6, threshold=-16.0, decision="accepted")


def remark(effect: Effect, *events: SearchEvent, observable: bool = True, model: Effect | None = None) -> list[str]:
    candidates = scaled_library([DeviceDrop(), effect], MAKER.prepared.manifest)
    fit = BARE if model is None else MAKER.fit(with_free(BARE.model, MAKER, model))
    remarks = own_effect_remarks(MAKER, candidates, candidates if observable else candidates[:1], fit, events)
    return [f"{one.code}: {one.text}" for one in remarks]


def test_an_own_effect_that_was_tried_is_reported_with_chi2_and_evidence() -> None:
    assert remark(guarded(Own()), SCREEN, *REFITS, REMOVED) == [
        "own_effect_tried: own drop: tried, and not in the model: added alone, chi2 90 → 4, log evidence 110 nat "
        "(dead time: log evidence 120 nat); removed, chi2 1.07 → 1.06, log evidence 5.6 nat "
        "(at least −16 nat for this); `explain` lists all moves"
    ]


@pytest.mark.parametrize(
    ("events", "observable", "why"),
    [
        ([SCREEN], False, "no segment can show it"),
        ([SCREEN], True, "its predicted fall of chi2 is too small; the largest, of dead time, is 5 (32 needed)"),
        ([], True, "the search ended before it"),
    ],
)
def test_an_own_effect_that_was_not_fitted_is_reported_with_the_reason(
    events: list[SearchEvent], observable: bool, why: str
) -> None:
    (text,) = remark(guarded(Own()), *events, observable=observable)
    assert text == f"own_effect_not_tried: own drop: not fitted: {why}"


def test_an_own_effect_that_the_recording_cannot_separate_from_a_named_one_is_reported_with_it() -> None:
    class Alike(Own):
        needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_PWM_FREQUENCY,)

    class Undeclared(Own):
        needs: ClassVar[tuple[Contrast, ...]] = ()

    for own in (Alike(), Undeclared()):
        (text,) = remark(guarded(own), SCREEN, model=DeadTime())
        assert text == "own_effect_not_tried: own drop: not fitted: this recording cannot separate it from dead time"


def test_what_is_in_the_model_or_installed_has_no_such_remark() -> None:
    assert remark(guarded(Own()), SCREEN, *REFITS, model=guarded(Own())) == []
    assert remark(Own(), SCREEN, *REFITS) == []


def test_an_effect_that_another_distribution_installed_has_a_remark_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own_effects, "of_other_distributions", lambda _: frozenset({"own_drop"}))
    (text,) = remark(Own(), SCREEN)
    assert text.startswith("own_effect_not_tried: own drop: not fitted: its predicted fall of chi2 is too small")


class ActsAtNeutral(VoltageBias):
    """An effect that acts where its amplitudes are neutral, and on another layer's signals."""

    name: ClassVar[str] = "acts_at_neutral"

    def correct(self, signals: Signals, p: VoltageBias.Parameters) -> Correction:
        return Correction(v_ab=signals.v_ab - (1.0 + p.bias_a_v), theta_rad=signals.theta_rad + 0.1)


def test_an_own_effect_that_breaks_its_contract_is_reported_and_a_sound_one_is_not() -> None:
    library = scaled_library([guarded(ActsAtNeutral()), guarded(Own()), ActsAtNeutral()], MAKER.prepared.manifest)
    (remark,) = contract_remarks(BARE, library)
    assert remark.code == "breaks_contract"
    assert (
        "acts at neutral: at its neutral values it changes theta_rad and v_ab and its layer is INVERTER" in remark.text
    )
    assert "it changes theta_rad, so that its size" in remark.text
