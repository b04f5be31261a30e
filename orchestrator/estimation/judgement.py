"""Which of the maps is recommended, whether it can be relied on, and what is to be said. Estimates nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orchestrator.analysis._checks import difference_percent, flux_ratio, rated_flux_wb
from orchestrator.estimation.sensorless import seen_by_injection
from protocols import (
    Basis,
    EstimationReport,
    FluxMap,
    FluxMapEstimate,
    InductanceRange,
    MapChecks,
    MapCriteria,
    MapReport,
    Remark,
    ResistanceEstimate,
)


@dataclass(frozen=True)
class Found:
    """What the estimators of a pass made.

    Attributes
    ----------
    resistances : mapping of ResistanceEstimate
        By the estimator's name.
    maps : mapping of FluxMapEstimate
        By method, those of the highest rank first.
    missing : tuple of Remark
        What could not be estimated, and why.
    """

    resistances: Mapping[str, ResistanceEstimate]
    maps: Mapping[str, FluxMapEstimate]
    missing: tuple[Remark, ...]


def judged(found: Found, rated_a: float | None, criteria: MapCriteria) -> EstimationReport:
    """The report, without files.

    Parameters
    ----------
    rated_a : float or None
        Rated current [A peak], to which the percentages' flux belongs.
    """
    maps = _preferred(found.maps, rated_a, criteria)
    best = next(iter(maps.values()), None)
    resistance = min(found.resistances.values(), key=lambda r: r.high - r.low, default=None)
    checks = best.checks if best is not None else MapChecks()
    pair = _independent(maps)
    difference = None if pair is None else difference_percent(*pair, _rated_flux_wb(pair, maps, rated_a))
    against = [*_objections(best, maps, criteria), *_apart(difference, criteria), *_unchecked(maps, difference)]
    return EstimationReport(
        resistance=resistance,
        method=best.map.method if best is not None else None,
        crossings=checks.crossings,
        parity=checks.parity,
        reciprocity_percent=checks.reciprocity_percent,
        classical_against_injection_percent=difference,
        usable=best is not None and not against,
        remarks=(
            *against,
            *_disagreements(pair, criteria),
            *found.missing,
            *_other_resistances(resistance, found.resistances),
            *(resistance.remarks if resistance is not None else ()),
            *_unscaled(best, rated_a),
            *(remark.by(method) for method, made in found.maps.items() for remark in made.remarks),
        ),
        maps={method: _map_report(made) for method, made in maps.items()},
        seen_by_injection=seen_by_injection(tuple(maps.values())),
        criteria=criteria,
    )


def _preferred(
    maps: Mapping[str, FluxMapEstimate], rated_a: float | None, criteria: MapCriteria
) -> dict[str, FluxMapEstimate]:
    """The best first: energies that do not explain the measurements come last."""
    measured = [made.map for made in maps.values() if made.map.basis is not Basis.ENERGY]

    def fails(made: FluxMapEstimate) -> bool:
        """An energy has to agree with one of the others at least; one that does is better than any of them alone."""
        if made.map.basis is not Basis.ENERGY:
            return False
        rated = rated_flux_wb(made.map, rated_a)
        off = [apart for other in measured if (apart := difference_percent(made.map, other, rated)) is not None]
        return bool(off) and min(off) > criteria.energy_percent

    return dict(sorted(maps.items(), key=lambda item: fails(item[1])))


def _independent(maps: Mapping[str, FluxMapEstimate]) -> tuple[FluxMap, FluxMap] | None:
    """The best map by injection and the best by integration: neither knows of the other."""
    by = {basis: [made.map for made in maps.values() if made.map.basis is basis] for basis in Basis}
    if not by[Basis.INJECTION] or not by[Basis.INTEGRATION]:
        return None
    return by[Basis.INJECTION][0], by[Basis.INTEGRATION][0]


def _rated_flux_wb(
    pair: tuple[FluxMap, FluxMap], maps: Mapping[str, FluxMapEstimate], rated_a: float | None
) -> float | None:
    """By the first of all maps that reaches the rated current; a map of few points may just miss it."""
    told = (rated_flux_wb(one, rated_a) for one in (pair[0], *(made.map for made in maps.values())))
    return next((flux for flux in told if flux is not None), None)


def _unchecked(maps: Mapping[str, FluxMapEstimate], difference: float | None) -> list[Remark]:
    """Said where there is a map, and nothing that could have spoken against it."""
    checks = [made.checks for made in maps.values()]
    measured = [made.checks for made in maps.values() if made.map.basis is not Basis.ENERGY]
    told = [c.crossings for c in checks] + [c.parity for c in measured] + [c.reciprocity_percent for c in measured]
    if not maps or difference is not None or any(one is not None for one in told):
        return []
    text = (
        "nothing here checks the map: no paths of currents that cross, no currents on both sides of i_q = 0, one "
        "method only; a diagnosis holds it against the readings"
    )
    return [Remark.of("unchecked", text)]


def _objections(
    best: FluxMapEstimate | None, maps: Mapping[str, FluxMapEstimate], criteria: MapCriteria
) -> list[Remark]:
    """What makes the recommended map unusable; an energy is even by construction, so another map's parity counts."""
    if best is None:
        return [Remark.of("no_map", "no flux map could be made")]
    checks, told = best.checks, []
    parities = [made.checks.parity for made in maps.values() if made.map.basis is not Basis.ENERGY]
    measured = checks.parity if best.map.basis is not Basis.ENERGY else next((p for p in parities if p), None)
    for axis in ("d", "q"):
        crossing = getattr(checks.crossings, f"{axis}_percent", None)
        if crossing is not None and crossing > criteria.crossings_percent:
            text = "where current paths cross, psi_{axis} differs by {apart_percent:.1f} % of the rated flux"
            told.append(Remark.of("bad_crossings", text, axis=axis, apart_percent=crossing))
        parity = getattr(measured, f"{axis}_percent", None)
        if parity is not None and parity > criteria.parity_percent:
            text = (
                "psi_{axis} breaks its symmetry in i_q by {off_percent:.1f} % of the rated flux: "
                "is the rotor angle right?"
            )
            told.append(Remark.of("bad_parity", text, axis=axis, off_percent=parity))
    worst = _measured_reciprocity_percent(best, maps)
    if worst is not None and worst > criteria.reciprocity_percent:
        text = "the slopes of psi_d along i_q and of psi_q along i_d differ by {apart_percent:.0f} % of the inductance"
        told.append(Remark.of("bad_reciprocity", text, apart_percent=worst))
    return told


def _measured_reciprocity_percent(best: FluxMapEstimate, maps: Mapping[str, FluxMapEstimate]) -> float | None:
    """Of the recommended map; of the one beside it where that is an energy's, which rests on that alone."""
    if best.map.basis is not Basis.ENERGY:
        return best.checks.reciprocity_percent
    beside = [made.checks.reciprocity_percent for made in maps.values() if made.map.basis is not Basis.ENERGY]
    return beside[0] if len(beside) == 1 else None


def _apart(difference: float | None, criteria: MapCriteria) -> list[Remark]:
    """One of two methods that differ is wrong; which, the maps do not say."""
    if difference is None or difference <= criteria.difference_percent:
        return []
    text = "the classical and the injection map differ by {apart_percent:.1f} % of the rated flux (rms)"
    return [Remark.of("methods_differ", text, apart_percent=difference)]


def _disagreements(pair: tuple[FluxMap, FluxMap] | None, criteria: MapCriteria) -> list[Remark]:
    """Whether one method finds more flux throughout; why is a matter of the diagnosis."""
    ratio = None if pair is None else flux_ratio(*pair)
    if ratio is None:
        return []
    told = []
    value, std = ratio
    if abs(value - 1.0) > max(criteria.flux_ratio_stds * std, criteria.least_flux_ratio):
        less = value < 1.0
        text = (
            "injection gives {apart_percent:.1f} % {size} flux than the classical method, more than their errors "
            "explain: `fluxbench diagnose` tells why"
        )
        values = {"apart_percent": 100 * abs(value - 1.0), "std_percent": 100 * std}
        told.append(Remark.of("flux_ratio", text, size="less" if less else "more", **values))
    return told


def _other_resistances(
    chosen: ResistanceEstimate | None, resistances: Mapping[str, ResistanceEstimate]
) -> list[Remark]:
    """The one with the narrowest interval is chosen; what the others say is told."""
    text = "R_s = {value_ohm:.4g} ohm (95 %: {low:.4g} to {high:.4g}), a wider interval: not used"
    return [
        Remark.of("wider_interval", text, value_ohm=r.value_ohm, low=r.low, high=r.high).by(name)
        for name, r in resistances.items()
        if r is not chosen
    ]


def _unscaled(best: FluxMapEstimate | None, rated_a: float | None) -> list[Remark]:
    if best is None or rated_flux_wb(best.map, rated_a) is not None:
        return []
    return [Remark.of("rated_current_not_reached", "the map does not reach the rated current: no percentages")]


def _map_report(made: FluxMapEstimate) -> MapReport:
    return MapReport(basis=made.map.basis, checks=made.checks, inductances=inductances_of(made.map), form=made.form)


def inductances_of(flux_map: FluxMap) -> InductanceRange | None:
    """Over what a map knows; None where it knows none."""
    l_dd, l_qq, l_dq = (values[np.isfinite(values)] for values in (flux_map.l_dd, flux_map.l_qq, flux_map.l_dq))
    if not len(l_dd) or not len(l_qq) or not len(l_dq):
        return None
    return InductanceRange(
        l_dd_low_h=float(l_dd.min()),
        l_dd_high_h=float(l_dd.max()),
        l_qq_low_h=float(l_qq.min()),
        l_qq_high_h=float(l_qq.max()),
        l_dq_largest_h=float(np.abs(l_dq).max()),
    )
