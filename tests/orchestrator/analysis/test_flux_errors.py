"""The errors of integrated flux: waves along a path, and what paths swept alike have in common."""

from __future__ import annotations

import numpy as np

from orchestrator.analysis import FluxPath
from orchestrator.analysis._flux_errors import WAVES, directions, sizes, waves, whitening
from orchestrator.analysis._inductance_errors import error_modes
from tests.orchestrator.analysis.test_energy_fit import paths
from tests.orchestrator.analysis.test_integration import PLANE, exact
from tests.support.close import assert_close


def test_the_waves_of_a_random_walk_fall_as_one_over_their_number() -> None:
    random = np.random.default_rng(5)
    walks = np.cumsum(random.normal(size=(400, 61)), axis=1)
    amplitude = np.sqrt(np.square(walks @ waves(61).T).mean(axis=0))
    level = amplitude * np.arange(1, WAVES + 1)
    assert level.std() < 0.1 * level.mean()


def test_waves_do_not_see_a_constant_and_tell_each_other_apart() -> None:
    take = waves(61)
    np.testing.assert_allclose(take @ np.ones(61), 0.0, atol=1e-12)
    place = (np.arange(61) + 0.5) / 61
    shapes = np.cos(np.pi * np.outer(place, np.arange(1, WAVES + 1)))
    np.testing.assert_allclose(take @ shapes, np.eye(WAVES), atol=1e-12)


def test_paths_swept_alike_tell_their_mean_less_well_than_their_differences() -> None:
    several = paths()
    apart = whitening(several)
    alike = np.abs(directions(several)[:, 0] @ directions(several)[:, 0].T) > 0.99
    assert (apart[~alike] == 0.0).all()
    covariance = np.linalg.inv(apart.T @ apart)
    np.testing.assert_allclose(
        covariance[alike], np.where(np.eye(len(several), dtype=bool)[alike], 2.0, 1.0), atol=1e-9
    )


def test_sizes_follow_the_swept_direction() -> None:
    current = np.outer(np.linspace(-1.0, 1.0, 61), [0.0, 1.0])
    psi = np.outer(np.linspace(-0.07, 0.07, 61), [0.0, 1.0])
    one = sizes([FluxPath(current, psi, np.array([1e-3, 5e-3]))])[0]
    np.testing.assert_allclose(one[0] / one[1], 5.0, rtol=1e-3)


def test_dead_time_acts_along_the_phase_whose_current_is_zero() -> None:
    points = exact(PLANE)
    at_a = np.abs(PLANE[:, 0]) < 1e-9
    far = at_a & (np.abs(PLANE[:, 1]) > 2.0)
    effect = error_modes(points, np.zeros(len(PLANE)))[:, :3, 1]
    assert (effect[far, 0] > 0.0).all()
    assert_close(effect[far, 1:], np.zeros_like(effect[far, 1:]), 1e-12, of=effect)
    turned = error_modes(points, np.full(len(PLANE), np.pi / 2))[:, :3, 1]
    at_q = (np.abs(PLANE[:, 1]) < 1e-9) & (np.abs(PLANE[:, 0]) > 2.0)
    assert_close(turned[at_q, :2], np.zeros_like(turned[at_q, :2]), 1e-12, of=turned)
    assert (turned[at_q, 2] > 0.0).all()
