"""Every contrast is recognised in a recording that holds it and in no other."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.guarded import guarded
from orchestrator.diagnosis.selection.adding import add_moves
from orchestrator.diagnosis.selection.contrasts import (
    CONTRASTS,
    holds,
    imitated_shares,
    inseparable_from,
    resembling,
    separable,
    separating_contrasts,
)
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData
from orchestrator.recording import Recording
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from plugins.effects.sensors import CurrentOffset
from protocols import Contrast, Effect, SegmentStage
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage
from tests.orchestrator.diagnosis.selection.states import made, state_of, view_of


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


class SameBias(VoltageBias):
    name: ClassVar[str] = "same_bias"
    needs: ClassVar[tuple[Contrast, ...]] = ()


def test_an_effect_s_signal_is_imitated_by_its_like_alone() -> None:
    maker = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.1])))
    library = scaled_library([VoltageBias(), guarded(SameBias()), DeadTime()], maker.prepared.manifest)
    fit = maker.fit(with_free(free_model(), maker, VoltageBias()))
    shares = imitated_shares(maker, fit, "voltage_bias", library)
    assert list(shares) == ["same_bias", "dead_time"]
    assert shares["same_bias"] > 0.95
    assert shares["dead_time"] < 0.5
    assert resembling(maker, fit, "voltage_bias", library) == ["same_bias"]
