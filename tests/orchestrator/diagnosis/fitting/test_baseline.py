"""Where a diagnosis starts: spaces of maps from rigid to free, and no finer a map than the data ask for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting import baseline
from orchestrator.diagnosis.fitting.baseline import (
    DiagnosisSetup,
    baseline_model,
    finer_map,
    fitted_baseline,
    freed_further,
    given_model,
    with_detail,
)
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from protocols import FluxMap, Nameplate, NotMeasuredError, Saturated
from tests.orchestrator.diagnosis.pieces import L_D, L_Q, PM_WB, R_S, Array, fitter, plan, prepared, setup_of


@pytest.fixture(scope="module")
def setup() -> DiagnosisSetup:
    return setup_of(fitter(prepared(plan())))


def _flux_map(reach: float, bend: float = 0.0) -> FluxMap:
    i = np.linspace(-reach, reach, 15)
    d, q = np.meshgrid(i, i, indexing="ij")

    def grid(value: Array | float) -> Array:
        return np.broadcast_to(np.asarray(value, dtype=np.float64), d.shape).copy()

    nothing = grid(np.nan)
    return FluxMap(
        method="given",
        i_d=i,
        i_q=i,
        psi_d=PM_WB + L_D * d - bend * d**3,
        psi_q=L_Q * q - bend * q**3,
        l_dd=grid(L_D - 3.0 * bend * d**2),
        l_dq=grid(0.0),
        l_qq=grid(L_Q - 3.0 * bend * q**2),
        psi_d_std=nothing,
        psi_q_std=nothing,
        l_dd_std=nothing,
        l_dq_std=nothing,
        l_qq_std=nothing,
    )


def test_each_rung_of_the_map_holds_the_one_before(setup: DiagnosisSetup) -> None:
    held = baseline_model(setup, Nameplate())
    axes = freed_further(setup, held, Nameplate(freed=("saturation",)))
    free = freed_further(setup, axes, Nameplate(freed=("saturation", "cross_saturation")))
    counts = [model.space.directions.shape[1] for model in (held, axes, free)]
    assert counts[0] == 0
    assert counts[0] < counts[1] < counts[2] == free.space.grid.size
    assert free.space.is_free
    for inner, outer in ((held, axes), (axes, free)):
        offset = inner.magnetics.coefficients - outer.space.origin
        left = offset - outer.space.directions @ np.linalg.lstsq(outer.space.directions, offset, rcond=None)[0]
        np.testing.assert_allclose(left, 0.0, atol=1e-9 * np.abs(offset).max())


def test_a_map_with_saturation_alone_has_no_cross_saturation(setup: DiagnosisSetup) -> None:
    axes = freed_further(setup, baseline_model(setup, Nameplate()), Nameplate(freed=("saturation",)))
    rng = np.random.default_rng(1)
    coefficients = axes.space.directions @ rng.normal(size=axes.space.directions.shape[1])
    at = rng.uniform(-2.0, 2.0, (50, 2))
    l_dq = (axes.space.grid.rows(at, 1, 1) @ coefficients).max()
    assert abs(float(l_dq)) < 1e-9 * float(np.abs(axes.space.grid.rows(at, 2, 0) @ coefficients).max())


def test_a_given_map_is_kept_as_it_is(setup: DiagnosisSetup) -> None:
    model = given_model(setup, _flux_map(4.0, bend=5e-4))
    at = np.array([[1.0, 1.5], [-2.0, 0.5], [0.0, 0.0]])
    psi, _ = model.magnetics.flux_and_inductance(at)
    expected = at * np.array([L_D, L_Q]) - 5e-4 * at**3
    np.testing.assert_allclose(psi - psi[2], expected, atol=2e-4 * L_Q * 2.5)
    assert model.space.directions.shape[1] == 0
    assert model.r_s == R_S


def test_a_map_that_does_not_reach_the_recordings_currents_is_refused(setup: DiagnosisSetup) -> None:
    far = _flux_map(1.0).model_copy(update={"i_d": np.linspace(50.0, 60.0, 15)})
    with pytest.raises(NotMeasuredError, match="does not cover"):
        given_model(setup, far)


def test_a_machine_that_is_linear_asks_for_no_finer_map(setup: DiagnosisSetup) -> None:
    fit = fitted_baseline(setup)
    coarsest = setup.criteria.intervals[0]
    assert fit.model.space.grid.cells == (coarsest, coarsest)
    assert fit.chi2_per_dof == pytest.approx(1.0, abs=0.3)
    assert finer_map(setup, setup.fitter, fit, setup.criteria.intervals[1]) is None


def test_a_finer_map_is_asked_though_one_between_is_not_worth_its_freedom(
    setup: DiagnosisSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a knee lies between the nodes of eight intervals and on one of ten."""
    fit = setup.fitter.fit(baseline_model(setup, Saturated()), renewals=0)
    finest = replace(fit, chi2=0.9 * fit.chi2)

    def at_the_finest(_: DiagnosisSetup, __: Fitter, given: Fit, intervals: int) -> Fit | None:
        assert given is fit
        return finest if intervals == setup.criteria.intervals[-1] else None

    monkeypatch.setattr(baseline, "finer_map", at_the_finest)
    assert with_detail(setup, setup.fitter, fit) is finest
