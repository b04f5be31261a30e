"""The map by injection against the motor's own."""

from __future__ import annotations

import numpy as np
import pytest

from plugins.estimators._maps import InjectedFlux
from plugins.estimators.injection import InjectionEstimator
from protocols import (
    EstimationContext,
    FluxMapEstimate,
    SegmentStage,
)
from tests.orchestrator.analysis.campaign import MemoryRecording, make_recording
from tests.orchestrator.analysis.plant import Array, flux_for, saturated_current, saturated_hessian
from tests.plugins.estimators.recordings import (
    behind_a_strong_dead_time,
    clean,
    flux_error_percent,
    injection_of,
)
from tests.support.close import assert_close


def test_injection_map_is_right_to_a_few_thousandths() -> None:
    rms, worst = flux_error_percent(injection_of(False).map)
    assert rms < 0.2
    assert worst < 0.5


def truth_at(found: FluxMapEstimate) -> Array:
    """True flux at the points that were reached."""
    return flux_for(found.points.i_dq.astype(np.float64), saturated_current)


@pytest.mark.slow
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


def test_the_smaller_ripple_makes_the_map_and_the_other_is_compared() -> None:
    remarks = {remark.code: remark for remark in injection_of(False).remarks}
    assert remarks["several_injections"].values == {"injection": "20 V rms at 500 Hz", "points": 25}
    assert str(remarks["other_injection"].values["by"]).startswith("40 V rms")


def test_points_between_which_the_motor_saturates_are_stated_to_be_too_far_apart() -> None:
    found = injection_of(False)
    assert "too_far_apart" not in {far.code for far in found.remarks}
    strict = InjectionEstimator(max_inductance_ratio=1.05).estimate(clean(), EstimationContext())
    (far,) = [far for far in strict.remarks if far.code == "too_far_apart"]
    assert float(far.values["ratio"] or 0.0) > 1.05
    apart = [
        abs(float(far.values[f"to_{axis}_a"] or 0.0) - float(far.values[f"from_{axis}_a"] or 0.0)) for axis in "dq"
    ]
    assert max(apart) > 0.5  # two points of the grid, not one of them twice
    assert "measure points closer together there" in far.text


@pytest.mark.slow
def test_frequencies_are_kept_apart_as_well() -> None:
    at_500, at_300 = (
        clean().only(SegmentStage.INJECTION),
        make_recording(frequency_hz=300.0).only(SegmentStage.INJECTION),
    )
    names = {s.id: f"{s.id}-300" for s in at_300.manifest.segments}
    captures = at_500.captures | {names[s.id]: at_300.load(s) for s in at_300.manifest.segments}
    renamed = tuple(s.model_copy(update={"id": names[s.id]}) for s in at_300.manifest.segments)
    both = MemoryRecording(at_500.manifest, captures).with_segments((*at_500.manifest.segments, *renamed))
    found = InjectionEstimator().estimate(both, EstimationContext())
    assert [round(seen.frequency_hz) for seen in found.incremental] == [300, 500, 500]
    for seen in found.incremental:
        true = np.linalg.inv(saturated_hessian(flux_for(seen.i_dq.astype(np.float64), saturated_current)))
        assert_close(seen.inductance, np.stack([true[:, 0, 0], true[:, 0, 1], true[:, 1, 1]], axis=1), 5e-3)
    remarks = found.remarks
    assert [one.values["injection"] for one in remarks if one.code == "several_injections"] == ["20 V rms at 500 Hz"]
    others = {str(one.values["by"]): one.values for one in remarks if one.code == "other_injection"}
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
    delayed = MemoryRecording(recording.manifest.model_copy(update={"drive": drive}), late)
    again = InjectionEstimator().estimate(delayed, EstimationContext()).map
    np.testing.assert_allclose(again.psi_q, injection_of(False).map.psi_q, atol=5e-4)
    undeclared = InjectionEstimator().estimate(MemoryRecording(recording.manifest, late), EstimationContext()).map
    assert np.nanmax(np.abs(undeclared.psi_q - again.psi_q)) > 5e-3


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
