"""Sampling rates and delays that are not the manifest's."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis.conventions import CorrectedRecording, find_convention
from tests.support.rewriting import Rewritten


@pytest.mark.parametrize("factor", [2.0, 10.0, 0.5, 0.1])
def test_a_wrong_sampling_rate_is_named(right: Rewritten, factor: float) -> None:
    wrong = right.driven(sampling_frequency_hz=factor * right.manifest.drive.sampling_frequency_hz)
    found = find_convention(wrong)
    assert found is not None
    assert found.kind == "sampling_rate"
    assert found.correction.factor == pytest.approx(1.0 / factor)
    assert find_convention(CorrectedRecording(wrong, found.correction)) is None


@pytest.mark.parametrize("rows", [-2, -1, 1, 2])
def test_a_voltage_early_or_late_by_whole_samples_is_named(right: Rewritten, rows: int) -> None:
    wrong = right.late(rows)
    found = find_convention(wrong)
    assert found is not None
    assert (found.kind, found.correction.add) == ("delay", -rows)
    assert find_convention(CorrectedRecording(wrong, found.correction)) is None


def test_a_declared_delay_that_is_not_there_is_named(right: Rewritten) -> None:
    found = find_convention(right.driven(voltage_delay_samples=1.0))
    assert found is not None
    assert found.correction.text == "set drive.voltage_delay_samples to 0"
