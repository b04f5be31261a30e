"""A diagnosis that ends with a convention: at once, with its words, and without an effect."""

from __future__ import annotations

import numpy as np

from orchestrator.diagnosis import diagnose_recording, in_words
from orchestrator.presentation.names import VERDICTS
from tests.support.rewriting import Rewritten, exchanged


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
