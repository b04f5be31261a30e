"""Map and R_s of a fit with their errors, and objections to their use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis.fitting.corrections import has_random_directions
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.contributions import left_by_kind
from orchestrator.diagnosis.judgement.intervals import INTERVAL_SIGMAS
from orchestrator.diagnosis.judgement.map_band import MapUncertainty
from orchestrator.diagnosis.judgement.verdict import held_out_chi2, most_strained
from orchestrator.diagnosis.reporting.findings import size_remarks
from orchestrator.diagnosis.reporting.motor_model import flux_map_of, map_nodes
from orchestrator.formatting.names import plain
from orchestrator.formatting.results import kind_words
from protocols import Basis, FluxMap, MotorModel, Remark, ResistanceEstimate, SegmentStage, Verdict

_WIDE = (SegmentStage.CLASSICAL, SegmentStage.STEPS)
"""Stages whose currents pass wide hysteresis loops."""
EXPLAINED: tuple[Verdict, ...] = ("clean", "explained", "explained_in_another_form")
"""Verdicts with which a model explains the recording."""
METHOD = "model"
"""Method name of the model's map among the estimators'."""


@dataclass(frozen=True)
class Delivery:
    """Map and R_s of a fit, corrected for its effects.

    Attributes
    ----------
    map : FluxMap
    resistance : ResistanceEstimate
    objections : tuple of Remark
        Reasons not to recommend the map over the estimators'.
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
    widening: tuple[str, float] | None = None,
) -> Delivery:
    """The map and R_s of a fit, and the objections to them.

    Parameters
    ----------
    uncertainty : MapUncertainty
        Uncertainty of the fit.
    judged : Fit
        The fit evaluated without model-error noise.
    kept : MotorModel
        The fit's saved model.
    verdict : str or None
        Verdict of the diagnosis; None for a user's model, which the residual decides on.
    band_percent : float
        Half width of the map's 95 % band, of the rated flux.
    moved : mapping, optional
        Change of the map by each effect, relative to the rated flux.
    widening : tuple, optional
        An effect whose size the recording does not determine, and the band without it.
    """
    objections = objections_to(judged, verdict, band_percent, moved or {}, widening)
    return Delivery(_map(uncertainty, kept), _resistance(uncertainty), tuple(objections), kept.title)


def _map(uncertainty: MapUncertainty, kept: MotorModel) -> FluxMap:
    found = flux_map_of(kept)
    nodes, shape = map_nodes(uncertainty.fit.model.space.grid)
    fields: dict[str, object] = {"method": METHOD, "basis": Basis.ENERGY}
    for name, spread in zip(("psi_d", "psi_q", "l_dd", "l_dq", "l_qq"), uncertainty.of_map(nodes).T, strict=True):
        fields[f"{name}_std"] = np.where(np.isfinite(getattr(found, name)), spread.reshape(shape), np.nan)
    return found.model_copy(update=fields)


def _resistance(uncertainty: MapUncertainty) -> ResistanceEstimate:
    """R_s at the initial temperature, and its values at both ends of the experiment."""
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


def objections_to(
    fit: Fit,
    verdict: Verdict | None,
    band_percent: float,
    moved: Mapping[str, float],
    widening: tuple[str, float] | None = None,
) -> list[Remark]:
    """Objections to the use of a fit's map; parameters as in `delivery_of`."""
    limits, against = fit.criteria, []
    if verdict == "cannot_tell":
        text = "the recording does not tell whether the model is right: `explain` has the reasons"
        against.append(Remark.of("cannot_tell", text))
    left = left_by_kind(fit)
    worst = max(left, key=lambda kind: left[kind], default=None)
    max_left = limits.materiality.material_voltage
    if verdict not in EXPLAINED and worst is not None and left[worst] > max_left:
        text = "{left_percent:.2g} % of the voltage of the {kind} is left unexplained; {max_percent:.2g} % is allowed"
        values = {"left_percent": 100.0 * left[worst], "max_percent": 100.0 * max_left}
        against.append(Remark.of("unexplained", text, kind=kind_words(worst), **values))
    between = held_out_chi2(fit)
    if verdict not in EXPLAINED and between is not None and between - 1.0 > limits.verdict.immaterial_excess_chi2:
        text = "the stages that were not fitted have chi2 {chi2:.2g}: between the fitted points the map is wrong"
        against.append(Remark.of("wrong_between_points", text, chi2=between))
    largest = max(moved, key=lambda name: moved[name], default=None)
    max_percent = limits.verdict.widest_band_percent
    if verdict == "unknown_remains" and largest is not None and 100.0 * moved[largest] > max_percent:
        text = "{effect} moves the model's map by {moved_percent:.2g} %, and may stand in for what is unknown"
        against.append(Remark.of("may_stand_in", text, effect=largest, moved_percent=100.0 * moved[largest]))
    if verdict not in EXPLAINED and (name := most_strained(fit)):
        text = "{effect} has a form as no such effect has, and may stand in for what is unknown"
        against.append(Remark.of("strained_form", text, effect=name))
    against += [_of_small_loops(name) for name in remembering_by_ripple_alone(fit, moved)]
    against += size_remarks(fit)
    if band_percent > max_percent:
        against.append(_uncertain_map(band_percent, widening, max_percent))
    return [one.by(METHOD) for one in against]


def _uncertain_map(band_percent: float, widening: tuple[str, float] | None, max_percent: float) -> Remark:
    text = "the model's map is known to +-{band_percent:.2g} % of the rated flux (95 %, at the measured currents)"
    if widening is None or widening[1] > max_percent:
        return Remark.of("uncertain_map", text, band_percent=band_percent)
    name, without_percent = widening
    text += " because of {effect} alone, whose size this recording cannot determine"
    text += "; without it, to +-{without_percent:.2g} %"
    return Remark.of(
        "uncertain_map", text, band_percent=band_percent, effect=plain(name), without_percent=without_percent
    )


def remembering_by_ripple_alone(fit: Fit, moved: Mapping[str, float]) -> list[str]:
    """Effects with hysteresis that move the map and were measured by a ripple alone."""
    if any(piece.stage in _WIDE for piece in fit.prepared.pieces):
        return []
    threshold = fit.criteria.materiality.material_flux
    return [a.name for a in fit.model.active if has_random_directions(a) and moved.get(a.name, 0.0) > threshold]


def _of_small_loops(name: str) -> Remark:
    text = (
        "{effect} was seen by a ripple alone, which goes round small loops: of wide ones, and so of the flux, it says "
        "little; sweep the current"
    )
    return Remark.of("small_loops", text, effect=name)
