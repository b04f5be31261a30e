"""Findings for the report: effects with intervals, saturation of a freed map, and the unexplained residual."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping, Sequence

import numpy as np

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CROSS_SATURATION, SATURATION, EffectTerm, value_at
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.companions import companions
from orchestrator.diagnosis.judgement.contributions import Contribution, is_material
from orchestrator.diagnosis.judgement.intervals import INTERVAL_SIGMAS, standardised_covariance
from orchestrator.diagnosis.judgement.residual_pattern import residual_pattern
from orchestrator.diagnosis.judgement.verdict import large_effects_together, residual_fraction_of
from orchestrator.diagnosis.selection.scoring import probabilities
from protocols import (
    Companion,
    DriveRecord,
    FoundEffect,
    ParameterRole,
    ParameterValue,
    PluginError,
    Remark,
    ShapeShare,
    Unexplained,
    hook_of,
)

TYPICAL_SATURATION: float = 0.4
"""Typical relative variation of L_d and L_q over the measured currents; relative sizes refer to it."""
TYPICAL_CROSS_SATURATION: float = 0.1
"""Typical largest |L_dq| relative to the mean inductance; relative sizes refer to it."""


def found_effects(
    fitter: Fitter,
    fit: Fit,
    evidence: Mapping[str, float | None],
    indistinguishable: Mapping[str, Sequence[str]],
    sizes: Mapping[str, Contribution] | None = None,
) -> tuple[FoundEffect, ...]:
    """The active effects with 95 % intervals, by share; see `standardised_covariance`.

    Unobservable parameters (such as slotting with one rotor angle) are omitted.
    """
    if not fit.model.active:
        return ()
    presence, sizes = probabilities(fit), sizes or {}
    covariance = standardised_covariance(fitter, fit)
    half, partners = INTERVAL_SIGMAS * np.sqrt(np.diag(covariance)), companions(fit, covariance)
    shows = np.diag(fit.projected()[0]) > 0.0
    effects, k = [], 0
    for active in fit.model.active:
        columns = slice(k, k + len(active.free))
        widths = {n: w for n, w, s in zip(active.free, half[columns], shows[columns], strict=True) if s}
        k += len(active.free)
        effects.append(
            FoundEffect(
                name=active.name,
                parameters=(
                    parameters := {
                        n: _interval(active, n, float(w), partners.get((active.name, n))) for n, w in widths.items()
                    }
                ),
                derived=derived_quantities(active, parameters, fit.prepared.manifest.drive),
                twins=tuple(name for name in indistinguishable.get(active.name, ()) if name != active.name),
                relative_size=active.relative_size,
                typical=typical_size(active, fit.prepared.manifest.drive),
                log_evidence=evidence.get(active.name, 0.0),
                probability=presence[active.name],
                share=sizes[active.name].relative_to_error if active.name in sizes else None,
                share_in=sizes[active.name].largest_in if active.name in sizes else None,
                material=is_material(sizes[active.name], fit) if active.name in sizes else None,
            )
        )
    return tuple(sorted(effects, key=lambda effect: -(effect.share or 0.0)))


def size_remarks(fit: Fit) -> list[Remark]:
    """A remark where implausibly many effects are large, which a single unmodelled cause may imitate."""
    large = large_effects_together(fit)
    text = (
        "{effects}: each is larger than in most drives; one unmodelled cause may imitate all of them, such as "
        "crosstalk between the current sensors: measure at a second angle, too"
    )
    return [Remark.of("rare_together", text, effects=", ".join(large))] if large else []


def effect_remarks(fit: Fit, causes: Container[str]) -> list[Remark]:
    """Remarks of the named effects on their parameters; raises `PluginError` where one fails."""
    return [remark for active in fit.model.active if active.name in causes for remark in _remarks_of_effect(active)]


def _remarks_of_effect(active: EffectTerm) -> list[Remark]:
    says = hook_of(active.candidate.effect, "remarks")
    try:
        return [] if says is None else [remark.by(active.name) for remark in says(active.parameters)]
    except Exception as error:  # somebody else's code may raise anything
        raise PluginError("effects", active.name, f"remarks: {type(error).__name__}: {error}") from error


def credible_effects(effects: Iterable[FoundEffect], min_share: float, max_share: float) -> tuple[FoundEffect, ...]:
    """Effects with a share of at least `min_share`, the residual's, and, if that is positive, at most `max_share`."""
    highest = max_share if min_share > 0.0 else math.inf
    return tuple(e for e in effects if min_share <= (e.share or 0.0) <= highest)


def _interval(active: EffectTerm, name: str, half: float, partner: Companion | None) -> ParameterValue:
    p = active.candidate.named(name)
    x = active.standardised_value(name)
    ends = sorted((value_at(p, x - half), value_at(p, x + half)))
    bends = p.role is ParameterRole.REFINEMENT
    return ParameterValue(
        value=active.values[name],
        low=ends[0],
        high=ends[1],
        unit=p.unit,
        bends_form=bends,
        determined_with=partner,
    )


def typical_size(active: EffectTerm, drive: DriveRecord) -> ParameterValue:
    """The typical value that `EffectTerm.relative_size` refers to, as a quantity of the drive where there is one."""
    amplitudes = [active.candidate.named(name) for name in active.candidate.amplitudes]
    by_ratio = {
        abs(p.typical / active.values[p.name] if p.strong_when_small else active.values[p.name] / p.typical): p
        for p in amplitudes
    }
    largest = by_ratio[max(by_ratio)]
    of_drive = _derived_values(active, {**active.values, largest.name: largest.typical}, drive)
    value, unit = next(iter(of_drive.values()), (largest.typical, largest.unit))
    return ParameterValue(value=value, low=None, high=None, unit=unit)


def map_effects(fit: Fit, evidence: Mapping[str, float]) -> tuple[FoundEffect, ...]:
    """Saturation and cross-saturation of a freed map as effects, sized by the variation of the inductances."""
    grid = fit.model.space.grid
    d = np.linspace(grid.low, grid.high, 25)
    q = np.linspace(-grid.reach, grid.reach, 25)
    nodes = np.stack([g.ravel() for g in np.meshgrid(d, q)], axis=1)
    inductance = fit.model.magnetics.flux_and_inductance(nodes)[1]
    mean = inductance[:, [0, 2]].mean()
    sizes = {
        SATURATION: (float(np.ptp(inductance[:, [0, 2]], axis=0).max() / mean), TYPICAL_SATURATION),
        CROSS_SATURATION: (float(np.abs(inductance[:, 1]).max() / mean), TYPICAL_CROSS_SATURATION),
    }
    return tuple(
        FoundEffect(
            name=name,
            parameters={"relative_change": ParameterValue(value=sizes[name][0], low=None, high=None, unit="1")},
            twins=(),
            relative_size=sizes[name][0] / sizes[name][1],
            log_evidence=gain,
        )
        for name, gain in evidence.items()
    )


def unexplained(setup: DiagnosisSetup, first_chi2: float, last: Fit) -> Unexplained:
    detected = last.chi2_per_dof > last.criteria.verdict.noise_chi2
    shape = residual_pattern(setup.fitter, last, setup.current_a) if detected else []
    return Unexplained(
        fraction=residual_fraction_of(first_chi2, last),
        shape=tuple(ShapeShare(group=group, share=share) for group, share in shape),
    )


def derived_quantities(
    active: EffectTerm, parameters: Mapping[str, ParameterValue], drive: DriveRecord
) -> dict[str, ParameterValue]:
    """Quantities that an effect derives from its parameters and the drive's data; empty where it has none.

    Intervals are propagated one parameter at a time and added in quadrature; correlations are neglected.

    Raises
    ------
    PluginError
        If the effect's code fails.
    """
    middle = _derived_values(active, active.values, drive)
    below, above = dict.fromkeys(middle, 0.0), dict.fromkeys(middle, 0.0)
    for parameter, interval in parameters.items():
        for end in (interval.low, interval.high):
            if end is None:
                continue
            moved = _derived_values(active, {**active.values, parameter: end}, drive)
            for name, (value, _) in middle.items():
                change = moved.get(name, (value, ""))[0] - value
                side = below if change < 0.0 else above
                side[name] = math.hypot(side[name], change)
    return {
        name: ParameterValue(value=value, low=value - below[name], high=value + above[name], unit=unit)
        for name, (value, unit) in middle.items()
    }


def _derived_values(
    active: EffectTerm, values: Mapping[str, float], drive: DriveRecord
) -> dict[str, tuple[float, str]]:
    """Values and units that an effect derives from these values of its parameters; raises `PluginError`."""
    hook = hook_of(active.candidate.effect, "derived")
    try:
        return {} if hook is None else dict(hook(active.candidate.effect.Parameters(**values), drive))
    except Exception as error:  # somebody else's code may raise anything
        raise PluginError("effects", active.name, f"derived: {type(error).__name__}: {error}") from error
