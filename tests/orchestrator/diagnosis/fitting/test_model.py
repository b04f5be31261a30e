"""What a fit consists of, and the figures that are read from it."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.corrections import apply_effects
from orchestrator.diagnosis.fitting.model import Fit, MapSpace
from orchestrator.numerics.frames import to_dq
from plugins.effects.frame import RotorMisalignment
from protocols import SignalBatch
from tests.orchestrator.diagnosis.fitting.test_fit import fitted_bias, with_free
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
        for p, f, d, r in zip(fit.prepared.pieces, fit.linearisation.pieces, fit.columns, fit.resistance, strict=True)
        if not p.held_out
    ]
    whole = sum((x.T @ x for x in rows), np.zeros((1 + GRID.size + count,) * 2))
    whole[1 : 1 + GRID.size, 1 : 1 + GRID.size] += fit.model.space.prior.T @ fit.model.space.prior
    whole[-count:, -count:] += np.eye(count)
    np.testing.assert_allclose(fit.covariance(), np.linalg.inv(whole)[-count:, -count:], rtol=1e-4)


def test_each_segment_of_a_frame_is_found_wherever_its_batch_is(fit: Fit) -> None:
    places = [k for linearisation in fit.linearisation.batches for k in linearisation.batch.places]
    assert sorted(places) == list(range(len(fit.prepared.pieces)))
    assert places != sorted(places)
    for k, piece in enumerate(fit.prepared.pieces):
        batch, base = fit.linearisation.base_of(k)
        assert batch.pieces == (piece,)
        np.testing.assert_array_equal(base.i_ab, piece.signals.i_ab)
        np.testing.assert_array_equal(base.resistance_ohm, fit.linearisation.batches[0].base.resistance_ohm[0])
        assert len(fit.linearisation.pieces[k].basis) == piece.windows.rows
    with pytest.raises(IndexError):
        fit.linearisation.base_of(len(fit.prepared.pieces))


def test_a_segment_is_corrected_as_if_it_were_alone(fit: Fit) -> None:
    for k, piece in enumerate(fit.prepared.pieces):
        base = fit.linearisation.base_of(k)[1].segment(0)
        alone = apply_effects(SignalBatch.of([base]), fit.model.active).signals
        corrected = fit.corrected(k)
        assert corrected.samples == len(piece.signals.v_dc)
        np.testing.assert_array_equal(corrected.v_ab, alone.v_ab)
        assert (np.abs(corrected.v_ab - piece.signals.v_ab).max() > 0.1) == piece.signals.bridge_on


def test_true_currents_are_those_of_the_rotor_where_the_effects_have_it() -> None:
    maker = fitter(prepared(plan(sparse=True), angle=0.4))
    model = with_free(free_model(), maker, RotorMisalignment(), angle_rad=0.05)
    fit = maker.evaluate(model, maker.linearise(model))
    currents = fit.true_currents()
    assert len(currents) == len(maker.prepared.pieces)
    for k, (piece, current) in enumerate(zip(maker.prepared.pieces, currents, strict=True)):
        corrected = fit.corrected(k)
        np.testing.assert_allclose(current, to_dq(corrected.i_m_ab, corrected.theta_rad), atol=1e-12)
        if piece.signals.bridge_on:
            assert abs(corrected.theta_rad[0] - 0.4) == pytest.approx(0.05)
