"""The energy's map against the motor's own, beside the maps of the measurements it is made of."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from orchestrator.estimation import estimate_recording, load_flux_map
from plugins.estimators._energies import EnergyFlux
from plugins.estimators._maps import InjectedFlux, SweptFlux
from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.energy import EnergyEstimator
from plugins.estimators.injection import InjectionEstimator
from plugins.estimators.resistance import ResistanceEstimator
from protocols import EstimationContext, Estimator, FluxMapEstimate, NotMeasuredError, SegmentStage
from tests.orchestrator.analysis.plant import Array, flux_for, saturated_current, saturated_hessian
from tests.orchestrator.estimation.made_up import explained
from tests.plugins.estimators.recordings import (
    behind_dead_time,
    classical_of,
    clean,
    flux_error_percent,
    injection_of,
)
from tests.support.cases import few


@cache
def energy_of(inverter: bool) -> FluxMapEstimate:
    recording = behind_dead_time() if inverter else clean()
    return EnergyEstimator().estimate(recording, EstimationContext((injection_of(inverter), classical_of(inverter))))


def nodes_of(found: FluxMapEstimate) -> Array:
    return np.stack(np.meshgrid(found.map.i_d, found.map.i_q, indexing="ij"), axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("inverter", [False, True], ids=["clean", "dead time"])
def test_the_energys_map_is_better_than_what_it_is_made_of(inverter: bool) -> None:
    rms, worst = flux_error_percent(energy_of(inverter).map)
    others = [flux_error_percent(f(inverter).map)[0] for f in (injection_of, classical_of)]
    assert rms < min(0.1, 1.1 * min(others))
    assert worst < 0.3


@pytest.mark.slow
def test_its_inductances_are_the_inverse_hessian() -> None:
    found = energy_of(False)
    inductance = np.linalg.inv(saturated_hessian(flux_for(nodes_of(found), saturated_current)))
    for name, (a, b) in (("l_dd", (0, 0)), ("l_dq", (0, 1)), ("l_qq", (1, 1))):
        off = getattr(found.map, name) - inductance[..., a, b]
        assert np.sqrt(np.nanmean(off**2)) < 0.003 * np.nanmean(inductance[..., 1, 1])


@pytest.mark.slow
def test_its_standard_deviations_are_of_the_errors_size() -> None:
    found = energy_of(False)
    truth = flux_for(nodes_of(found), saturated_current)
    for off, std in (
        (found.map.psi_d - 0.3 - truth[..., 0], found.map.psi_d_std),
        (found.map.psi_q - truth[..., 1], found.map.psi_q_std),
    ):
        assert 0.2 < np.sqrt(np.nanmean(off**2) / np.nanmean(std**2)) < 3.0


def test_symmetries_hold_by_construction_and_the_misfit_is_the_check() -> None:
    checks = energy_of(False).checks
    assert checks.parity is not None
    assert checks.parity.d_percent == pytest.approx(0.0, abs=1e-9)
    assert checks.reciprocity_percent == pytest.approx(0.0, abs=0.05)
    assert checks.crossings is not None
    assert checks.crossings.q_percent is not None
    assert 0.01 < checks.crossings.q_percent < 1.0


@few("stage", [SegmentStage.INJECTION, SegmentStage.CLASSICAL])
def test_one_kind_of_measurement_is_enough(stage: SegmentStage) -> None:
    found = EnergyEstimator().estimate(clean().only(stage, SegmentStage.RESISTANCE), EstimationContext())
    assert flux_error_percent(found.map)[0] < 0.2
    assert found.checks.crossings is not None


def test_measurements_of_earlier_estimators_are_used() -> None:
    injected, swept = injection_of(False), classical_of(False)
    assert isinstance(injected, InjectedFlux)
    assert isinstance(swept, SweptFlux)
    found = energy_of(False)
    assert len(found.points.i_dq) == len(injected.points.i_dq) + len(swept.points.i_dq)
    assert len(found.points.segment) == len(found.points.i_dq)


def test_without_either_nothing_is_stated() -> None:
    with pytest.raises(NotMeasuredError, match="no segment of stage injection"):
        EnergyEstimator().estimate(clean().only(SegmentStage.RESISTANCE), EstimationContext())


@pytest.mark.slow
def test_its_map_is_the_recommended_one(tmp_path: Path) -> None:
    estimators: list[Estimator] = [
        EnergyEstimator(),
        InjectionEstimator(),
        ClassicalEstimator(),
        ResistanceEstimator(),
    ]
    report = estimate_recording(behind_dead_time(), estimators, tmp_path, check_model=explained)
    assert report.method == "energy"
    assert report.usable
    assert "energy.flux_error" in {remark.code for remark in report.remarks}
    assert flux_error_percent(load_flux_map(tmp_path / "results" / "flux_map.nc"))[1] < 0.3
    assert (tmp_path / "results" / "flux_map_injection.nc").is_file()


@pytest.mark.slow
@pytest.mark.parametrize(("std_h", "expected"), [(1e-4, True), (5e-4, False)], ids=["clear", "within its own error"])
def test_dead_time_is_spoken_of_where_it_is_beyond_its_own_error(std_h: float, expected: bool) -> None:
    found = energy_of(True)
    assert isinstance(found, EnergyFlux)
    size = np.ones_like(found.fit.correction)
    vague = replace(found.fit, inverter_step=0.04, correction=1e-3 * size, correction_std=std_h * size)
    estimates = (injection_of(True), classical_of(True), found.model_copy(update={"fit": vague}))
    again = EnergyEstimator().estimate(behind_dead_time(), EstimationContext(estimates))
    assert ("inverter_step" in {remark.code for remark in again.remarks}) == expected
