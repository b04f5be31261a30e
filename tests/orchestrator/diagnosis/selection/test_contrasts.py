"""Every contrast is recognised in a recording that holds it and in no other."""

from __future__ import annotations

from dataclasses import replace

import pytest

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.selection.contrasts import CONTRASTS, holds, separable, separating_contrasts
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData
from orchestrator.recording import Recording
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from plugins.effects.sensors import CurrentOffset
from protocols import Contrast, SegmentStage
from tests.orchestrator.diagnosis.pieces import plan, prepared


@pytest.fixture(scope="module")
def setup(clean: Recording) -> DiagnosisSetup:
    return open_for_diagnosis(clean)


def only(prepared: PreparedRecording, *pieces: SegmentData) -> PreparedRecording:
    return replace(prepared, pieces=pieces)


def bare(prepared: PreparedRecording) -> PreparedRecording:
    """One sweep, one hold of the largest current, and one ripple: no contrast at all."""
    sweep = next(p for p in prepared.pieces if p.stage is SegmentStage.CLASSICAL)
    dwells = (p for p in prepared.pieces if p.stage is SegmentStage.RESISTANCE)
    hold = max(dwells, key=lambda p: float(abs(p.signals.i_ab[:, 0].mean())))
    ripple = next(p for p in prepared.pieces if p.stage is SegmentStage.INJECTION)
    return only(prepared, sweep, hold, ripple)


def test_every_contrast_can_be_recognised() -> None:
    assert set(CONTRASTS) == set(Contrast)


@pytest.mark.parametrize("contrast", Contrast)
def test_a_recording_without_a_contrast_does_not_hold_it(setup: DiagnosisSetup, contrast: Contrast) -> None:
    assert not holds(bare(setup.prepared), contrast)


def test_two_angles_are_recognised(setup: DiagnosisSetup) -> None:
    before = bare(setup.prepared)
    turned = replace(before.pieces[0], segment=before.pieces[0].segment.model_copy(update={"rotor_angle_rad": 1.05}))
    assert holds(only(before, *before.pieces, turned), Contrast.SECOND_ANGLE)


WHOLE = prepared(plan(sparse=True))
BRIDGE_ON = replace(WHOLE, pieces=tuple(p for p in WHOLE.pieces if p.stage is not SegmentStage.GATES_OFF))


def test_two_effects_are_separated_by_the_contrasts_that_both_need() -> None:
    assert separating_contrasts(VoltageBias(), CurrentOffset()) == (Contrast.GATES_OFF,)
    assert separating_contrasts(DeadTime(), DeviceDrop()) == (Contrast.SECOND_PWM_FREQUENCY,)


def test_effects_that_need_different_contrasts_are_separable_by_any_recording() -> None:
    assert separating_contrasts(DeadTime(), CurrentOffset()) == ()
    assert separable(BRIDGE_ON, DeadTime(), CurrentOffset())


def test_a_recording_separates_two_effects_if_it_holds_their_contrast() -> None:
    assert separable(WHOLE, VoltageBias(), CurrentOffset())
    assert not separable(BRIDGE_ON, VoltageBias(), CurrentOffset())
    assert not separable(WHOLE, DeadTime(), DeviceDrop())
