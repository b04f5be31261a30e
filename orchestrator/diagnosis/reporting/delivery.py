"""What a fit delivers to who asks for the motor: its map and R_s with errors, and what speaks against their use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis.fitting.corrections import has_random_directions
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.contributions import left_of_excitation
from orchestrator.diagnosis.judgement.intervals import INTERVAL_SIGMAS
from orchestrator.diagnosis.judgement.map_band import MapUncertainty
from orchestrator.diagnosis.judgement.verdict import most_strained
from orchestrator.diagnosis.reporting.findings import size_remarks
from orchestrator.diagnosis.reporting.motor_model import flux_map_of, map_nodes
from protocols import Basis, FluxMap, MotorModel, Remark, ResistanceEstimate, SegmentStage, Verdict

_WIDE = (SegmentStage.CLASSICAL, SegmentStage.STEPS)
"""Stages whose currents go round wide loops of what remembers."""
METHOD = "model"
"""Under which the map of the whole model is kept beside the estimators'."""


@dataclass(frozen=True)
class Delivery:
    """A fit's results, effects taken out.

    Attributes
    ----------
    map : FluxMap
    resistance : ResistanceEstimate
    objections : tuple of Remark
        What makes the map no better than those of the estimators: it is not recommended then.
    title : str
        The model in one line.
    """

    map: FluxMap
    resistance: ResistanceEstimate
    objections: tuple[Remark, ...]
    title: str = ""


def delivery_of(
    uncertainty: MapUncertainty,
    judged: Fit,
    kept: MotorModel,
    verdict: Verdict | None,
    band_percent: float,
    moved: Mapping[str, float] | None = None,
) -> Delivery:
    """The map and R_s of a fit, and the objections to them.

    Parameters
    ----------
    uncertainty : MapUncertainty
        The fit's.
    judged : Fit
        The same without the model's own error as noise.
    kept : MotorModel
        The same fit's.
    verdict : str or None
        Of the diagnosis; None: the model is a user's own, and what is left decides.
    band_percent : float
        Half width of the map's 95 % band, of the rated flux.
    moved : mapping, optional
        By what part of the rated flux each effect moves the map.
    """
    objections = objections_to(judged, verdict, band_percent, moved or {})
    return Delivery(_map(uncertainty, kept), _resistance(uncertainty), tuple(objections), kept.title)


def _map(uncertainty: MapUncertainty, kept: MotorModel) -> FluxMap:
    found = flux_map_of(kept)
    nodes, shape = map_nodes(uncertainty.fit.model.space.grid)
    fields: dict[str, object] = {"method": METHOD, "basis": Basis.ENERGY}
    for name, spread in zip(("psi_d", "psi_q", "l_dd", "l_dq", "l_qq"), uncertainty.of_map(nodes).T, strict=True):
        fields[f"{name}_std"] = np.where(np.isfinite(getattr(found, name)), spread.reshape(shape), np.nan)
    return found.model_copy(update=fields)


def _resistance(uncertainty: MapUncertainty) -> ResistanceEstimate:
    """R_s as the effects leave it: as warm as at the start, and what it was at both ends of the experiment."""
    fit = uncertainty.fit
    value, half = fit.model.r_s, INTERVAL_SIGMAS * uncertainty.resistance_ohm
    ends = [
        float(np.mean(fit.corrected(k).resistance_ohm))
        for k, piece in enumerate(fit.prepared.pieces)
        if piece.stage is not SegmentStage.GATES_OFF
    ]
    text = "R_s is that of the whole model at 0 s, before any current warms the winding"
    remark = Remark.of("of_the_model", text)
    return ResistanceEstimate(
        value_ohm=value,
        low=value - half,
        high=value + half,
        first_ohm=ends[0],
        last_ohm=ends[-1],
        remarks=(remark.by(METHOD),),
    )


def objections_to(fit: Fit, verdict: Verdict | None, band_percent: float, moved: Mapping[str, float]) -> list[Remark]:
    """What speaks against the use of a fit's map; parameters as of `delivery_of`."""
    limits, against = fit.criteria, []
    if verdict == "cannot_tell":
        text = "the recording does not tell whether the model is right: see the diagnosis"
        against.append(Remark.of("cannot_tell", text))
    left = left_of_excitation(fit)
    if verdict not in ("clean", "explained") and left > limits.materiality.material_voltage:
        text = "the model leaves {left_percent:.2g} % of the voltage unexplained: see the diagnosis"
        against.append(Remark.of("unexplained", text, left_percent=100.0 * left))
    most = max(moved, key=lambda name: moved[name], default=None)
    if verdict == "unknown_remains" and most is not None and 100.0 * moved[most] > limits.verdict.widest_band_percent:
        text = "{effect} moves the model's map by {moved_percent:.2g} %, and may stand in for what is unknown"
        against.append(Remark.of("may_stand_in", text, effect=most, moved_percent=100.0 * moved[most]))
    if verdict not in ("clean", "explained") and (name := most_strained(fit)):
        text = "{effect} has a form as no such effect has, and may stand in for what is unknown"
        against.append(Remark.of("strained_form", text, effect=name))
    against += [_of_small_loops(name) for name in remembering_by_ripple_alone(fit, moved)]
    against += size_remarks(fit)
    if band_percent > limits.verdict.widest_band_percent:
        text = "the model's map is uncertain by {band_percent:.2g} % of the rated flux"
        against.append(Remark.of("uncertain_map", text, band_percent=band_percent))
    return [one.by(METHOD) for one in against]


def remembering_by_ripple_alone(fit: Fit, moved: Mapping[str, float]) -> list[str]:
    """Effects that remember where a segment came from, move the map, and were seen by a ripple alone."""
    if any(piece.stage in _WIDE for piece in fit.prepared.pieces):
        return []
    least = fit.criteria.materiality.material_flux
    return [a.name for a in fit.model.active if has_random_directions(a) and moved.get(a.name, 0.0) > least]


def _of_small_loops(name: str) -> Remark:
    text = (
        "{effect} was seen by a ripple alone, which goes round small loops: of wide ones, and so of the flux, it says "
        "little; sweep the current"
    )
    return Remark.of("small_loops", text, effect=name)
