"""A magnet that lies across the d axis of the manifest, as on a reluctance motor's."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from orchestrator.recording_checks import CorrectedRecording, find_convention
from protocols import Segment, SegmentStage
from tests.support.rewriting import Rewritten


def described_a_quarter_turn_off(right: Rewritten, side: int) -> Rewritten:
    """The same waveforms, with angle, set-points and nameplate in a frame that lies a quarter turn ahead, or behind."""

    def change(segment: Segment) -> dict[str, Any]:
        settings = dict(segment.settings)
        for d, q in (("current_d_a", "current_q_a"), ("target_d_a", "target_q_a")):
            if d in settings and q in settings:
                settings[d], settings[q] = side * float(settings[q]), -side * float(settings[d])
        return {"rotor_angle_rad": segment.rotor_angle_rad + side * 0.5 * math.pi, "settings": settings}

    motor = right.manifest.motor
    return right.with_segments(change).plated(d_inductance_h=motor.q_inductance_h, q_inductance_h=motor.d_inductance_h)


@pytest.mark.parametrize("side", [1, -1])
def test_a_magnet_across_the_d_axis_is_named_and_turned_back(right: Rewritten, side: int) -> None:
    wrong = described_a_quarter_turn_off(right, side)
    convention = find_convention(wrong)
    assert convention is not None
    assert convention.kind == "quarter_turn"
    assert convention.correction.add == pytest.approx(-side * 0.5 * math.pi)
    assert ("on -q" if side > 0 else "on +q") in convention.what
    corrected = CorrectedRecording(wrong, convention.correction)
    assert find_convention(corrected) is None
    assert corrected.manifest.motor == right.manifest.motor
    for turned, own in zip(corrected.manifest.segments, right.manifest.segments, strict=True):
        assert turned.rotor_angle_rad == pytest.approx(own.rotor_angle_rad)
        assert {k: turned.settings[k] for k in own.settings if k[-4:] in ("_d_a", "_q_a")} == pytest.approx(
            {k: v for k, v in own.settings.items() if k[-4:] in ("_d_a", "_q_a")}, abs=1e-12
        )


def test_where_one_side_of_an_axis_was_never_visited_nothing_is_stated_of_it(right: Rewritten) -> None:
    wrong = described_a_quarter_turn_off(right, 1)

    def visited(segment: Segment) -> bool:
        return segment.stage is not SegmentStage.INJECTION or float(segment.settings["target_q_a"]) >= 0.0

    kept = tuple(s for s in wrong.manifest.segments if visited(s))
    half = replace(wrong, manifest=wrong.manifest.model_copy(update={"segments": kept}))
    assert len(kept) < len(wrong.manifest.segments)
    assert find_convention(half) is None
