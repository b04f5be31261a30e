"""The built-in estimators on a recording of a motor whose flux is known, at every current."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from orchestrator.estimation import estimate_recording, load_flux_map
from plugins.estimators._maps import InjectedFlux
from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.injection import InjectionEstimator
from plugins.estimators.resistance import ResistanceEstimator, constant_currents
from protocols import (
    EstimationContext,
    Estimator,
    FluxMap,
    FluxMapEstimate,
    NotMeasuredError,
    ResistanceEstimate,
    SegmentStage,
)
from tests.orchestrator.analysis.campaign import MOTOR, MemoryRecording, make_recording
from tests.orchestrator.analysis.plant import R_S, Array, flux_for, saturated_current, saturated_hessian

RATED_WB = float(np.linalg.norm(flux_for(np.array([0.0, MOTOR.rated_current_a or 0.0]), saturated_current)))
PHASES = np.array([[1.0, 0.0], [-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]])


def dead_time(v: Array, i: Array) -> Array:
    """An inverter that keeps 0.8 V from each phase, with a shape that is not the estimator's."""
    phases = i @ PHASES.T
    taken: Array = 0.8 * (phases / np.sqrt(phases**2 + 0.03**2)) @ (2 / 3 * PHASES)
    return v - taken


@cache
def clean() -> MemoryRecording:
    return make_recording(amplitudes_v=(40.0, 20.0))


@cache
def behind_dead_time() -> MemoryRecording:
    return make_recording(acts=dead_time)


def resistance_of(recording: MemoryRecording) -> ResistanceEstimate:
    return ResistanceEstimator().estimate(recording, EstimationContext())


@cache
def classical_of(inverter: bool) -> FluxMapEstimate:
    recording = behind_dead_time() if inverter else clean()
    return ClassicalEstimator().estimate(recording, EstimationContext((resistance_of(recording),)))


@cache
def injection_of(inverter: bool) -> FluxMapEstimate:
    return InjectionEstimator().estimate(behind_dead_time() if inverter else clean(), EstimationContext())


def flux_error_percent(flux_map: FluxMap) -> tuple[float, float]:
    """rms and worst error of the flux in per cent of the rated flux."""
    truth = flux_for(np.stack(np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij"), axis=-1), saturated_current)
    off = np.hypot(flux_map.psi_d - 0.3 - truth[..., 0], flux_map.psi_q - truth[..., 1]) / RATED_WB * 100.0
    return float(np.sqrt(np.nanmean(off**2))), float(np.nanmax(off))


def test_injection_map_is_right_to_a_few_thousandths() -> None:
    rms, worst = flux_error_percent(injection_of(False).map)
    assert rms < 0.2
    assert worst < 0.5


def test_classical_map_is_right_to_a_few_thousandths() -> None:
    rms, worst = flux_error_percent(classical_of(False).map)
    assert rms < 0.2
    assert worst < 0.5


def test_dead_time_hurts_neither_map() -> None:
    by_injection, by_integration = (flux_error_percent(f(True).map)[0] for f in (injection_of, classical_of))
    assert by_injection < 0.3
    assert by_integration < 0.5


def test_what_integration_would_be_without_the_inverter_is_said() -> None:
    (told,) = (remark for remark in classical_of(True).remarks if remark.code == "inverter_loss")
    assert told.values["apart_percent"] == pytest.approx(45.0, rel=0.1)
    assert "inverter_loss" not in {remark.code for remark in classical_of(False).remarks}


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


@cache
def behind_a_strong_dead_time() -> MemoryRecording:
    """Eight volts a phase: where a phase current changes its sign, the regression on the ripple misses them."""
    recording = make_recording(acts=lambda v, i: v - 10.0 * (v - dead_time(v, i)))
    return recording.only(SegmentStage.INJECTION)


def test_intervals_hold_where_dead_time_spoils_some_of_the_points() -> None:
    found = InjectionEstimator().estimate(behind_a_strong_dead_time(), EstimationContext())
    assert isinstance(found, InjectedFlux)
    flux_map = found.map
    truth = flux_for(np.stack(np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij"), axis=-1), saturated_current)
    noise_alone = np.sqrt(found.inductances.covariance[:, 0, 0])
    off = np.abs(found.inductances.matrix - np.linalg.inv(saturated_hessian(truth_at(found)))).max(axis=(1, 2))
    assert (off > 4.0 * noise_alone).any()
    for error, std in (
        (flux_map.psi_d - 0.3 - truth[..., 0], flux_map.psi_d_std),
        (flux_map.psi_q - truth[..., 1], flux_map.psi_q_std),
    ):
        known = np.isfinite(error) & (std > 1e-7)
        assert (np.abs(error) < 1.96 * std)[known].mean() > 0.9


def truth_at(found: FluxMapEstimate) -> Array:
    """True flux at the points that were reached."""
    return flux_for(found.points.i_dq.astype(np.float64), saturated_current)


def test_the_smaller_ripple_makes_the_map_and_the_other_is_compared() -> None:
    told = {remark.code: remark for remark in injection_of(False).remarks}
    assert told["several_injections"].values == {"injection": "20 V rms at 500 Hz", "points": 25}
    assert str(told["other_injection"].values["by"]).startswith("40 V rms")


def test_frequencies_are_kept_apart_as_well() -> None:
    at_500, at_300 = (
        clean().only(SegmentStage.INJECTION),
        make_recording(frequency_hz=300.0).only(SegmentStage.INJECTION),
    )
    names = {s.id: f"{s.id}-300" for s in at_300.manifest.segments}
    captures = at_500.captures | {names[s.id]: at_300.load(s) for s in at_300.manifest.segments}
    renamed = tuple(s.model_copy(update={"id": names[s.id]}) for s in at_300.manifest.segments)
    both = MemoryRecording(at_500.manifest, captures).with_segments((*at_500.manifest.segments, *renamed))
    told = InjectionEstimator().estimate(both, EstimationContext()).remarks
    assert [one.values["injection"] for one in told if one.code == "several_injections"] == ["20 V rms at 500 Hz"]
    others = {str(one.values["by"]): one.values for one in told if one.code == "other_injection"}
    assert {"40 V rms at 300 Hz", "40 V rms at 500 Hz"} <= others.keys()
    # A motor without iron losses: whatever it is injected with, it is one motor.
    assert all(abs(float(one[k] or 0.0)) <= 0.25 for one in others.values() for k in ("d_percent", "q_percent"))


def test_a_drives_delay_is_taken_from_the_manifest() -> None:
    recording = clean()
    late = {
        s.id: (c := recording.load(s)).model_copy(update={"v_ab": np.concatenate([c.v_ab[2:], c.v_ab[-2:]])})
        for s in recording.manifest.segments
    }
    drive = recording.manifest.drive.model_copy(update={"voltage_delay_samples": 2.0})
    told = MemoryRecording(recording.manifest.model_copy(update={"drive": drive}), late)
    again = InjectionEstimator().estimate(told, EstimationContext()).map
    np.testing.assert_allclose(again.psi_q, injection_of(False).map.psi_q, atol=5e-4)
    untold = InjectionEstimator().estimate(MemoryRecording(recording.manifest, late), EstimationContext()).map
    assert np.nanmax(np.abs(untold.psi_q - again.psi_q)) > 5e-3


def test_the_transient_after_the_start_is_seen_in_the_data_not_on_the_nameplate() -> None:
    recording = clean()
    plate = recording.manifest.motor.model_copy(
        update={"stator_resistance_ohm": 40.0, "d_inductance_h": 0.01, "q_inductance_h": 0.02}
    )
    other = MemoryRecording(recording.manifest.model_copy(update={"motor": plate}), recording.captures)
    again = InjectionEstimator().estimate(other, EstimationContext()).map
    np.testing.assert_array_equal(again.psi_q, injection_of(False).map.psi_q)


def test_nameplate_resistance_does_not_enter_the_injection_map() -> None:
    recording = clean()
    plate = recording.manifest.motor.model_copy(
        update={"stator_resistance_ohm": 9.0, "d_inductance_h": 0.09, "q_inductance_h": 0.15}
    )
    other = MemoryRecording(recording.manifest.model_copy(update={"motor": plate}), recording.captures)
    again = InjectionEstimator().estimate(other, EstimationContext()).map
    np.testing.assert_allclose(again.psi_q, injection_of(False).map.psi_q, atol=5e-4)


@pytest.mark.parametrize("inverter", [False, True], ids=["clean", "dead time"])
def test_resistance_and_its_interval_hold_the_truth(inverter: bool) -> None:
    found = resistance_of(behind_dead_time() if inverter else clean())
    assert found.value_ohm == pytest.approx(R_S, rel=2e-3)
    assert found.high - found.low < 0.05 * R_S
    assert found.low - 2e-3 < R_S < found.high + 2e-3
    assert len(found.readings) > 40
    assert found.last_ohm == pytest.approx(R_S, rel=5e-3)


def test_resistance_drift_is_read_off_the_sweeps() -> None:
    recording = clean().only(SegmentStage.RESISTANCE, SegmentStage.CLASSICAL)
    end = recording.manifest.segments[-1].start_s
    warmed = {
        s.id: (c := recording.load(s)).model_copy(update={"v_ab": c.v_ab + 0.1 * R_S * s.start_s / end * c.i_ab})
        for s in recording.manifest.segments
    }
    found = resistance_of(MemoryRecording(recording.manifest, warmed))
    assert found.first_ohm == pytest.approx(R_S, rel=0.01)
    assert found.last_ohm == pytest.approx(1.1 * R_S, rel=0.01)
    told = next(remark for remark in found.remarks if remark.code == "drift")
    assert told.values["rise_k"] == pytest.approx(25.0, abs=1.0)
    starts = [reading.start_s for reading in found.readings]
    assert starts == sorted(starts)


def test_the_value_is_the_mean_over_the_instants_that_it_is_told_from() -> None:
    recording = clean()
    end = recording.manifest.segments[-1].start_s

    def ohm(time_s: Array) -> Array:
        return np.asarray(R_S * (1.0 + 0.2 * np.sqrt(time_s / end)))

    warmed = {}
    for segment in recording.manifest.segments:
        capture = recording.load(segment)
        time_s = capture.start_s + np.arange(len(capture)) / capture.sampling_frequency_hz
        extra = (ohm(time_s) - R_S)[:, None] * capture.i_ab
        warmed[segment.id] = capture.model_copy(update={"v_ab": capture.v_ab + extra})
    drifting = MemoryRecording(recording.manifest, warmed)
    found = resistance_of(drifting)
    truth = np.mean([ohm(np.array(d.start_s + 0.5 * d.seconds)) for d in constant_currents(drifting)])
    assert found.low < truth < found.high
    assert found.high - found.low < 0.02 * R_S


@pytest.mark.parametrize("known", [False, True], ids=["no inverter", "dead time"])
def test_injections_points_are_readings_too(known: bool) -> None:
    recording = behind_dead_time() if known else clean()
    start_s = min(segment.start_s for segment in recording.segments(SegmentStage.INJECTION))
    late = [reading for reading in resistance_of(recording).readings if reading.start_s > start_s]
    assert len(late) > 10
    assert all(abs(one.value_ohm - R_S) < max(4.0 * one.std_ohm, 5e-3 * R_S) for one in late)


def test_sweeps_alone_tell_a_resistance_too() -> None:
    found = resistance_of(clean().only(SegmentStage.CLASSICAL))
    assert found.value_ohm == pytest.approx(R_S, rel=5e-3)
    assert "no_holds" in {remark.code for remark in found.remarks}


@pytest.mark.parametrize("estimator", [ResistanceEstimator(), ClassicalEstimator(), InjectionEstimator()])
def test_what_was_not_measured_is_said(
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
    report = estimate_recording(clean(), estimators, tmp_path)
    assert report.usable
    assert report.method == "injection"
    assert report.classical_against_injection_percent is not None
    assert report.classical_against_injection_percent < 0.5
    assert flux_error_percent(load_flux_map(tmp_path / "results" / "flux_map.nc"))[1] < 0.5
    assert flux_error_percent(load_flux_map(tmp_path / "results" / "flux_map_classical.nc"))[1] < 0.5
