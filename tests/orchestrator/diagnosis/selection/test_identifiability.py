"""Look-alikes are told apart where the recording holds the contrast that both need, whoever made them."""

from __future__ import annotations

from dataclasses import replace

from orchestrator.diagnosis.selection.identifiability import separable, separating_contrasts
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from plugins.effects.sensors import CurrentOffset
from protocols import Contrast, SegmentStage
from tests.orchestrator.diagnosis.pieces import plan, prepared

WHOLE = prepared(plan(sparse=True))
BRIDGE_ON = replace(WHOLE, pieces=tuple(p for p in WHOLE.pieces if p.stage is not SegmentStage.GATES_OFF))


def test_what_parts_two_effects_is_what_both_need() -> None:
    assert separating_contrasts(VoltageBias(), CurrentOffset()) == (Contrast.GATES_OFF,)
    assert separating_contrasts(DeadTime(), DeviceDrop()) == (Contrast.SECOND_PWM_FREQUENCY,)
    assert separating_contrasts(DeadTime(), CurrentOffset()) == ()


def test_a_recording_parts_what_it_holds_the_contrast_for() -> None:
    assert separable(WHOLE, VoltageBias(), CurrentOffset())
    assert not separable(BRIDGE_ON, VoltageBias(), CurrentOffset())
    assert not separable(WHOLE, DeadTime(), DeviceDrop())
    assert separable(BRIDGE_ON, DeadTime(), CurrentOffset())
