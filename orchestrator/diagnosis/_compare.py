"""Comparison of a model with a recording: its error per stage and segment, without a search for causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from operator import is_
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from orchestrator.diagnosis._prepare import open_for_refit
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.fitting.simulation import current_rms
from orchestrator.diagnosis.judgement.residual_pattern import map_asymmetry
from orchestrator.diagnosis.judgement.sufficiency import solvable
from orchestrator.diagnosis.reporting.benefit import added_remark
from orchestrator.diagnosis.reporting.findings import found_effects
from orchestrator.diagnosis.reporting.ladder import held_out, mean_rms_v, noise_rms_v
from orchestrator.diagnosis.reporting.motor_model import require_effects_of, restored
from orchestrator.diagnosis.reporting.own_effects import contract_remarks
from orchestrator.diagnosis.reporting.pictures import diagnosis_step
from orchestrator.diagnosis.reporting.resemblance import Alternative, alternative_remarks, alternatives_to
from orchestrator.diagnosis.selection.contrasts import resembling
from orchestrator.diagnosis.selection.first_models import ModelChoice, baseline_of, first_steps
from orchestrator.diagnosis.selection.search import with_effect
from orchestrator.diagnosis.selection.search_state import AcceptedModel
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.frames import to_dq
from orchestrator.recording import MODEL_NAME, Recording, has_model, read_model
from protocols import (
    AxisPercent,
    CompareReport,
    DiagnosisStep,
    Effect,
    MotorModel,
    NoiseFloor,
    Remark,
    SegmentStage,
    StageError,
    WorstSegment,
)

MAX_LISTED_SEGMENTS: int = 8
"""Maximum number of segments that a comparison lists."""
CHANCE_OF_NOISE: float = 1e-3
"""Probability with which the chi2 of noise alone exceeds what is stated as its limit."""


@solvable
def compare_recording(
    recording: Recording,
    effects: Sequence[Effect] = (),
    *,
    model: ModelChoice | None = None,
    out: Path | None = None,
    candidates: Sequence[str] = (),
) -> CompareReport:
    """Compare a model with a recording.

    Parameters
    ----------
    effects : sequence of Effect
        The library, for the effects that the model has.
    model : {"saturated", "linear"}, FluxMap or MotorModel, optional
        A baseline, whose R_s and free map are fitted, or a whole model, which is not fitted; by default the model of
        `model.json`, where there is one, else ``saturated``.
    out : Path, optional
        Directory of `model.json`; the recording's by default.
    candidates : sequence of str
        Effects of the library that are tested one at a time; a remark reports whether each helps. No file is changed.

    Raises
    ------
    RecordingError, NotMeasuredError
        As `diagnose_recording`.
    """
    if model is None and has_model(out or recording.path):
        model = read_model(out or recording.path)
    setup = open_for_refit(recording, model)
    remarks = list(setup.remarks)
    if model is None and out is not None:
        remarks.append(
            Remark.of("no_model", "no {file} in {folder}: the bare map is compared", file=MODEL_NAME, folder=str(out))
        )
    library = {c.name: c for c in scaled_library(effects, setup.prepared.manifest)}
    if isinstance(model, MotorModel):
        title, fit = model.title, _held(setup, model, library)
        if model.recording != recording.manifest.name:
            text = "the model was fitted to {fitted_to}, and is held against this recording as it is"
            remarks.append(Remark.of("model_of_another", text, fitted_to=model.recording))
    else:
        title = baseline_of(model or "saturated").title
        fit = first_steps(setup, model or "saturated", library)[-1].fit
    alternatives: list[Alternative] = []
    remarks += contract_remarks(fit, [library[name] for name in candidates])
    for name in candidates:
        if name in fit.model.names:
            remarks.append(Remark.of("in_model", "{effect}: in the model already", effect=name))
            continue
        after = with_effect(setup, fit, library[name])
        remarks.append(_benefit(setup, fit, after, name))
        seen = {(one.other, one.name) for one in alternatives}
        found = alternatives_to(setup, after, name, tuple(library.values()))
        alternatives += [one for one in found if (one.name, one.other) not in seen]
    remarks += alternative_remarks(alternatives)
    pieces = [p for p in setup.prepared.pieces if p.stage is not SegmentStage.GATES_OFF]
    rated = _rated_flux(setup, fit)
    parity, reciprocity = map_asymmetry(setup.fitter, fit, setup.current_a)
    return CompareReport(
        recording=recording.manifest.name,
        model=title,
        noise_floor=NoiseFloor(rms_v=noise_rms_v(fit)),
        rms_v=mean_rms_v(fit, lambda _: True),
        heldout_rms_v=mean_rms_v(fit, held_out),
        chi2=fit.chi2_per_dof,
        stages=tuple(_stage_error(fit, *row) for row in _stage_rows(setup.prepared.pieces)),
        worst=_worst(fit, pieces),
        parity=AxisPercent(d_percent=100.0 * parity[0] / rated, q_percent=100.0 * parity[1] / rated),
        reciprocity_percent=100.0 * reciprocity,
        crossings=_crossings(fit, rated),
        remarks=tuple(remarks),
    )


@solvable
def bare_model_step(recording: Recording) -> DiagnosisStep:
    """Data for figures of where the bare saturated model fails: the ladder's first step, without a search.

    Raises
    ------
    RecordingError, NotMeasuredError
        As `diagnose_recording`.
    """
    setup = open_for_refit(recording, None)
    return diagnosis_step(0, AcceptedModel(None, first_steps(setup, "saturated", {})[-1].fit))


@solvable
def model_step(recording: Recording, model: MotorModel, effects: Sequence[Effect]) -> DiagnosisStep:
    """Data for figures of where a whole model fails; it is not fitted.

    Parameters
    ----------
    effects : sequence of Effect
        The library, for the effects that the model has.

    Raises
    ------
    RecordingError, NotMeasuredError
        As `diagnose_recording`.
    PluginError
        If an effect of the model is not in the library, or has other parameters.
    """
    require_effects_of(model, {effect.name for effect in effects})
    setup = open_for_refit(recording, model)
    fit = _held(setup, model, {c.name: c for c in scaled_library(effects, setup.prepared.manifest)})
    added = model.ladder[-1].added if model.ladder else None
    return diagnosis_step(max(len(model.ladder) - 1, 0), AcceptedModel(added, fit))


def _held(setup: DiagnosisSetup, model: MotorModel, library: Mapping[str, CandidateEffect]) -> Fit:
    """A whole model evaluated on a recording, without a fit."""
    return setup.fitter.hold(restored(setup, model, model.baseline, library))


def _benefit(setup: DiagnosisSetup, fit: Fit, after: Fit, name: str) -> Remark:
    """Remark on whether one more effect helps."""
    found = next(e for e in found_effects(setup.fitter, after, {}, {}) if e.name == name)
    return added_remark(name, fit, after, found, resembling(setup.fitter, after, name, ()))


def _stage_and_pwm(piece: SegmentData) -> tuple[SegmentStage, float]:
    """What makes a row of the comparison: some errors of an inverter grow with its PWM frequency."""
    return piece.stage, piece.signals.pwm_frequency_hz


def _stage_rows(pieces: Sequence[SegmentData]) -> list[tuple[SegmentStage, float]]:
    """The stages in their order, each with its PWM frequencies."""
    stages = list(dict.fromkeys(piece.stage for piece in pieces))
    return sorted(dict.fromkeys(map(_stage_and_pwm, pieces)), key=lambda row: stages.index(row[0]))


def _stage_error(fit: Fit, stage: SegmentStage, pwm_hz: float) -> StageError:
    def of_row(piece: SegmentData) -> bool:
        return _stage_and_pwm(piece) == (stage, pwm_hz)

    count = sum(e.size for p, e in zip(fit.prepared.pieces, fit.residual, strict=True) if of_row(p))
    return StageError(
        stage=stage.value,
        pwm_frequency_hz=pwm_hz,
        rms_v=mean_rms_v(fit, of_row),
        noise_rms_v=noise_rms_v(fit, of_row),
        chi2=fit.chi2_of(of_row),
        chi2_of_noise=float(chi2.isf(CHANCE_OF_NOISE, count)) / count if count else None,
        current_rms_a=current_rms(fit, of_row),
    )


def _worst(fit: Fit, pieces: Sequence[SegmentData]) -> tuple[WorstSegment, ...]:
    rows = []
    for piece in pieces:
        i_d, i_q = to_dq(piece.signals.i_ab, piece.segment.rotor_angle_rad).mean(axis=0)
        rms, noise = (of(fit, partial(is_, piece)) for of in (mean_rms_v, noise_rms_v))
        currents = {"i_d_a": float(i_d), "i_q_a": float(i_q)}
        pwm_hz = piece.signals.pwm_frequency_hz
        segment = WorstSegment(
            segment=piece.segment.id, pwm_frequency_hz=pwm_hz, **currents, rms_v=rms, noise_rms_v=noise
        )
        rows.append(segment)
    return tuple(sorted(rows, key=lambda r: -(r.rms_v or 0.0))[:MAX_LISTED_SEGMENTS])


def _rated_flux(setup: DiagnosisSetup, fit: Fit) -> float:
    at = np.array([[0.0, setup.current_a], [0.0, 0.0]])
    psi, _ = fit.model.magnetics.flux_and_inductance(at)
    return max(float(np.linalg.norm(psi[0] - psi[1])), 1e-12)


def _crossings(fit: Fit, rated_wb: float) -> AxisPercent:
    """Largest drift of the integrated flux from the map's along a trapezoid, per cent of the rated flux."""
    # Where paths cross, two integrated fluxes differ by at most twice this. A constant voltage error, which makes the
    # integral drift, is removed from each path.
    largest = np.zeros(2)
    seen = False
    for piece, volts in zip(fit.prepared.pieces, fit.volts, strict=True):
        if piece.stage is not SegmentStage.CLASSICAL:
            continue
        seen = True
        rows = volts.reshape(-1, 2)
        flux = np.cumsum(rows - rows.mean(axis=0), axis=0) * piece.windows.step / piece.signals.sampling_frequency_hz
        largest = np.maximum(largest, np.ptp(flux, axis=0))
    if not seen:
        return AxisPercent(d_percent=None, q_percent=None)
    percent = 100.0 * largest / rated_wb
    return AxisPercent(d_percent=float(percent[0]), q_percent=float(percent[1]))
