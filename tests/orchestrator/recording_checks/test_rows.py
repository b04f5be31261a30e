"""Rows that were lost, doubled, held or interpolated."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from orchestrator.recording_checks import find_convention
from orchestrator.recording_checks.rows import (
    MAX_CHANCE_RATIO,
    MAX_REPEATED_SHARE,
    _edges,
    _interpolated,
    _repeated,
    broken_rows,
)
from orchestrator.recording_checks.survey import SegmentReadings, Survey
from protocols import Capture
from tests.support.rewriting import Rewritten

Numbers = NDArray[np.int64]


def _lost(count: int, rng: np.random.Generator) -> Numbers:
    return np.flatnonzero(rng.random(count) > 0.01)


def _doubled(count: int, rng: np.random.Generator) -> Numbers:
    return np.sort(np.concatenate([np.arange(count), np.flatnonzero(rng.random(count) < 0.05)]))


def _held(count: int, rng: np.random.Generator) -> Numbers:
    return np.maximum(np.arange(count) - (rng.random(count) < 0.05), 0)


@pytest.mark.parametrize("which", [_lost, _doubled, _held])
def test_broken_rows_are_named(right: Rewritten, which: Any) -> None:
    convention = find_convention(right.rows(which))
    assert convention is not None
    assert convention.kind == f"rows{which.__name__}"


def test_a_few_rows_lost_in_one_place_of_some_captures_are_named(right: Rewritten) -> None:
    def without_three(count: int, rng: np.random.Generator) -> Numbers:
        at = int(rng.integers(count // 4, 3 * count // 4)) if rng.random() < 0.3 else count
        return np.concatenate([np.arange(at), np.arange(at + 3, count)])

    convention = find_convention(right.rows(without_three))
    assert convention is not None
    assert convention.kind == "rows_lost"
    assert "none late" in convention.evidence


def test_a_capture_that_ends_within_a_period_has_lost_no_row(right: Rewritten) -> None:
    assert find_convention(right.rows(lambda count, _: np.arange(7, count - 13))) is None


@pytest.mark.parametrize("widths", [(9, 14), (400, 400)], ids=["no common width", "hardly an edge"])
def test_what_is_no_square_wave_has_no_early_edges(right: Rewritten, widths: tuple[int, int]) -> None:
    segment = next(s for s in right.manifest.segments if s.settings.get("amplitude_v"))
    v = np.tile(np.repeat([30.0 + 0j, -30.0 + 0j], widths), 12)[:276]
    seen = SegmentReadings(segment, np.zeros(len(v), dtype=complex), v, None, np.full(len(v), 540.0))
    assert _edges(seen) == (0, 0, 0)


def test_interpolated_rows_are_named(right: Rewritten, rng: np.random.Generator) -> None:
    def interpolated(c: Capture) -> dict[str, Any]:
        rows = 1 + np.flatnonzero(rng.random(len(c) - 2) < 0.05)
        i = np.array(c.i_ab, dtype=np.float64)
        i[rows] = 0.5 * (c.i_ab[rows - 1] + c.i_ab[rows + 1])
        return {"i_ab": i.astype(np.float32)}

    convention = find_convention(right.captured(interpolated))
    assert convention is not None
    assert convention.kind == "rows_interpolated"


def test_a_converter_of_coarse_steps_holds_no_rows(right: Rewritten) -> None:
    coarse = right.captured(lambda c: {"i_ab": (np.round(c.i_ab / 0.02) * 0.02).astype(np.float32)})
    assert find_convention(coarse) is None


@pytest.mark.parametrize("noise", [0.3, 0.5, 1.0])
def test_counts_of_a_converter_that_lie_on_a_line_are_not_interpolated(
    noise: float, right: Rewritten, rng: np.random.Generator
) -> None:
    segment = next(s for s in right.manifest.segments if s.settings.get("amplitude_v"))
    n = np.arange(8000)
    rising = np.where(n // 10 % 2 == 0, 1.0, -1.0)
    # What saturates bends the line by a count or two: over twice as many rows by four times as much.
    bent = np.cumsum(rising) + 1e-3 * np.cumsum(rising) ** 3
    wave = bent[:, None] * np.column_stack([43.0 * np.cos(n / 1300), 21.0 * np.sin(n / 1300)])
    counts = np.round(wave + noise * rng.normal(size=wave.shape)).astype(np.float32)
    # Of two phases in counts: i_beta is (i_a + 2 i_b) / sqrt 3.
    i_ab = 0.012 * np.column_stack([counts[:, 0], (counts[:, 0] + 2.0 * counts[:, 1]) / np.sqrt(3.0)])
    i = i_ab.astype(np.float64).view(np.complex128).ravel()
    seen = SegmentReadings(segment, i, (40.0 * rising).astype(np.complex128), None, np.full(len(i), 540.0))
    middle, by_chance, rows = _interpolated(seen)
    assert middle > MAX_REPEATED_SHARE * rows
    assert middle <= MAX_REPEATED_SHARE * rows + MAX_CHANCE_RATIO * by_chance


def injected(rng: np.random.Generator, right: Rewritten, *, amplitude_a: float, held: float = 0.0) -> Survey:
    """Sines of 20 rows whose direction turns, read by an ordinary converter: steps of 0.25 A, noise of 0.2 A.

    Their crests lie between two rows, which are then alike, where rows two apart are not.
    """
    segment = next(s for s in right.manifest.segments if s.settings.get("amplitude_v"))
    n = np.arange(20_000)
    turning = np.exp(2j * np.pi * n / 20_000)
    wave = 2.0 * np.pi / 20.0 * (n + 0.5)
    true = amplitude_a * np.sin(wave)[:, None] * np.column_stack([turning.real, turning.real * -0.5 + turning.imag])
    counts = 0.25 * np.round((true + 0.2 * rng.normal(size=true.shape)) / 0.25)
    rows = np.maximum(n - (rng.random(len(n)) < held), 0)
    a, b = counts[rows].T
    i = a + 1j * (a + 2.0 * b) / np.sqrt(3.0)
    v = 30.0 * np.cos(wave) * turning
    return Survey(right.manifest, [SegmentReadings(segment, i, v, None, np.full(len(n), 540.0))])


@pytest.mark.parametrize("amplitude_a", [2.0, 10.0, 20.0])
def test_readings_that_repeat_at_a_sine_s_crest_are_not_held(
    rng: np.random.Generator, right: Rewritten, amplitude_a: float
) -> None:
    survey = injected(rng, right, amplitude_a=amplitude_a)
    repeated, _, _ = _repeated(survey.seen[0])
    assert repeated > 20
    assert broken_rows(survey) is None


def test_rows_that_are_held_while_a_sine_moves_the_current_by_several_steps_are_named(
    rng: np.random.Generator, right: Rewritten
) -> None:
    convention = broken_rows(injected(rng, right, amplitude_a=30.0, held=0.05))
    assert convention is not None
    assert convention.kind == "rows_held"
