"""What every map of a measurement keeps: inductances, conventions, checks, errors of their stated size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orchestrator.estimation import estimate_recording, load_flux_map
from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.injection import InjectionEstimator
from plugins.estimators.resistance import ResistanceEstimator
from protocols import (
    EstimationContext,
    Estimator,
    NotMeasuredError,
    SegmentStage,
)
from tests.orchestrator.analysis.plant import flux_for, saturated_current, saturated_hessian
from tests.orchestrator.estimation.made_up import explained
from tests.plugins.estimators.recordings import (
    classical_of,
    clean,
    flux_error_percent,
    injection_of,
)


def test_dead_time_hurts_neither_map() -> None:
    by_injection, by_integration = (flux_error_percent(f(True).map)[0] for f in (injection_of, classical_of))
    assert by_injection < 0.3
    assert by_integration < 0.5


@pytest.mark.parametrize("method", ["injection", "classical"])
def test_inductances_are_the_inverse_hessian(method: str) -> None:
    flux_map = (injection_of(False) if method == "injection" else classical_of(False)).map
    truth = flux_for(np.stack(np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij"), axis=-1), saturated_current)
    inductance = np.linalg.inv(saturated_hessian(truth))
    for found, (a, b) in ((flux_map.l_dd, (0, 0)), (flux_map.l_dq, (0, 1)), (flux_map.l_qq, (1, 1))):
        off = found - inductance[..., a, b]
        assert np.sqrt(np.nanmean(off**2)) < 0.01 * np.nanmean(inductance[..., 1, 1])


@pytest.mark.parametrize("method", ["injection", "classical"])
def test_maps_keep_the_conventions(method: str) -> None:
    found = injection_of(False) if method == "injection" else classical_of(False)
    flux_map = found.map
    assert flux_map.method == method
    d, q = int(np.argmin(np.abs(flux_map.i_d))), int(np.argmin(np.abs(flux_map.i_q)))
    assert flux_map.psi_d[d, q] == pytest.approx(0.3, abs=1e-4)
    assert flux_map.psi_q[d, q] == pytest.approx(0.0, abs=1e-4)
    assert np.isfinite(flux_map.psi_d).mean() > 0.95
    assert (np.abs(flux_map.i_d) < 3.01).all()
    reached = saturated_current(found.points.psi_dq - np.array([0.3, 0.0]))
    assert np.abs(reached - found.points.i_dq).max() < 0.05
    assert len(found.points.segment) == len(found.points.i_dq)


@pytest.mark.parametrize("method", ["injection", "classical"])
def test_an_even_motor_passes_all_checks(method: str) -> None:
    checks = (injection_of(False) if method == "injection" else classical_of(False)).checks
    assert checks.crossings is not None
    assert checks.parity is not None
    for figure in (checks.crossings.d_percent, checks.crossings.q_percent, checks.parity.d_percent):
        assert figure is not None
        assert figure < 0.5
    assert checks.reciprocity_percent is not None
    assert checks.reciprocity_percent < 1.0


@pytest.mark.parametrize("method", ["injection", "classical"])
def test_standard_deviations_are_of_the_errors_size(method: str) -> None:
    flux_map = (injection_of(False) if method == "injection" else classical_of(False)).map
    truth = flux_for(np.stack(np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij"), axis=-1), saturated_current)
    inductance = np.linalg.inv(saturated_hessian(truth))
    pairs = (
        (flux_map.psi_d - 0.3 - truth[..., 0], flux_map.psi_d_std),
        (flux_map.psi_q - truth[..., 1], flux_map.psi_q_std),
        (flux_map.l_dd - inductance[..., 0, 0], flux_map.l_dd_std),
        (flux_map.l_qq - inductance[..., 1, 1], flux_map.l_qq_std),
    )
    for off, std in pairs:
        assert 0.1 < np.sqrt(np.nanmean(off**2) / np.nanmean(std**2)) < 5.0


@pytest.mark.parametrize("estimator", [ResistanceEstimator(), ClassicalEstimator(), InjectionEstimator()])
def test_what_was_not_measured_is_stated(
    estimator: ResistanceEstimator | ClassicalEstimator | InjectionEstimator,
) -> None:
    with pytest.raises(NotMeasuredError, match="test: segments"):
        estimator.estimate(clean().only(SegmentStage.GATES_OFF), EstimationContext())


def test_one_line_of_points_or_paths_is_no_map() -> None:
    recording = clean()
    row = tuple(recording.segments(SegmentStage.INJECTION)[10:15])
    with pytest.raises(NotMeasuredError, match="span an area"):
        InjectionEstimator().estimate(recording.with_segments(row), EstimationContext())
    parallel = tuple(recording.segments(SegmentStage.CLASSICAL)[:5])
    with pytest.raises(NotMeasuredError, match="span an area"):
        ClassicalEstimator().estimate(recording.with_segments(parallel), EstimationContext())


def test_whole_estimate_from_recording_to_files(tmp_path: Path) -> None:
    estimators: list[Estimator] = [InjectionEstimator(), ClassicalEstimator(), ResistanceEstimator()]
    report = estimate_recording(clean(), estimators, tmp_path, check_model=explained)
    assert report.usable
    assert report.method == "injection"
    assert report.classical_against_injection_percent is not None
    assert report.classical_against_injection_percent < 0.5
    assert flux_error_percent(load_flux_map(tmp_path / "results" / "flux_map.nc"))[1] < 0.5
    assert flux_error_percent(load_flux_map(tmp_path / "results" / "flux_map_classical.nc"))[1] < 0.5
