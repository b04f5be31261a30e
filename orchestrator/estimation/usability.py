"""The checks that decide whether a map and its R_s are usable, each with its figures.

The flux of a usable map is accurate to `MapCriteria.accuracy_percent` (rms) of a reference flux. A check that the
recording does not allow has not passed; whether it is required depends on the other checks that show the same error:

- crossings, or for one energy its residual, and parity: an error of the angle, of R_s, of the voltage.
- a second method: injection alone cannot separate an inductance from a delay or from eddy currents, whose share grows
  with the frequency; sweeps or a second frequency can.
- the flux's own 95 % band, and whether the map can be inverted.
- R_s: its interval, the scatter of its readings, its ratio to the nameplate's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from orchestrator.analysis._checks import band_percent, difference_percent, flux_ratio, reference_flux_wb
from orchestrator.numerics.types import Array
from protocols import (
    AxisPercent,
    Basis,
    CheckOutcome,
    FluxMap,
    FluxMapEstimate,
    IncrementalInductances,
    MapCriteria,
    Motor,
    Remark,
    ResistanceEstimate,
    SegmentStage,
    UsabilityCheck,
)

NOT_JUDGED = "not_judged"
"""Code of the remark on a map of whose recording no model is known to explain it."""
_SWEEPS = {SegmentStage.CLASSICAL, SegmentStage.STEPS}
_RESISTANCE_STAGES = {*_SWEEPS, SegmentStage.RESISTANCE}
_MIRRORED_SHARE = 0.5
"""Smallest reach on the shorter side of i_q = 0, relative to the longer, with which an energy checks the symmetry."""
_SAME_POINT_SHARE = 0.05
"""Distance over the largest current within which two injections are at one point."""


@dataclass(frozen=True)
class MapEvidence:
    """Input of a map's checks.

    Attributes
    ----------
    best : FluxMapEstimate
        The recommended one.
    maps : mapping of FluxMapEstimate
        All, by method, the best first.
    stages : set of SegmentStage
        Stages of the recording.
    """

    best: FluxMapEstimate
    maps: Mapping[str, FluxMapEstimate]
    stages: Set[SegmentStage]
    motor: Motor
    criteria: MapCriteria

    @property
    def measured(self) -> list[FluxMapEstimate]:
        """Maps that are not symmetric by construction."""
        return [made for made in self.maps.values() if made.map.basis is not Basis.ENERGY]

    @property
    def pair(self) -> tuple[FluxMap, FluxMap] | None:
        """The best map by injection and the best by integration, which are independent."""
        return independent_maps(self.maps)


def independent_maps(maps: Mapping[str, FluxMapEstimate]) -> tuple[FluxMap, FluxMap] | None:
    """The best map by injection and the best by integration; None where there are not both."""
    by = {basis: [made.map for made in maps.values() if made.map.basis is basis] for basis in Basis}
    if not by[Basis.INJECTION] or not by[Basis.INTEGRATION]:
        return None
    return by[Basis.INJECTION][0], by[Basis.INTEGRATION][0]


def methods_difference_percent(maps: Mapping[str, FluxMapEstimate], motor: Motor) -> float | None:
    """rms flux difference of the two independent maps; None where there are not both, or they do not overlap."""
    pair = independent_maps(maps)
    return None if pair is None else difference_percent(*pair, _reference_wb(maps, motor))


def significant_flux_ratio(pair: tuple[FluxMap, FluxMap] | None, criteria: MapCriteria) -> tuple[float, float] | None:
    """Ratio of injection's flux to integration's and its standard deviation; None where not significant."""
    ratio = None if pair is None else flux_ratio(*pair)
    if ratio is None or abs(ratio[0] - 1.0) <= max(criteria.flux_ratio_stds * ratio[1], criteria.least_flux_ratio):
        return None
    return ratio


def map_checks(evidence: MapEvidence) -> Iterator[UsabilityCheck]:
    """Every check of the recommended map."""
    yield _crossings(evidence)
    yield _parity(evidence)
    yield _reciprocity(evidence)
    yield _methods(evidence)
    if evidence.best.map.basis is Basis.ENERGY and evidence.measured:
        yield _energy(evidence)
    yield flux_band(evidence.best.map, reference_flux_wb(evidence.best.map, evidence.motor), evidence.criteria)
    yield convex(evidence.best.map)


def resistance_checks(
    resistance: ResistanceEstimate | None, motor: Motor, stages: Set[SegmentStage], criteria: MapCriteria
) -> Iterator[UsabilityCheck]:
    """Every check of R_s, required where the recording has a stage that determines it."""
    if resistance is None:
        text = "R_s was not measured"
        yield _missing("resistance_interval", text, required=bool(stages & _RESISTANCE_STAGES))
        return
    yield _resistance_interval(resistance, criteria)
    yield _resistance_scatter(resistance, criteria)
    yield _resistance_nameplate(resistance, motor, criteria)


def _reference_wb(maps: Mapping[str, FluxMapEstimate], motor: Motor) -> float | None:
    """Reference flux of the recommended map [Wb]."""
    return next((reference_flux_wb(made.map, motor) for made in maps.values()), None)


def _crossings(evidence: MapEvidence) -> UsabilityCheck:
    limit, (axis, value) = evidence.criteria.crossings_percent, _worst(evidence.best.checks.crossings)
    if value is None:
        another = methods_difference_percent(evidence.maps, evidence.motor) is not None
        text = "no current paths cross: whether the flux depends on the path is unknown"
        # Two methods that agree on the flux exclude a dependence on the path.
        return _missing("crossings", text, required=not another)
    text = "where current paths cross, psi_{axis} differs by {apart_percent:.1f} % of the rated flux"
    return _within("crossings", value, limit, text, {"axis": axis, "apart_percent": value}, bad="bad_crossings")


def _parity(evidence: MapEvidence) -> UsabilityCheck:
    """Parity of the recommended map; of another one, or the residual, for an energy, which is even by construction."""
    best, limit = evidence.best, evidence.criteria.parity_percent
    shown = [best] if best.map.basis is not Basis.ENERGY else evidence.measured
    parities = [_worst(made.checks.parity) for made in shown]
    axis, value = next((one for one in parities if one[1] is not None), ("q", None))
    if value is not None:
        text = "psi_{axis} breaks its symmetry in i_q by {off_percent:.1f} % of the rated flux"
        if value > limit:
            text += ": is the rotor angle right?"
        return _within("parity", value, limit, text, {"axis": axis, "off_percent": value}, bad="bad_parity")
    if not evidence.measured and best.checks.crossings is not None and _is_mirrored(best.map):
        text = "readings on both sides of i_q = 0 fit one even energy: see the crossings"
        return met("parity", Remark.of("parity", text))
    text = "no currents on both sides of i_q = 0: nothing shows whether the rotor angle is right"
    return _missing("parity", text, required=True)


def _reciprocity(evidence: MapEvidence) -> UsabilityCheck:
    """Reciprocity of the recommended map; for an energy, of its measured map where it has exactly one."""
    limit, best = evidence.criteria.reciprocity_percent, evidence.best
    measured = [made.checks.reciprocity_percent for made in evidence.measured]
    value = measured[0] if len(measured) == 1 else None
    if best.map.basis is not Basis.ENERGY:
        value = best.checks.reciprocity_percent
    if value is None:
        return _missing("reciprocity", "no map here could break reciprocity", required=False)
    text = "the slopes of psi_d along i_q and of psi_q along i_d differ by {apart_percent:.0f} % of the inductance"
    return _within("reciprocity", value, limit, text, {"apart_percent": value}, bad="bad_reciprocity")


def _methods(evidence: MapEvidence) -> UsabilityCheck:
    """Whether a second method, or injection at a second frequency, finds the same flux."""
    criteria, pair = evidence.criteria, evidence.pair
    injected = SegmentStage.INJECTION in evidence.stages or any(
        made.map.basis is Basis.INJECTION for made in evidence.maps.values()
    )
    value = methods_difference_percent(evidence.maps, evidence.motor)
    if value is not None:
        text = "the classical and the injection map differ by {apart_percent:.2g} % of the rated flux (rms)"
        ratio = significant_flux_ratio(pair, criteria)
        differ = value > criteria.accuracy_percent or ratio is not None
        if ratio is not None:
            text += ", by {ratio_percent:.1f} % throughout, more than their errors explain"
        values = {"apart_percent": value, "ratio_percent": None if ratio is None else 100.0 * abs(ratio[0] - 1.0)}
        bands = _bands_percent(evidence)
        if differ and ratio is None and bands is not None and value <= sum(bands):
            # Both are within their bands, but too uncertain to confirm each other.
            text += (
                ", within their own 95 % bands of {classical_percent:.2g} and {injection_percent:.2g} %: the one with "
                "the wider band confirms nothing"
            )
            values |= {"injection_percent": bands[0], "classical_percent": bands[1]}
        elif differ:
            text += ": one of them is wrong, or they see different inductances; a diagnosis can tell"
        return _within("methods", value, criteria.accuracy_percent, text, values, bad="methods_differ", failed=differ)
    frequencies = _frequency_difference_percent(evidence)
    if frequencies is not None:
        text = "injections of different frequency see inductances that differ by {apart_percent:.2g} % (mean)"
        values = {"apart_percent": frequencies}
        return _within("methods", frequencies, criteria.accuracy_percent, text, values, bad="methods_differ")
    if not injected:
        return _missing("methods", "one method alone: the loops of the sweeps are its only check", required=False)
    text = (
        "nothing to compare injection with: it cannot separate an inductance from a delay or eddy currents; sweep the "
        "current too, or inject at a second frequency"
    )
    if evidence.stages & _SWEEPS:
        text = "sweeps and injection do not both give a map of the same currents: nothing compares the two methods"
    return _missing("methods", text, required=True)


def _energy(evidence: MapEvidence) -> UsabilityCheck:
    """Deviation of an energy from the nearest map that it was fitted to."""
    reference = reference_flux_wb(evidence.best.map, evidence.motor)
    each = [difference_percent(evidence.best.map, made.map, reference) for made in evidence.measured]
    off = [one for one in each if one is not None]
    if not off:
        text = "the energy and the maps that it was fitted to share no currents"
        return _missing("energy_agreement", text, required=True)
    text = "the energy differs from the nearest measured map by {apart_percent:.2g} % of the rated flux (rms)"
    limit, figures = evidence.criteria.accuracy_percent, {"apart_percent": min(off)}
    return _within("energy_agreement", min(off), limit, text, figures, bad="energy_differs")


def flux_band(flux_map: FluxMap, reference_wb: float | None, criteria: MapCriteria) -> UsabilityCheck:
    """The 95 % band of the flux, rms over the map."""
    value = band_percent(flux_map, reference_wb)
    if value is None:
        return _missing("flux_band", "the flux has no standard deviation", required=True)
    text = "the flux is known to +-{half_percent:.2g} % of the rated flux (95 %, of noise alone, rms over the map)"
    return _within("flux_band", value, criteria.accuracy_percent, text, {"half_percent": value}, bad="uncertain_map")


def convex(flux_map: FluxMap) -> UsabilityCheck:
    """Whether the inductances of a map are positive definite: the map of a motor's energy can be inverted."""
    l_dd, l_dq, l_qq = flux_map.l_dd, flux_map.l_dq, flux_map.l_qq
    known = np.isfinite(l_dd) & np.isfinite(l_dq) & np.isfinite(l_qq)
    if not known.any():
        return _missing("convex", "no inductances are known", required=True)
    bad = known & ((l_dd <= 0.0) | (l_qq <= 0.0) | (l_dd * l_qq <= l_dq**2))
    value = 100.0 * float(bad.sum()) / float(known.sum())
    text = "the inductances are positive definite in the whole map"
    if value:
        text = "in {nodes_percent:.2g} % of the map the inductances are not positive definite: no motor's energy"
    return _within("convex", value, 0.0, text, {"nodes_percent": value}, bad="not_convex")


def _resistance_interval(resistance: ResistanceEstimate, criteria: MapCriteria) -> UsabilityCheck:
    value, low, high = resistance.value_ohm, resistance.low, resistance.high
    name, limit = "resistance_interval", criteria.resistance_percent
    if value <= 0.0:
        return _within(
            name, None, limit, "R_s = {value_ohm:.3g} ohm is no resistance", {"value_ohm": value}, bad="bad_resistance"
        )
    half = 50.0 * (high - low) / value
    text = "R_s = {value_ohm:.4g} ohm (95 %: {low:.3g} to {high:.3g}) is known to +-{half_percent:.2g} %"
    if low <= 0.0:
        text += ": the interval reaches zero"
    elif half > limit:
        text += ", no more accurate than a nameplate"
    figures = {"value_ohm": value, "low": low, "high": high, "half_percent": half}
    return _within(name, half, limit, text, figures, bad="uncertain_resistance")


def _resistance_scatter(resistance: ResistanceEstimate, criteria: MapCriteria) -> UsabilityCheck:
    """Scatter of neighbouring readings, between which thermal drift is small."""
    readings = resistance.readings
    if len(readings) < 3 or resistance.value_ohm <= 0.0:
        return _missing("resistance_scatter", "too few readings of R_s to estimate their scatter", required=False)
    steps = np.abs(np.diff([one.value_ohm for one in readings])) / math.sqrt(2.0)
    stds = np.array([one.std_ohm for one in readings])
    errors_ohm = np.maximum(np.sqrt(0.5 * (stds[1:] ** 2 + stds[:-1] ** 2)), 1e-9 * resistance.value_ohm)
    # The median of |x| is 0.6745 standard deviations of a normal x.
    scatter = 100.0 * float(np.median(steps)) / 0.6745 / resistance.value_ohm
    errors = float(np.median(steps / errors_ohm)) / 0.6745
    limit = criteria.resistance_percent / 1.96
    failed = scatter > limit and errors > criteria.scatter_ratio
    text = "readings of R_s scatter by {scatter_percent:.2g} %, {errors:.2g} times their own errors"
    figures = {"scatter_percent": scatter, "errors": errors}
    return _within("resistance_scatter", scatter, limit, text, figures, bad="scattered_resistance", failed=failed)


def _resistance_nameplate(resistance: ResistanceEstimate, motor: Motor, criteria: MapCriteria) -> UsabilityCheck:
    stated_ohm = motor.stator_resistance_ohm
    if not stated_ohm or resistance.value_ohm <= 0.0:
        return _missing("resistance_nameplate", "the nameplate states no resistance to compare with", required=False)
    ratio = resistance.value_ohm / stated_ohm
    factor, limit = max(ratio, 1.0 / ratio), criteria.resistance_factor
    text = "R_s is {ratio:.3g} times the nameplate's {nameplate_ohm:.4g} ohm"
    if factor > limit:
        text += ": no convention or tolerance explains it; the nameplate or the readings are wrong"
    figures = {"ratio": ratio, "nameplate_ohm": stated_ohm}
    return _within("resistance_nameplate", factor, limit, text, figures, bad="resistance_off_nameplate", unit="1")


def _bands_percent(evidence: MapEvidence) -> tuple[float, float] | None:
    """Half widths of the bands of injection's and integration's flux vector; None where one is not known."""
    reference = _reference_wb(evidence.maps, evidence.motor)
    bands = [band_percent(one, reference) for one in evidence.pair or ()]
    known = [math.sqrt(2.0) * band for band in bands if band is not None]
    return (known[0], known[1]) if len(known) == 2 else None


def _frequency_difference_percent(evidence: MapEvidence) -> float | None:
    """Largest difference of mean inductances, of one axis, between injections whose frequencies are far apart."""
    differences = [
        difference
        for one, other in combinations((one for estimate in evidence.maps.values() for one in estimate.incremental), 2)
        if abs(math.log(one.frequency_hz / other.frequency_hz)) >= math.log(evidence.criteria.frequency_ratio)
        if (difference := _inductance_difference_percent(one, other)) is not None
    ]
    return max(differences, default=None)


def _inductance_difference_percent(one: IncrementalInductances, other: IncrementalInductances) -> float | None:
    """Difference of L_dd or L_qq, mean over the common points; None without any."""
    a, b = (np.asarray(x.i_dq, dtype=np.float64) for x in (one, other))
    distance: Array = np.linalg.norm(a[:, None] - b[None], axis=2)
    nearest = distance.argmin(axis=1)
    coincident = distance.min(axis=1) <= _SAME_POINT_SHARE * max(float(np.linalg.norm(a, axis=1).max()), 1e-300)
    if not coincident.any():
        return None
    ratio = one.inductance[coincident][:, (0, 2)] / other.inductance[nearest[coincident]][:, (0, 2)]
    return 100.0 * float(np.abs(ratio.mean(axis=0) - 1.0).max())


def _is_mirrored(flux_map: FluxMap) -> bool:
    """Whether a map reaches both sides of i_q = 0 about as far."""
    reached = flux_map.i_q[np.isfinite(flux_map.psi_q).any(axis=0)]
    if not len(reached):
        return False
    sides = -float(reached.min()), float(reached.max())
    return min(sides) >= _MIRRORED_SHARE * max(sides)


def _worst(percent: AxisPercent | None) -> tuple[str, float | None]:
    """The axis with the larger figure, and that."""
    sides = [] if percent is None else [("d", percent.d_percent), ("q", percent.q_percent)]
    known = [(value, axis) for axis, value in sides if value is not None]
    if not known:
        return "q", None
    value, axis = max(known)
    return axis, value


MODEL = "model"
"""The check that a model explains the recording, without which no map is usable."""


def model_check(
    distance_percent: float, band_percent: float, criteria: MapCriteria, *, verdict: str, effects: str
) -> UsabilityCheck:
    """The check of a map against that of a model which explains its recording.

    Parameters
    ----------
    distance_percent, band_percent : float
        rms distance from the model's map, and half width of that one's 95 % band, of the rated flux.
    verdict, effects : str
        The verdict on the model, and its effects; empty without any.
    """
    value, limit = distance_percent + band_percent, criteria.accuracy_percent
    figures = {"apart_percent": distance_percent, "band_percent": band_percent, "verdict": verdict, "effects": effects}
    if value > limit:
        text = (
            "the model that explains the recording has another map, {apart_percent:.2g} % away, +-{band_percent:.2g} %"
        )
        return missing_model(text, **figures)
    model = "R_s, a map and {effects}" if effects else "R_s and a map alone"
    text = f"{model} explain the recording ({{verdict}}); their map is {{apart_percent:.2g}} % away"
    return _within(MODEL, value, limit, text, figures, bad=NOT_JUDGED)


def missing_model(text: str, **values: Any) -> UsabilityCheck:
    """The check where no model explains the recording: `text` says why."""
    remark = Remark.of(NOT_JUDGED, f"not judged, `fluxbench diagnose` decides: {text}", **values)
    return UsabilityCheck(name=MODEL, outcome=CheckOutcome.NOT_POSSIBLE, required=True, remark=remark)


def _within(
    name: str,
    value: float | None,
    limit: float,
    text: str,
    figures: Mapping[str, Any],
    *,
    bad: str,
    failed: bool | None = None,
    unit: str = "%",
) -> UsabilityCheck:
    """A check with a number, which fails beyond its limit unless stated otherwise; its remark's code is `bad` then."""
    fails = failed if failed is not None else value is None or value > limit
    outcome = CheckOutcome.FAILED if fails else CheckOutcome.PASSED
    remark = Remark.of(bad if fails else name, text, **figures)
    return UsabilityCheck(name=name, outcome=outcome, required=True, value=value, limit=limit, unit=unit, remark=remark)


def _missing(name: str, text: str, *, required: bool) -> UsabilityCheck:
    remark = Remark(code="unchecked", values={"check": name}, text=text)
    return UsabilityCheck(name=name, outcome=CheckOutcome.NOT_POSSIBLE, required=required, remark=remark)


def met(name: str, remark: Remark) -> UsabilityCheck:
    """A check that passed without a number."""
    return UsabilityCheck(name=name, outcome=CheckOutcome.PASSED, required=True, remark=remark)


def unmet(name: str, remarks: Sequence[Remark]) -> list[UsabilityCheck]:
    """A failed check for each objection from outside these checks."""
    return [UsabilityCheck(name=name, outcome=CheckOutcome.FAILED, required=True, remark=remark) for remark in remarks]
