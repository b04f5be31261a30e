"""What is stated of a convention: by a diagnosis at once and without an effect, and by an estimation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orchestrator.diagnosis import add_effects, compare_recording, diagnose_recording, in_words
from orchestrator.estimation import estimate_recording
from orchestrator.formatting.names import VERDICTS
from protocols import Estimator, NotMeasuredError
from tests.orchestrator.estimation.made_up import Resistance, Ripples, Sweeps, explained
from tests.orchestrator.recording_checks.conftest import right
from tests.support.rewriting import Rewritten, exchanged

__all__ = ["right"]


def test_a_convention_is_the_verdict_and_no_effect_is_named(right: Rewritten) -> None:
    wrong = right.phases("i_ab", exchanged("b", "c"))
    diagnosis = diagnose_recording(wrong, [])  # type: ignore[arg-type]
    report = diagnosis.report
    assert report.verdict == "convention"
    assert report.verdict in VERDICTS
    assert report.effects == ()
    assert report.convention is not None
    assert report.convention.correction.matrix is not None
    np.testing.assert_allclose(report.convention.correction.matrix, [[1.0, 0.0], [0.0, -1.0]])
    words = in_words(diagnosis)
    assert "phases b and c" in words.likely_cause
    assert "[[1, 0], [0, -1]]" in words.to_decide


def test_an_estimation_says_the_same_and_that_its_map_is_not_usable(right: Rewritten, tmp_path: Path) -> None:
    found = estimate_recording(
        right.mapped("i_ab", np.sqrt(0.5) * np.eye(2)), [Resistance(), Sweeps(), Ripples()], tmp_path
    )
    assert not found.usable
    assert "rms for peak" in found.reasons[0]
    sound: list[Estimator] = [Resistance(), Sweeps(), Ripples()]
    assert estimate_recording(right, sound, tmp_path, check_model=explained).usable


def test_an_estimation_of_a_dead_sensor_ends_with_the_line_of_the_diagnosis(right: Rewritten, tmp_path: Path) -> None:
    dead = right.mapped("i_ab", np.diag([1.0, 0.0]))
    with pytest.raises(NotMeasuredError, match="i_beta looks dead: measure again"):
        estimate_recording(dead, [Resistance(), Sweeps(), Ripples()], tmp_path)


@pytest.mark.slow
def test_who_compares_or_adds_all_the_same_is_reported_first(right: Rewritten, tmp_path: Path) -> None:
    wrong = right.mapped("i_ab", np.sqrt(0.5) * np.eye(2))
    held = compare_recording(wrong, model="linear", out=tmp_path)  # type: ignore[arg-type]
    added = add_effects(wrong, ["saturation"], [], model="linear", out=tmp_path)  # type: ignore[arg-type]
    for report in (held, added):
        assert report.remarks[0].code == "convention"
        assert "rms for peak" in report.notes[0]


def test_an_estimation_that_is_refused_says_what_the_readings_look_like(right: Rewritten, tmp_path: Path) -> None:
    with pytest.raises(NotMeasuredError, match=r"milliamperes.*multiply the currents by 0\.001"):
        estimate_recording(right.mapped("i_ab", 1e3 * np.eye(2)), [Resistance()], tmp_path)
    with pytest.raises(NotMeasuredError, match="swapped in phases b and c"):
        estimate_recording(right.phases("i_ab", exchanged("b", "c")), [Resistance()], tmp_path)
