"""The next injection, chosen and measured on a motor whose flux is known: how well the map is known, how honestly."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.analysis import Candidate, Inductances, KnownMap, known_map
from orchestrator.analysis._next_point import _gains, _root_after
from tests.orchestrator.analysis.plant import Array, flux_for, saturated_current
from tests.orchestrator.analysis.test_integration import exact
from tests.orchestrator.analysis.test_sweep import RATED_WB
from tests.support.close import assert_close

REACH_A = 2.9
STD_PER_ROOT_S = 0.02
"""Of the Hessian's entries in a capture of one second [1/H]."""
SETTLE_S = 0.12
ANGLES = np.pi / 3 * np.arange(6)
FIRST = REACH_A * np.concatenate(
    [share * np.stack([np.cos(some), np.sin(some)], axis=1) for share, some in ((1.0, ANGLES), (0.5, ANGLES[::2]))]
)
CANDIDATES = [
    Candidate((float(r * np.cos(a)), float(r * np.sin(a))), seconds, SETTLE_S + seconds)
    for r in (0.7, 1.5, 2.2, REACH_A)
    for a in np.linspace(0.0, np.pi, 9)
    for seconds in (0.1, 0.4)
]
PLACES = np.random.default_rng(3).uniform(-2.0, 2.0, (60, 2))


def injected(at: Array, capture_s: Array, random: np.random.Generator) -> Inductances:
    """What injections of these lengths tell there."""
    std = STD_PER_ROOT_S / np.sqrt(capture_s)
    clean = exact(at, 1.0)
    hessian = np.linalg.inv(clean.matrix)
    noise = std[:, None, None] * random.normal(size=(len(at), 3))[:, [[0, 1], [1, 2]]]
    slope_std = 0.02 / np.sqrt(capture_s)
    jitter = random.normal(size=(len(at), 4))[:, [[[0, 1], [1, 2]], [[1, 2], [2, 3]]]]
    covariance = clean.covariance * (std**2)[:, None, None]
    covariance[:, range(3, 7), range(3, 7)] = slope_std[:, None] ** 2
    matrix, slope = np.linalg.inv(hessian + noise), clean.slope + slope_std[:, None, None, None] * jitter
    return Inductances(at, np.asarray(matrix), slope, covariance)


def commissioned(seed: int, batches: int = 3) -> list[KnownMap]:
    """The map as it is known after the first points, and after each batch that it asks for."""
    random = np.random.default_rng(seed)
    at, capture_s = FIRST, np.full(len(FIRST), 0.1)
    points = injected(at, capture_s, random)
    known = [known_map(points, capture_s, 0.0, REACH_A)]
    for _ in range(batches):
        chosen = known[-1].best(CANDIDATES, 4)
        seconds = np.array([one.capture_s for one in chosen])
        more = injected(np.array([one.current_a for one in chosen]), seconds, random)
        points = Inductances(
            np.concatenate([points.current, more.current]),
            np.concatenate([points.matrix, more.matrix]),
            np.concatenate([points.slope, more.slope]),
            np.concatenate([points.covariance, more.covariance]),
        )
        capture_s = np.concatenate([capture_s, seconds])
        known.append(known_map(points, capture_s, 0.0, REACH_A))
    return known


@pytest.fixture(scope="module")
def known() -> list[KnownMap]:
    return commissioned(1)


def test_a_measured_point_leaves_the_covariance_that_bayes_rule_gives() -> None:
    random = np.random.default_rng(5)
    root, rows = random.normal(size=(9, 9)), random.normal(size=(3, 9))
    before = root @ root.T
    after = np.linalg.inv(np.linalg.inv(before) + rows.T @ rows)
    assert_close(_root_after(root, rows) @ _root_after(root, rows).T, after, 1e-8)


def test_the_gain_is_what_the_weighted_variance_loses() -> None:
    random = np.random.default_rng(6)
    root, rows, reach = random.normal(size=(8, 8)), random.normal(size=(2, 3, 8)), random.normal(size=(5, 2, 8))
    weight = np.square(reach @ root).sum(axis=(1, 2))
    for gain, one in zip(_gains(rows @ root, reach @ root), rows, strict=True):
        lost = weight - np.square(reach @ _root_after(root, one)).sum(axis=(1, 2))
        assert gain == pytest.approx(float(weight @ lost))


def test_the_band_narrows_with_every_batch(known: list[KnownMap]) -> None:
    worst = [one.band_wb[1] for one in known]
    assert worst == sorted(worst, reverse=True)
    assert worst[-1] < 0.5 * worst[0]
    assert all(rms < most for rms, most in (one.band_wb for one in known))


def test_the_same_measurements_ask_for_the_same_points(known: list[KnownMap]) -> None:
    assert commissioned(1, 1)[1].best(CANDIDATES, 4) == known[1].best(CANDIDATES, 4)


def test_chosen_points_tell_more_than_the_same_time_anywhere_else(known: list[KnownMap]) -> None:
    chosen = known[0].best(CANDIDATES, 1)[0]
    gains = _gains(known[0]._rows(CANDIDATES) @ known[0].root, known[0].reach @ known[0].root)
    per_second = gains / [one.seconds for one in CANDIDATES]
    assert per_second[CANDIDATES.index(chosen)] == per_second.max() > 2.0 * np.median(per_second)


def test_what_is_forecast_comes_true_within_a_factor_of_two(known: list[KnownMap]) -> None:
    spent = sum(one.seconds for one in known[0].best(CANDIDATES, 4))
    forecast = known[0].seconds_to(known[1].band_wb[1], CANDIDATES, 60.0)
    assert 0.5 * spent <= forecast <= 2.0 * spent
    assert known[0].seconds_to(0.0, CANDIDATES, 3.0) == 3.0


@pytest.mark.parametrize("seeds", [6, pytest.param(40, marks=pytest.mark.slow)])
def test_the_true_flux_is_inside_the_band_as_often_as_it_says(seeds: int) -> None:
    inside, off = [], []
    truth = flux_for(PLACES, saturated_current)
    for seed in range(seeds):
        for one in commissioned(seed, 2)[1:]:
            flux, std = one.fit.flux(PLACES)
            inside.append((np.abs(flux - truth) < 1.96 * std).mean())
            off.append(float(np.sqrt(np.square(flux - truth).sum(axis=1).mean())) / RATED_WB)
    assert 0.9 < np.mean(inside) < 0.995
    assert max(off) < 0.005
