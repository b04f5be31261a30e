"""The history of the loss, against the energy that flowed."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.weak_form.loss_history import LOSS_STEP_S, loss_history, segment_heat, step_of

FS = 10_000.0


def test_energy_of_the_history_is_that_of_what_flowed() -> None:
    first = segment_heat(np.full(5000, 4.0), 1.0, 1.5, FS, 0.05, 4.0)
    second = segment_heat(np.full(5000, 9.0), 1.75, 2.25, FS, 0.05, 9.0)
    losses = loss_history([second, first], 2.0, 1.0)
    energy = float(losses.power_w[:-1] @ np.diff(losses.time_s))
    # Settled for the whole second before the first, and for the quarter of a second between the two.
    assert energy == pytest.approx(3.0 * (4.0 * 1.5 + 9.0 * 0.75))
    assert (np.diff(losses.time_s) >= 0.0).all()


def test_a_long_gap_is_spent_without_current_until_the_drive_settles() -> None:
    items = [segment_heat(np.full(1000, 4.0), t, t + 0.1, FS, 0.05, 4.0) for t in (1.0, 60.0)]
    losses = loss_history(items, 1.0, 1.0)
    assert np.interp(30.0, losses.time_s, losses.power_w) < np.interp(59.5, losses.time_s, losses.power_w)
    assert float(losses.power_w[:-1] @ np.diff(losses.time_s)) == pytest.approx(1.5 * 4.0 * 2.2)


def test_a_drive_settles_after_a_long_gap_as_after_most_short_ones() -> None:
    starts = (0.2, 0.5, 0.8, 60.0)
    items = [segment_heat(np.full(1000, 4.0), t, t + 0.1, FS, 0.05, 4.0) for t in starts]
    losses = loss_history(items, 1.0, 1.0)
    assert float(losses.power_w[:-1] @ np.diff(losses.time_s)) == pytest.approx(1.5 * 4.0 * 4 * (0.1 + 0.2))


def test_means_of_a_history_keep_the_energy_of_the_samples() -> None:
    square = np.random.default_rng(1).uniform(0.0, 9.0, 1234)
    piece = segment_heat(square, 2.0, 2.0 + 1234 / FS, FS, 0.05, 0.0)
    seconds = np.diff(np.append(piece.times_s, piece.end_s))
    assert float(piece.squares @ seconds) == pytest.approx(float(square.sum()) / FS)


def test_a_long_experiment_has_no_more_steps_than_a_picture_needs() -> None:
    assert step_of(10.0) == LOSS_STEP_S
    assert step_of(36_000.0) == pytest.approx(18.0)
