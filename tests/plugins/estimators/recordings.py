"""A motor whose flux is known at every current, measured with and without dead time; what the estimators make of it."""

from __future__ import annotations

from functools import cache

import numpy as np

from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.injection import InjectionEstimator
from plugins.estimators.resistance import ResistanceEstimator
from protocols import (
    EstimationContext,
    FluxMap,
    FluxMapEstimate,
    ResistanceEstimate,
    SegmentStage,
)
from tests.orchestrator.analysis.campaign import MOTOR, MemoryRecording, make_recording
from tests.orchestrator.analysis.plant import Array, flux_for, saturated_current

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


@cache
def behind_a_strong_dead_time() -> MemoryRecording:
    """Eight volts a phase: where a phase current changes its sign, the regression on the ripple misses them."""
    recording = make_recording(acts=lambda v, i: v - 10.0 * (v - dead_time(v, i)))
    return recording.only(SegmentStage.INJECTION)
