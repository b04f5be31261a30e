"""A resistance that was measured before: believed as far as it says, and enough where nothing rests."""

from __future__ import annotations

import pytest

from plugins.estimators.resistance import ResistanceEstimator
from protocols import EstimationContext, NotMeasuredError, ResistanceEstimate, SegmentStage
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.orchestrator.analysis.plant import R_S
from tests.plugins.estimators.recordings import clean


def knowing(recording: MemoryRecording, ohm: float, std: float | None) -> MemoryRecording:
    motor = recording.manifest.motor.model_copy(update={"stator_resistance_ohm": ohm, "stator_resistance_std_ohm": std})
    return MemoryRecording(recording.manifest.model_copy(update={"motor": motor}), recording.captures)


def found(recording: MemoryRecording) -> ResistanceEstimate:
    return ResistanceEstimator().estimate(recording, EstimationContext())


def restless() -> MemoryRecording:
    """A sweep whose rests are cut away."""
    recording = clean().only(SegmentStage.CLASSICAL)
    segment = recording.manifest.segments[0]
    rising = recording.captures[segment.id]
    short = {name: getattr(rising, name)[:600] for name in ("i_ab", "v_ab", "v_dc")}
    cut = segment.model_copy(update={"samples": 600})
    return MemoryRecording(
        recording.manifest.model_copy(update={"segments": (cut,)}), {segment.id: rising.model_copy(update=short)}
    )


@pytest.mark.parametrize(("std", "half"), [(0.043, 1.96 * 0.043), (None, 1.96 * 0.43)])
def test_where_nothing_rests_the_known_one_does_and_is_no_surer_than_it_says(std: float | None, half: float) -> None:
    estimate = found(knowing(restless(), 4.3, std))
    assert (estimate.value_ohm, estimate.high - estimate.value_ohm) == pytest.approx((4.3, half))
    assert [remark.code for remark in estimate.remarks] == ["as_known"]


def test_without_one_nothing_is_made_up() -> None:
    with pytest.raises(NotMeasuredError, match="constant current"):
        found(restless())


def test_a_measurement_and_what_was_known_make_one_that_is_surer_than_both() -> None:
    alone = found(clean())
    half = alone.high - alone.value_ohm
    together = found(knowing(clean(), R_S, half / 1.96))
    assert together.high - together.value_ohm == pytest.approx(half / 2**0.5, rel=1e-3)
    assert abs(together.value_ohm - R_S) <= abs(alone.value_ohm - R_S)


def test_a_nameplate_without_a_deviation_weighs_nothing_beside_a_measurement() -> None:
    assert found(knowing(clean(), 5.0, None)).value_ohm == found(clean()).value_ohm


def test_a_known_one_that_contradicts_is_not_mixed_in_and_is_stated() -> None:
    estimate = found(knowing(clean(), 1.1 * R_S, 0.001 * R_S))
    assert estimate.value_ohm == found(clean()).value_ohm
    assert "off_the_known" in [remark.code for remark in estimate.remarks]
