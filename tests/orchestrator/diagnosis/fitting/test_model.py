"""What a fit consists of, and the figures that are read from it."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.model import Fit, MapSpace
from tests.orchestrator.diagnosis.fitting.test_fit import fitted_bias
from tests.orchestrator.diagnosis.pieces import GRID, fitter, free_model, plan, prepared, with_voltage


@pytest.fixture(scope="module")
def fit() -> Fit:
    return fitted_bias(fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.0]))))


def test_a_space_is_free_only_where_every_coefficient_is() -> None:
    space = free_model().space
    assert space.is_free
    some = MapSpace(GRID, space.origin, space.directions[:, :3], space.prior[:, :3])
    assert not some.is_free


def test_chi2_is_the_sum_over_the_training_segments(fit: Fit) -> None:
    parts = [e for p, e in zip(fit.prepared.pieces, fit.residual, strict=True) if not p.held_out]
    assert fit.chi2 == pytest.approx(sum(float(e @ e) for e in parts))
    mean = fit.chi2_of(lambda p: not p.held_out)
    assert mean is not None
    assert mean * sum(map(len, parts)) == pytest.approx(fit.chi2)
    assert fit.chi2_of(lambda _: False) is None
    assert fit.rms_v(lambda _: False) is None


def test_freedom_is_what_the_prior_leaves_of_it(fit: Fit) -> None:
    rows = sum(len(e) for p, e in zip(fit.prepared.pieces, fit.residual, strict=True) if not p.held_out)
    unknowns = 1 + GRID.size + len(fit.model.free)
    assert rows - unknowns < fit.dof < rows - len(fit.model.free) - 1


def test_covariance_is_that_of_all_unknowns_together(fit: Fit) -> None:
    """The inverse of the whole normal matrix, and the part of it that the parameters have: Schur's complement."""
    count = len(fit.model.free)
    rows = [
        np.column_stack([r, f.white_basis, d])
        for p, f, d, r in zip(fit.prepared.pieces, fit.frame.pieces, fit.columns, fit.resistance, strict=True)
        if not p.held_out
    ]
    whole = sum((x.T @ x for x in rows), np.zeros((1 + GRID.size + count,) * 2))
    whole[1 : 1 + GRID.size, 1 : 1 + GRID.size] += fit.model.space.prior.T @ fit.model.space.prior
    whole[-count:, -count:] += np.eye(count)
    np.testing.assert_allclose(fit.covariance(), np.linalg.inv(whole)[-count:, -count:], rtol=1e-4)
