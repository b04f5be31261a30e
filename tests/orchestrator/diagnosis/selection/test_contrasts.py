"""Every contrast is recognised in a recording that holds it and in no other."""

from __future__ import annotations

from dataclasses import replace

import pytest

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.selection.contrasts import CONTRASTS, holds
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentSignals
from orchestrator.recording import Recording
from protocols import Contrast, SegmentStage


@pytest.fixture(scope="module")
def setup(clean: Recording) -> DiagnosisSetup:
    return open_for_diagnosis(clean)


def only(prepared: PreparedRecording, *pieces: SegmentSignals) -> PreparedRecording:
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
