from __future__ import annotations

from dataclasses import replace

import numpy as np

from orchestrator.numerics.random_walk import no_walk, random_walk
from orchestrator.numerics.types import Array

TIME = np.linspace(0.0, 10.0, 40)
GAIN = np.stack([np.cos(TIME), np.sin(TIME)], axis=1)
EVERY = np.ones(len(TIME), dtype=bool)
DESIGN = GAIN.reshape(-1, 1)


def seen(values: Array, noise: float, seed: int) -> Array:
    random = np.random.default_rng(seed)
    return np.asarray((GAIN * values[:, None]).ravel() + noise * random.normal(size=2 * len(TIME)))


def test_without_a_walk_it_is_least_squares() -> None:
    target = seen(np.full(len(TIME), 3.0), 0.1, 1)
    squares, answer = no_walk(len(target)).solve(DESIGN, target)
    expected, left = np.linalg.lstsq(DESIGN, target, rcond=None)[:2]
    np.testing.assert_allclose(answer, expected, rtol=1e-12)
    np.testing.assert_allclose(squares, left[0], rtol=1e-9)


def test_beside_a_walk_it_is_generalised_least_squares() -> None:
    target = seen(3.0 + np.sin(TIME), 0.1, 2)
    walk = replace(random_walk(TIME, GAIN, EVERY), ratio=0.7)
    inverse = np.linalg.inv(np.eye(len(target)) + walk.ratio * walk.steps @ walk.steps.T)
    covariance = np.linalg.inv(DESIGN.T @ inverse @ DESIGN)
    squares, answer = walk.solve(DESIGN, target)
    expected = covariance @ DESIGN.T @ inverse @ target
    off = target - DESIGN @ expected
    np.testing.assert_allclose(answer, expected, rtol=1e-9)
    np.testing.assert_allclose(squares, off @ inverse @ off, rtol=1e-9)
    np.testing.assert_allclose(walk.covariance(DESIGN), covariance, rtol=1e-9)


def test_a_walk_with_as_many_nodes_as_instants_has_their_covariance() -> None:
    steps = random_walk(TIME, np.ones((len(TIME), 1)), TIME[0] == TIME, nodes=len(TIME)).steps
    since = TIME / TIME[-1]
    np.testing.assert_allclose(steps @ steps.T, np.minimum(since[:, None], since[None, :]), rtol=0.0, atol=1e-12)


def test_what_stands_still_is_not_made_to_wander() -> None:
    taken = []
    for seed in range(10):
        target = seen(np.full(len(TIME), 3.0), 0.1, seed)
        taken.append(random_walk(TIME, GAIN, EVERY).likeliest(DESIGN, target).freedom)
    assert np.median(taken) < 1.0


def test_the_mean_over_the_counted_instants_is_held_as_often_as_stated() -> None:
    counted = TIME > 3.0
    held = []
    for seed in range(100):
        walk = np.cumsum(np.random.default_rng(1000 + seed).normal(size=len(TIME))) * 0.1
        target = seen(3.0 + walk, 0.1, seed)
        found = random_walk(TIME, GAIN, counted).likeliest(DESIGN, target)
        squares, answer = found.solve(DESIGN, target)
        std = np.sqrt(squares / (len(target) - 1) * found.covariance(DESIGN)[0, 0])
        held.append(abs(answer[0] - (3.0 + walk)[counted].mean()) < 2.0 * std)
    assert 0.88 < np.mean(held) <= 1.0
