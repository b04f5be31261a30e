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
    given_model,
    has_fine_grid,
    is_finer_map_justified,
    map_log_evidence,
    map_space,
    on_usual_grid,
    widened_map,
    with_finest_map,
    with_freed_map,
    with_kink_switched,
)
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.reporting.ladder import rung
from orchestrator.diagnosis.reporting.motor_model import kept_model, restored
from orchestrator.diagnosis.selection.search_state import AcceptedModel
from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.tensor_spline import EvenSpline
from plugins.effects.frame import BrakeCompliance, RotorMisalignment
from plugins.effects.timing import CurrentFilter
from protocols import FluxMap, MotorModel, Nameplate, NotMeasuredError, Saturated
from tests.orchestrator.diagnosis.pieces import L_D, L_Q, PM_WB, R_S, Array


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


def test_a_rotor_that_hardly_twists_does_not_set_the_magnet_free(setup: DiagnosisSetup) -> None:
    brake = scaled_library([BrakeCompliance()], setup.prepared.manifest)[0].absent().moved("rad_per_nm", 1e-6)
    model = baseline_model(setup, Saturated())
    fits = [setup.fitter.fit(model.with_active(active)) for active in ([], [replace(brake, free=())])]
    at_rest = [float(fit.model.magnetics.flux_and_inductance(np.zeros((1, 2)))[0][0, 0]) for fit in fits]
    assert np.abs(at_rest).max() < 0.01 * PM_WB
    assert fits[1].chi2 == pytest.approx(fits[0].chi2, rel=1e-3)


def test_each_rung_of_the_map_holds_the_one_before(setup: DiagnosisSetup) -> None:
    held = baseline_model(setup, Nameplate())
    axes = with_freed_map(setup, held, Nameplate(freed=("saturation",)))
    free = with_freed_map(setup, axes, Nameplate(freed=("saturation", "cross_saturation")))
    counts = [model.space.directions.shape[1] for model in (held, axes, free)]
    assert counts[0] == 0
    assert counts[0] < counts[1] < counts[2] == free.space.grid.size
    assert free.space.is_free
    for inner, outer in ((held, axes), (axes, free)):
        offset = inner.magnetics.coefficients - outer.space.origin
        left = offset - outer.space.directions @ np.linalg.lstsq(outer.space.directions, offset, rcond=None)[0]
        np.testing.assert_allclose(left, 0.0, atol=1e-9 * np.abs(offset).max())


def test_a_map_with_saturation_alone_has_no_cross_saturation(setup: DiagnosisSetup) -> None:
    axes = with_freed_map(setup, baseline_model(setup, Nameplate()), Nameplate(freed=("saturation",)))
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
    assert not has_fine_grid(setup.fitter.fit(model))
    assert model.r_s == R_S


def test_a_map_that_does_not_reach_the_recordings_currents_is_refused(setup: DiagnosisSetup) -> None:
    far = _flux_map(1.0).model_copy(update={"i_d": np.linspace(50.0, 60.0, 15)})
    with pytest.raises(NotMeasuredError, match="does not cover"):
        given_model(setup, far)


def test_a_map_is_made_as_wide_as_the_currents_where_the_rotor_lies(setup: DiagnosisSetup) -> None:
    effect = RotorMisalignment()
    library = scaled_library([effect], setup.prepared.manifest, ())
    fit = setup.fitter.fit(baseline_model(setup, Saturated()), relinearisations=0)
    assert widened_map(setup, setup.fitter, fit) is fit
    turned = library[0].absent().moved("angle_rad", 4.0)
    seen = setup.fitter.evaluate(
        fit.model.with_active([turned]), setup.fitter.linearise(fit.model.with_active([turned]))
    )
    wider = widened_map(setup, setup.fitter, seen).model.space.grid
    own = fit.model.space.grid
    angle = turned.values["angle_rad"]
    currents = np.concatenate([to_dq(p.signals.i_ab, p.segment.rotor_angle_rad + angle) for p in setup.prepared.pieces])
    assert wider.low <= currents[:, 0].min() + 1e-9
    assert wider.high >= currents[:, 0].max() - 1e-9
    assert wider.reach >= np.abs(currents[:, 1]).max() - 1e-9
    assert (wider.low, wider.high, wider.reach) != (own.low, own.high, own.reach)
    assert wider.cells == own.cells


def _regridded(fit: Fit, cells: tuple[int, int], *, kink: bool = False) -> EvenSpline:
    return replace(fit.model.space.grid, cells=cells, kink=kink)


def test_a_machine_that_is_linear_asks_for_no_finer_map(setup: DiagnosisSetup, linear_fit: Fit) -> None:
    fit = linear_fit
    coarsest = setup.criteria.intervals[0]
    assert fit.model.space.grid.cells == (coarsest, coarsest)
    assert fit.chi2_per_dof == pytest.approx(1.0, abs=0.3)
    finer, kinked = (
        _regridded(fit, (setup.criteria.intervals[1],) * 2),
        _regridded(fit, fit.model.space.grid.cells, kink=True),
    )
    assert finer_map(setup, setup.fitter, fit, finer) is None
    assert finer_map(setup, setup.fitter, fit, kinked) is None


@pytest.mark.parametrize("cells", [(10, 10), (14, 6)])
def test_a_finer_map_is_requested_though_one_between_is_not_worth_its_freedom(
    setup: DiagnosisSetup, cells: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a knee lies between the nodes of eight intervals and on one of ten, or of fourteen."""
    fit = setup.fitter.fit(baseline_model(setup, Saturated()), relinearisations=0)
    fit = replace(fit, chi2=5.0 * fit.dof)
    finest = replace(fit, chi2=1.02 * fit.dof)

    def at_those_alone(_: DiagnosisSetup, __: Fitter, given: Fit, grid: EvenSpline, ___: object = None) -> Fit | None:
        return finest if given is fit and grid.cells == cells else None

    monkeypatch.setattr(baseline, "finer_map", at_those_alone)
    assert with_finest_map(setup, setup.fitter, fit) is finest


@pytest.mark.slow
@pytest.mark.parametrize("rests", [False, True])
def test_a_finer_map_is_that_of_the_current_that_effects_see_where_they_have_come_to(
    sharp: DiagnosisSetup, rests: bool
) -> None:
    """A frame in which they have moved far is of before; where they rest it is as good as one made anew."""
    bare = sharp.fitter.fit(baseline_model(sharp, Saturated()), relinearisations=0)
    lag = scaled_library([CurrentFilter()], sharp.prepared.manifest)[0].absent()
    lag = lag.moved("time_constant_s", lag.standardised_value("time_constant_s") + 20.0)
    moved = bare.model.with_active([lag if not rests else replace(lag, free=())])
    fit = sharp.fitter.fit(moved, relinearisations=2) if rests else sharp.fitter.evaluate(moved, bare.linearisation)
    cells = (fit.model.space.grid.cells[0], 12)
    finer = finer_map(sharp, sharp.fitter, fit, _regridded(fit, cells))
    assert finer is not None
    anew = sharp.fitter.fit(on_the_grid(sharp, fit, cells), steps=2, relinearisations=0)
    assert finer.chi2 == pytest.approx(anew.chi2, rel=2e-3 if rests else 1e-12)


def test_iron_that_saturates_from_zero_flux_on_gets_a_kink_and_no_finer_map_along_the_other_axis(
    sharp: DiagnosisSetup, sharp_fit: Fit
) -> None:
    fit = sharp_fit
    assert fit.model.space.grid.kink
    finest = sharp.criteria.intervals[-1]
    assert fit.model.space.grid.cells[0] <= finest
    usual = sharp.fitter.fit(on_the_grid(sharp, fit, (finest, finest)), relinearisations=0)
    assert usual.chi2_per_dof > 3.0
    assert not has_fine_grid(usual)
    assert fit.chi2_per_dof - 1.0 < 0.1 * (usual.chi2_per_dof - 1.0)


@pytest.mark.slow
def test_without_a_kink_such_iron_gets_a_finer_map_along_that_axis_alone(sharp_fit_without_kink: Fit) -> None:
    d, q = sharp_fit_without_kink.model.space.grid.cells
    assert q >= 20
    assert d < q


def test_a_kink_has_more_evidence_on_such_iron_and_less_on_a_linear_machine(
    sharp: DiagnosisSetup, sharp_fit: Fit, setup: DiagnosisSetup, linear_fit: Fit
) -> None:
    usual = sharp.fitter.fit(on_usual_grid(sharp, sharp_fit), relinearisations=0)
    smooth = with_kink_switched(sharp, sharp.fitter, usual)
    assert not smooth.model.space.grid.kink
    assert map_log_evidence(usual) > map_log_evidence(smooth) + 100.0
    assert map_log_evidence(with_kink_switched(setup, setup.fitter, linear_fit)) < map_log_evidence(linear_fit)


@pytest.mark.slow
def test_sharpness_is_earned_by_iron_that_saturates_sharply_and_by_no_other(
    sharp: DiagnosisSetup, sharp_fit_without_kink: Fit, setup: DiagnosisSetup, linear_fit: Fit
) -> None:
    usual = sharp.fitter.fit(on_usual_grid(sharp, sharp_fit_without_kink), relinearisations=0)
    assert not has_fine_grid(usual)
    assert is_finer_map_justified(sharp_fit_without_kink, usual)
    space = linear_fit.model.space
    rough = replace(linear_fit.model, space=replace(space, roughness=np.full((1, 1), 9.0), prior=space.prior / 9.0))
    needless = setup.fitter.fit(rough, relinearisations=0)
    assert has_fine_grid(needless)
    assert not is_finer_map_justified(needless, setup.fitter.fit(on_usual_grid(setup, needless), relinearisations=0))


def on_the_grid(setup: DiagnosisSetup, fit: Fit, cells: tuple[int, int]) -> Model:
    grid = EvenSpline(*setup.prepared.current_range, cells)
    space = map_space(setup, Saturated(), grid, np.zeros(grid.size))
    return replace(fit.model, space=space, magnetics=fit.model.magnetics.on(grid))


def test_a_map_that_was_let_be_rough_is_as_rough_when_it_is_read_back(sharp: DiagnosisSetup, sharp_fit: Fit) -> None:
    fit = sharp_fit
    kept = kept_model(sharp, fit, Saturated(), (), [rung(AcceptedModel(None, fit))])
    again = restored(sharp, MotorModel.model_validate_json(kept.model_dump_json()), Saturated(), {})
    np.testing.assert_allclose(again.space.prior, fit.model.space.prior)
    np.testing.assert_array_equal(again.space.roughness, fit.model.space.roughness)
    assert again.space.grid == fit.model.space.grid
    np.testing.assert_array_equal(again.magnetics.coefficients, fit.model.magnetics.coefficients)


def test_what_a_sharper_map_takes_little_of_is_not_the_maps(
    setup: DiagnosisSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit = setup.fitter.fit(on_the_grid(setup, setup.fitter.fit(baseline_model(setup, Saturated())), (10, 10)))
    off = replace(fit, chi2=5.0 * fit.dof)
    for left, taken in ((0.95, False), (0.5, True)):
        better = replace(fit, chi2=(1.0 + 4.0 * left) * fit.dof)
        ended = replace(fit, chi2=fit.dof)
        trials = iter([None, None, better, None, None, ended, *[None] * 12])
        monkeypatch.setattr(baseline, "finer_map", lambda *_, trials=trials: next(trials))
        monkeypatch.setattr(baseline, "_finer_grids", lambda *_: [(_regridded(fit, (10, 14)), 1.0)])
        assert (with_finest_map(setup, setup.fitter, off) is not off) is taken
