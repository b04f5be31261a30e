"""Comparison of a model with a recording: where it fails, in numbers. Looks for no cause."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from operator import is_
from pathlib import Path

import numpy as np

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import Start
from orchestrator.diagnosis.fitting.candidates import MAGNETIC, scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.fitting.simulation import current_rms
from orchestrator.diagnosis.reporting.ladder import mean_rms_v, noise_rms_v
from orchestrator.diagnosis.reporting.model_file import MODEL_NAME, read_model
from orchestrator.diagnosis.selection.forward_search import with_effect
from orchestrator.diagnosis.selection.leftover import map_breaks
from orchestrator.diagnosis.selection.sufficiency import solvable
from orchestrator.diagnosis.selection.workflow import ModelChoice, first_steps, name_of
from orchestrator.diagnosis.weak_form.segments import Piece
from orchestrator.numerics.frames import to_dq
from orchestrator.recording import Recording
from protocols import AxisPercent, CompareReport, Effect, NoiseFloor, Remark, SegmentStage, StageError, WorstSegment


@solvable
def compare_recording(
    recording: Recording, effects: Sequence[Effect] = (), *, model: ModelChoice | None = None, out: Path | None = None
) -> CompareReport:
    """Hold a model against a recording.

    Parameters
    ----------
    effects : sequence of Effect
        The library, for the effects that `model.json` has.
    model : {"saturated", "linear"} or FluxMap, optional
        A bare baseline to compare; by default the model of `model.json` with its effects, where there is one,
        else ``saturated``.
    out : Path, optional
        Directory whose `model.json` is taken; the recording's own by default.

    Raises
    ------
    RecordingError, NotMeasuredError
        As `diagnose_recording`.
    """
    start = open_for_diagnosis(recording)
    kept = read_model(out or recording.path) if model is None else None
    names: list[str] = [e.name for e in kept.effects] if kept is not None else []
    remarks = list(start.remarks)
    if model is None and kept is None and out is not None:
        remarks.append(
            Remark.of("no_model", "no {file} in {folder}: the bare map is compared", file=MODEL_NAME, folder=str(out))
        )
    if model is None:
        model = kept.baseline if kept is not None and kept.baseline in ("linear", "saturated") else "saturated"
    library = {c.name: c for c in scaled_library(effects, start.prepared.manifest)}
    fit = first_steps(start, model, [n for n in names if n in MAGNETIC])[-1].fit
    for name in names:
        if name in library:
            fit = with_effect(start.fitter, fit, library[name])
        elif name not in MAGNETIC:
            remarks.append(
                Remark.of("not_installed", "{effect}: in model.json, but not among the installed effects", effect=name)
            )
    title = " + ".join([name_of(model), *names])
    pieces = [p for p in start.prepared.pieces if p.stage is not SegmentStage.GATES_OFF]
    rated = _rated_flux(start, fit)
    parity, reciprocity = map_breaks(start.fitter, fit, start.current_a)
    return CompareReport(
        recording=recording.manifest.name,
        model=title,
        noise_floor=NoiseFloor(rms_v=noise_rms_v(fit)),
        chi2=fit.chi2_per_dof,
        stages=tuple(_stage_error(fit, stage) for stage in dict.fromkeys(p.stage for p in start.prepared.pieces)),
        worst=_worst(fit, pieces),
        parity=AxisPercent(d_percent=100.0 * parity[0] / rated, q_percent=100.0 * parity[1] / rated),
        reciprocity_percent=100.0 * reciprocity,
        crossings=_crossings(fit, rated),
        remarks=tuple(remarks),
    )


def _stage_error(fit: Fit, stage: SegmentStage) -> StageError:
    def here(piece: Piece) -> bool:
        return piece.stage is stage

    return StageError(
        stage=stage.value, rms_v=mean_rms_v(fit, here), chi2=fit.chi2_of(here), current_rms_a=current_rms(fit, here)
    )


def _worst(fit: Fit, pieces: Sequence[Piece]) -> tuple[WorstSegment, ...]:
    rows = []
    for piece in pieces:
        i_d, i_q = to_dq(piece.signals.i_ab, piece.segment.rotor_angle_rad).mean(axis=0)
        rms = mean_rms_v(fit, partial(is_, piece))
        rows.append(WorstSegment(segment=piece.segment.id, i_d_a=float(i_d), i_q_a=float(i_q), rms_v=rms))
    return tuple(sorted(rows, key=lambda r: -(r.rms_v or 0.0))[: fit.criteria.pictures.worst_segments])


def _rated_flux(start: Start, fit: Fit) -> float:
    at = np.array([[0.0, start.current_a], [0.0, 0.0]])
    psi, _ = fit.model.magnetics.flux_and_inductance(at)
    return max(float(np.linalg.norm(psi[0] - psi[1])), 1e-12)


def _crossings(fit: Fit, rated_wb: float) -> AxisPercent:
    """Largest wandering of the flux integrated along a trapezoid from the map's, per cent of the rated flux.

    Where paths cross, two integrated fluxes differ by no more than twice this. A constant voltage error, which
    makes the integral drift, is taken out of each path as an integrator would.
    """
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
