"""A rotor that turns: flux by its back-EMF, of a plant whose flux is known, from waveforms in the stator's frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from plugins.estimators.spin import SpinEstimator
from protocols import (
    Capture,
    DriveRecord,
    EstimationContext,
    FluxMapEstimate,
    Manifest,
    Motor,
    NotMeasuredError,
    RealArray,
    Segment,
    SegmentStage,
)
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.orchestrator.analysis.plant import R_S, Array, flux_for, saturated_current

STEP_S, MAGNET_WB = 1e-4, 0.3
GRID = [(float(d), float(q)) for d in np.linspace(-3.0, 1.0, 7) for q in np.linspace(-3.0, 3.0, 9)]
RATED_WB = float(np.linalg.norm(flux_for(np.array([0.0, 1.66 * 2**0.5]), saturated_current)))


def at(angle: RealArray, x: RealArray) -> Array:
    return np.stack([np.cos(angle) * x[0] - np.sin(angle) * x[1], np.sin(angle) * x[0] + np.cos(angle) * x[1]], axis=1)


def spun(
    currents: Sequence[tuple[float, float]],
    speeds: Sequence[float] = (200.0,),
    offset: float = 0.0,
    noise: float = 0.05,
    warmer: float = 0.0,
) -> MemoryRecording:
    """Voltages are what the flux changes by over each sample and the resistive drop; `offset` is the true d axis'.

    The resistance rises by the part `warmer` of itself until the end.
    """
    random, captures = np.random.default_rng(3), {}
    segments: list[Segment] = []
    for speed in speeds:
        for current in currents:
            count = round(2.2 * 4.0 * np.pi / abs(speed) / STEP_S)
            angle = 0.4 + speed * STEP_S * np.arange(count + 1)
            psi = flux_for(np.array(current), saturated_current) + np.array([MAGNET_WB, 0.0])
            middle = at(0.5 * (angle[1:] + angle[:-1]), np.array(current))
            ohm = R_S * (1.0 + warmer * len(segments) / (len(speeds) * len(currents)))
            v = np.diff(at(angle, psi), axis=0) / STEP_S + ohm * middle
            name = f"spin-{len(segments):03d}"
            captures[name] = Capture(
                start_s=0.3 * len(segments),
                sampling_frequency_hz=1.0 / STEP_S,
                i_ab=at(angle[:-1], np.array(current)) + 2e-3 * random.normal(size=v.shape) * (noise > 0),
                v_ab=v + noise * random.normal(size=v.shape),
                v_dc=np.full(count, 540.0),
                theta_rad=np.mod(angle[:-1] - offset, 2.0 * np.pi),
            )
            segments.append(Segment(id=name, stage=SegmentStage.SPIN, start_s=0.3 * len(segments), samples=count))
    manifest = Manifest(
        format="fluxbench-recording",
        version=1,
        name="spun",
        created="2026-01-01T00:00:00Z",
        motor=Motor(
            name="test",
            pole_pairs=2,
            rated_current_rms_a=1.66,
            pm_flux_wb=MAGNET_WB,
            stator_resistance_ohm=1.01 * R_S,
            stator_resistance_std_ohm=0.01 * R_S,
        ),
        drive=DriveRecord(name="test", sampling_frequency_hz=1.0 / STEP_S, dc_bus_voltage_v=540.0),
        segments=tuple(segments),
    )
    return MemoryRecording(manifest, captures)


def found(recording: MemoryRecording) -> FluxMapEstimate:
    return SpinEstimator().estimate(recording, EstimationContext())


def remark_value(estimate: FluxMapEstimate, code: str, name: str) -> float:
    value = next(remark for remark in estimate.remarks if remark.code == code).values[name]
    assert isinstance(value, float)
    return value


def test_the_map_and_the_magnet_are_right_with_a_resistance_that_is_off_by_a_percent() -> None:
    estimate = found(spun(GRID))
    there = np.isfinite(estimate.map.psi_d)
    axes = np.meshgrid(estimate.map.i_d, estimate.map.i_q, indexing="ij")
    grid = np.stack(axes, axis=-1).astype(np.float64)
    off = np.stack([estimate.map.psi_d - MAGNET_WB, estimate.map.psi_q], axis=-1) - flux_for(grid, saturated_current)
    assert 100.0 / RATED_WB * float(np.sqrt((off[there] ** 2).sum(axis=1).mean())) < 0.1
    assert remark_value(estimate, "magnet_flux", "flux_wb") == pytest.approx(MAGNET_WB, rel=2e-3)
    assert [remark.code for remark in estimate.remarks] == ["magnet_flux", "resistance_by_emf"]


@pytest.mark.slow
def test_a_winding_that_warms_is_no_loss_of_the_inverter() -> None:
    estimate = found(spun(GRID, speeds=(150.0, -250.0), noise=0.005, warmer=0.03))
    assert [remark.code for remark in estimate.remarks] == ["magnet_flux", "resistance_by_emf"]
    assert remark_value(estimate, "resistance_by_emf", "value_ohm") == pytest.approx(1.015 * R_S, rel=2e-3)


@pytest.mark.slow
def test_an_offset_of_the_angle_is_reported_in_either_direction_of_turning() -> None:
    estimate = found(spun(GRID, speeds=(150.0, -250.0), offset=0.04))
    assert remark_value(estimate, "angle_offset", "angle_deg") == pytest.approx(np.degrees(0.04), abs=0.05)


def off_bridge(offset: float = 0.0) -> MemoryRecording:
    """Terminals measured at the samples' instants, no current."""
    recording = spun([(0.0, 0.0)], offset=offset, noise=0.0)
    theta = recording.captures["spin-000"].theta_rad
    assert theta is not None
    emf = at(theta + offset, np.array([0.0, 200.0 * MAGNET_WB]))
    captures = {"spin-000": recording.captures["spin-000"].model_copy(update={"v_ab": emf})}
    return MemoryRecording(recording.manifest, captures)


@pytest.mark.parametrize("offset", [0.0, 0.5, np.pi], ids=["aligned", "offset", "polarity"])
def test_without_current_the_emf_says_the_magnets_flux_and_where_it_points(offset: float) -> None:
    estimate = found(off_bridge(offset))
    assert remark_value(estimate, "magnet_flux", "flux_wb") == pytest.approx(MAGNET_WB, rel=1e-3)
    assert float(estimate.map.psi_d[0, 0]) == pytest.approx(MAGNET_WB, rel=1e-3)
    if offset:
        assert abs(remark_value(estimate, "angle_offset", "angle_deg")) == pytest.approx(np.degrees(offset), abs=0.1)


@pytest.mark.parametrize(
    ("factor", "problem"), [(-1.0, "is the phase order wrong"), (2.0, "0.5 times"), (0.5, "2 times as fast")]
)
def test_an_angle_that_is_not_the_rotors_is_refused_by_what_it_looks_like(factor: float, problem: str) -> None:
    recording = spun(GRID[:1])
    capture = recording.captures["spin-000"]
    assert capture.theta_rad is not None
    wrong = capture.model_copy(update={"theta_rad": np.mod(factor * np.unwrap(capture.theta_rad), 2.0 * np.pi)})
    with pytest.raises(NotMeasuredError, match=problem):
        found(MemoryRecording(recording.manifest, {"spin-000": wrong}))


def test_without_an_angle_nothing_is_taken_for_one() -> None:
    recording = spun(GRID[:1])
    blind = recording.captures["spin-000"].model_copy(update={"theta_rad": None})
    with pytest.raises(NotMeasuredError, match="speed_rad_s"):
        found(MemoryRecording(recording.manifest, {"spin-000": blind}))


@pytest.mark.slow
def test_a_constant_speed_in_the_settings_stands_for_the_angle() -> None:
    recording = spun(GRID)
    captures = {name: c.model_copy(update={"theta_rad": None}) for name, c in recording.captures.items()}
    segments = tuple(
        s.model_copy(update={"rotor_angle_rad": 0.4, "settings": {"speed_rad_s": 200.0}})
        for s in recording.manifest.segments
    )
    estimate = found(MemoryRecording(recording.manifest, captures).with_segments(segments))
    assert remark_value(estimate, "magnet_flux", "flux_wb") == pytest.approx(MAGNET_WB, rel=2e-3)


@pytest.mark.slow
def test_a_point_without_current_says_nothing_of_what_the_inverter_keeps() -> None:
    """A phase's loss turns with the current; a current that is noise has no direction to lose along."""
    lost_v, recording = 0.8, spun([*GRID[::3], *[(0.0, 0.0)] * 4], speeds=(200.0, -100.0))
    captures = {}
    for name, capture in recording.captures.items():
        i = capture.i_ab @ np.array([1.0, 1j])
        mean = i * np.exp(-1j * np.asarray(capture.theta_rad))
        along = np.exp(1j * (np.angle(mean.mean()) + np.asarray(capture.theta_rad)))
        flows = abs(mean.mean()) > 0.1
        kept = 4.0 / np.pi * lost_v * along * flows
        captures[name] = capture.model_copy(update={"v_ab": capture.v_ab + np.stack([kept.real, kept.imag], axis=1)})
    estimate = found(MemoryRecording(recording.manifest, captures))
    assert remark_value(estimate, "inverter_loss", "kept_v") == pytest.approx(lost_v, rel=0.05)
    assert remark_value(estimate, "resistance_by_emf", "value_ohm") == pytest.approx(R_S, rel=0.01)
