"""Ranks the estimators' maps and assembles the report with checks and remarks."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass

import numpy as np

from orchestrator.analysis._checks import difference_percent, rated_flux_wb, reference_flux_wb
from orchestrator.estimation.sensorless import seen_by_injection
from orchestrator.estimation.usability import (
    MapEvidence,
    independent_maps,
    map_checks,
    methods_difference_percent,
    resistance_checks,
    significant_flux_ratio,
)
from protocols import (
    Basis,
    EstimationReport,
    FluxMap,
    FluxMapEstimate,
    InductanceRange,
    MapChecks,
    MapCriteria,
    MapReport,
    Motor,
    Remark,
    ResistanceEstimate,
    SegmentStage,
)


@dataclass(frozen=True)
class EstimatorResults:
    """Results of all estimators of a pass.

    Attributes
    ----------
    resistances : mapping of ResistanceEstimate
        By the estimator's name.
    maps : mapping of FluxMapEstimate
        By method, those of the highest rank first.
    missing : tuple of Remark
        Reasons for quantities that could not be estimated.
    stages : set of SegmentStage
        Stages of the recording.
    """

    resistances: Mapping[str, ResistanceEstimate]
    maps: Mapping[str, FluxMapEstimate]
    missing: tuple[Remark, ...]
    stages: Set[SegmentStage]


def report_with_checks(results: EstimatorResults, motor: Motor, criteria: MapCriteria) -> EstimationReport:
    """The report with all checks, without files."""
    maps = _preferred(results.maps, motor, criteria)
    best = next(iter(maps.values()), None)
    resistance = min(results.resistances.values(), key=lambda r: r.high - r.low, default=None)
    figures = best.checks if best is not None else MapChecks()
    report = EstimationReport(
        resistance=resistance,
        method=best.map.method if best is not None else None,
        crossings=figures.crossings,
        parity=figures.parity,
        reciprocity_percent=figures.reciprocity_percent,
        classical_against_injection_percent=methods_difference_percent(maps, motor),
        usable=best is not None,
        remarks=(
            *_disagreements(independent_maps(maps), criteria),
            *results.missing,
            *_other_resistances(resistance, results.resistances),
            *(resistance.remarks if resistance is not None else ()),
            *_unscaled(best, motor),
            *(remark.by(method) for method, estimate in results.maps.items() for remark in estimate.remarks),
        ),
        maps={
            method: MapReport(basis=m.map.basis, checks=m.checks, inductances=inductances_of(m.map), form=m.form)
            for method, m in maps.items()
        },
        seen_by_injection=seen_by_injection(tuple(maps.values())),
        criteria=criteria,
    )
    if best is None:
        return report.objected([Remark.of("no_map", "no flux map could be made")])
    evidence = MapEvidence(best, maps, results.stages, motor, criteria)
    return report.checked([*map_checks(evidence), *resistance_checks(resistance, motor, results.stages, criteria)])


def _preferred(maps: Mapping[str, FluxMapEstimate], motor: Motor, criteria: MapCriteria) -> dict[str, FluxMapEstimate]:
    """Maps by rank; those from a fitted energy that deviates from all other maps come last."""
    measured = [estimate.map for estimate in maps.values() if estimate.map.basis is not Basis.ENERGY]

    def fails(estimate: FluxMapEstimate) -> bool:
        """Whether an energy's map deviates from every other; one that agrees with any of them outranks them all."""
        if estimate.map.basis is not Basis.ENERGY:
            return False
        rated = reference_flux_wb(estimate.map, motor)
        off = [difference_percent(estimate.map, other, rated) for other in measured]
        known = [x for x in off if x is not None]
        return bool(known) and min(known) > criteria.energy_percent

    return dict(sorted(maps.items(), key=lambda item: fails(item[1])))


def _disagreements(pair: tuple[FluxMap, FluxMap] | None, criteria: MapCriteria) -> list[Remark]:
    """Remark where one method gives significantly more flux; the diagnosis finds the cause."""
    ratio = significant_flux_ratio(pair, criteria)
    if ratio is None:
        return []
    value, std = ratio
    text = (
        "injection gives {apart_percent:.1f} % {size} flux than the classical method, more than their errors "
        "explain: `fluxbench diagnose` finds the cause"
    )
    values = {"apart_percent": 100 * abs(value - 1.0), "std_percent": 100 * std}
    return [Remark.of("flux_ratio", text, size="less" if value < 1.0 else "more", **values)]


def _other_resistances(
    chosen: ResistanceEstimate | None, resistances: Mapping[str, ResistanceEstimate]
) -> list[Remark]:
    """Remarks on resistances other than the chosen one, which has the narrowest interval."""
    text = "R_s = {value_ohm:.4g} ohm (95 %: {low:.4g} to {high:.4g}), a wider interval: not used"
    return [
        Remark.of("wider_interval", text, value_ohm=r.value_ohm, low=r.low, high=r.high).by(name)
        for name, r in resistances.items()
        if r is not chosen
    ]


def _unscaled(best: FluxMapEstimate | None, motor: Motor) -> list[Remark]:
    """Remark on the reference of percentages where the map has no flux of the rated current."""
    if best is None or rated_flux_wb(best.map, motor.rated_current_a) is not None:
        return []
    reference = reference_flux_wb(best.map, motor)
    if reference is None:
        return [Remark.of("rated_current_not_reached", "no reference flux: percentages are omitted")]
    code, text = "rated_current_not_reached", "the map does not reach the rated current"
    if motor.rated_current_a is None:
        code, text = "rated_current_not_given", "the nameplate has no rated current"
    refer = ": percentages of the rated flux refer to {reference_wb:.4g} Wb, the flux at the map's edge"
    return [Remark.of(code, text + refer, reference_wb=reference)]


def inductances_of(flux_map: FluxMap) -> InductanceRange | None:
    """Ranges of a map's inductances; None where it has none."""
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
