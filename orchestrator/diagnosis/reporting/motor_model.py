"""Conversion between a fit and the content of `model.json`."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence

import numpy as np

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, map_space
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm
from orchestrator.diagnosis.fitting.guarded import source_file
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array, Mask
from protocols import (
    Baseline,
    CoEnergySpline,
    FluxMap,
    FoundEffect,
    GivenMap,
    ModelEffect,
    ModelParameter,
    MotorModel,
    Nameplate,
    PluginError,
    Rung,
    SegmentStage,
)


def kept_model(
    setup: DiagnosisSetup, fit: Fit, baseline: Baseline, found: Sequence[FoundEffect], ladder: Sequence[Rung]
) -> MotorModel:
    """A fit's model for `model.json`, with the intervals of its effects."""
    reports = {effect.name: effect for effect in found}
    grid, manifest = fit.model.space.grid, setup.prepared.manifest
    table = fit.model.magnetics.coefficients.reshape(grid.functions)
    return MotorModel(
        recording=manifest.name,
        motor=manifest.motor,
        baseline=baseline,
        r_s_ohm=fit.model.r_s,
        pm_flux_wb=setup.fitter.pm_flux_wb,
        noise=setup.fitter.noise.of_model,
        timer=setup.prepared.quantiser,
        magnetics=CoEnergySpline(
            d_low_a=grid.low,
            d_high_a=grid.high,
            q_high_a=grid.reach,
            d_intervals=grid.cells[0],
            q_intervals=grid.cells[1],
            coefficients_j=tuple(float(c) for c in table[:, : table.shape[1] - grid.kink].reshape(-1)),
            kink_j=tuple(float(c) for c in table[:, -1]) if grid.kink else (),
            measured_hull_a=measured_hull(fit.prepared.pieces),
            roughness=tuple(tuple(row) for row in fit.model.space.roughness.tolist()),
        ),
        effects=tuple(_kept_effect(active, reports[active.name]) for active in fit.model.active),
        ladder=tuple(ladder),
    )


def _kept_effect(active: EffectTerm, found: FoundEffect) -> ModelEffect:
    parameters = {}
    for p in active.candidate.parameters:
        interval = found.parameters.get(p.name)
        low, high = (interval.low, interval.high) if interval is not None else (None, None)
        parameters[p.name] = ModelParameter(
            value=active.values[p.name], low=low, high=high, unit=p.unit, fitted=p.name in active.free
        )
    return ModelEffect(
        name=active.name,
        parameters=parameters,
        twins=found.twins,
        relative_size=found.relative_size,
        log_evidence=found.log_evidence,
        file=source_file(active.candidate.effect),
    )


HULL_SAMPLES: int = 200
"""Samples of each segment for the hull of its currents: a sweep or a turn of the injection has fewer corners."""


def measured_hull(pieces: Sequence[SegmentData]) -> tuple[tuple[float, float], ...]:
    """Convex hull of the measured currents and their mirror images in i_q [A], counterclockwise."""
    from scipy.spatial import ConvexHull

    currents = []
    for piece in pieces:
        if piece.stage is not SegmentStage.GATES_OFF:
            i_dq = to_dq(piece.signals.i_ab, piece.segment.rotor_angle_rad)
            currents.append(i_dq[:: max(1, len(i_dq) // HULL_SAMPLES)])
    points = np.concatenate(currents)
    points = np.concatenate([points, points * np.array([1.0, -1.0])])
    corners = points[ConvexHull(points, qhull_options="QJ").vertices]  # joggled: points on one line have a hull too
    return tuple((float(d), float(q)) for d, q in corners)


def restored(
    setup: DiagnosisSetup, kept: MotorModel, baseline: Baseline, library: Mapping[str, CandidateEffect]
) -> Model:
    """The model of a `model.json`, for evaluation or further fits.

    Parameters
    ----------
    baseline : Baseline
        Freedom of the map: the model's baseline, or `GivenMap` to hold it fixed.
    library : mapping of str to CandidateEffect
        The installed effects.

    Raises
    ------
    PluginError
        If an effect of the model is not installed, or has other parameters.
    """
    magnetics = magnetics_of(kept.magnetics)
    roughness = np.array(kept.magnetics.roughness)
    space = map_space(setup, baseline, magnetics.grid, magnetics.coefficients, roughness)
    return Model(space, magnetics, kept.r_s_ohm, tuple(term_of(effect, library) for effect in kept.effects))


def term_of(effect: ModelEffect, library: Mapping[str, CandidateEffect]) -> EffectTerm:
    """A model's effect with its parameters; raises `PluginError` where it is not installed, or has other parameters."""
    candidate = library.get(effect.name)
    if candidate is None:
        raise _not_installed(effect)
    names = [p.name for p in candidate.parameters]
    if sorted(names) != sorted(effect.parameters):
        problem = f"has {', '.join(names)}, but the model gives {', '.join(effect.parameters) or 'none'}"
        raise PluginError("effects", effect.name, f"parameters: the installed effect {problem}")
    values = {name: effect.parameters[name].value for name in names}
    return EffectTerm(candidate, values, tuple(n for n in names if effect.parameters[n].fitted))


def require_effects_of(kept: MotorModel, names: Container[str]) -> None:
    """Raise `PluginError` where an effect of the model is none of these."""
    for effect in kept.effects:
        if effect.name not in names:
            raise _not_installed(effect)


def _not_installed(effect: ModelEffect) -> PluginError:
    advice = "`--effects` names a file with it"
    if effect.file is not None:
        advice = f"pass `--effects {effect.file}`, the file that it is from"
    return PluginError("effects", effect.name, f"in the model, but not installed; {advice}")


def magnetics_of(spline: CoEnergySpline) -> Magnetics:
    """The co-energy of a `model.json`."""
    s = spline
    grid = EvenSpline(s.d_low_a, s.d_high_a, s.q_high_a, (s.d_intervals, s.q_intervals), bool(s.kink_j))
    table = np.array(s.coefficients_j, dtype=np.float64).reshape(grid.functions[0], -1)
    if s.kink_j:
        table = np.column_stack([table, np.array(s.kink_j, dtype=np.float64)])
    return Magnetics(grid, np.ascontiguousarray(table.reshape(-1)))


def map_nodes(grid: EvenSpline, nodes_per_interval: int = 4) -> tuple[Array, tuple[int, int]]:
    """Nodes of a spline's map (n, 2) [A], and their numbers along i_d and i_q.

    Splines are smooth within an interval: four nodes in it suffice for interpolation.
    """
    i_d = np.linspace(grid.low, grid.high, nodes_per_interval * grid.cells[0] + 1)
    i_q = np.linspace(-grid.reach, grid.reach, nodes_per_interval * grid.cells[1] + 1)
    return np.stack([axis.ravel() for axis in np.meshgrid(i_d, i_q, indexing="ij")], axis=1), (len(i_d), len(i_q))


def flux_map_of(kept: MotorModel) -> FluxMap:
    """A model's map on a grid; NaN beyond the measured currents, and for standard deviations."""
    magnetics = magnetics_of(kept.magnetics)
    nodes, shape = map_nodes(magnetics.grid)
    i_d, i_q = np.unique(nodes[:, 0]), np.unique(nodes[:, 1])
    psi, inductance = magnetics.flux_and_inductance(nodes)
    at_rest, _ = magnetics.flux_and_inductance(np.zeros((1, 2)))
    psi = psi - at_rest + np.array([kept.pm_flux_wb, 0.0])
    table = np.column_stack([psi, inductance])
    table[~_inside(nodes, np.array(kept.magnetics.measured_hull_a).reshape(-1, 2))] = np.nan
    names = ("psi_d", "psi_q", "l_dd", "l_dq", "l_qq")
    fields = {name: column.reshape(shape) for name, column in zip(names, table.T, strict=True)}
    unknown = {f"{name}_std": np.full(shape, np.nan) for name in names}
    return FluxMap(method=f"model of {kept.recording}", i_d=i_d, i_q=i_q, **fields, **unknown)


def held_baseline(kept: MotorModel) -> GivenMap:
    """The baseline of a fit that holds this model's map fixed."""
    return GivenMap(method=f"model of {kept.recording}")


def freed_by(baseline: Nameplate, name: str) -> Nameplate:
    """The baseline with its map freed by one more step, `SATURATION` or `CROSS_SATURATION`."""
    return Nameplate.model_validate({"freed": (*baseline.freed, name)})


def reduced(kept: MotorModel, names: Sequence[str]) -> MotorModel:
    """The model without some of its effects; R_s and map are unchanged."""
    return kept.model_copy(update={"effects": tuple(e for e in kept.effects if e.name not in names)})


def flux_of(model: object) -> float | None:
    """The magnet's flux of a whole model [Wb]; None for other choices."""
    return model.pm_flux_wb if isinstance(model, MotorModel) else None


def with_noise_of(setup: DiagnosisSetup, model: object) -> DiagnosisSetup:
    """The setup with a whole model's noise and timer; unchanged for other choices."""
    if not isinstance(model, MotorModel):
        return setup
    timed = setup if model.timer is None else setup.with_quantiser(model.timer)
    return timed.with_noise(model.noise)


def _inside(points: Array, corners: Array) -> Mask:
    """Mask of the points in a convex polygon with counterclockwise corners; all where it has no corners."""
    inside = np.ones(len(points), dtype=bool)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along, out = end - start, points - start
        inside &= along[0] * out[:, 1] - along[1] * out[:, 0] >= -1e-9 * np.abs(along).max() * np.abs(corners).max()
    return inside
