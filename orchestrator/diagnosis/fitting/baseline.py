"""The first model of a diagnosis, R_s and a map without effects, and the choice of the map's resolution."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from orchestrator.diagnosis.criteria import FittingCriteria
from orchestrator.diagnosis.fitting.candidates import CROSS_SATURATION, SATURATION
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit, MapSpace, Model
from orchestrator.diagnosis.fitting.priors import inductances_at_rest
from orchestrator.diagnosis.fitting.roughness import estimated_roughness
from orchestrator.diagnosis.fitting.workers import Executor
from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate, with_quantiser
from orchestrator.diagnosis.weak_form.magnetics import Magnetics, linear_magnetics, magnet_prior, smoothness_prior
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData
from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import (
    Baseline,
    FluxMap,
    GivenMap,
    ModelNoise,
    ModulatorTimer,
    Nameplate,
    NotMeasuredError,
    Remark,
    Saturated,
    SegmentStage,
)

MAX_ROUGHNESS_STEP: float = 3.0
"""Factor by which a finer map's roughness may grow in one step."""
MAX_ROUGHNESS_FACTOR: float = 100.0
"""Largest roughness of a finer map, relative to the usual one."""
MIN_REMOVED_SHARE_OF_FINER_MAP: float = 0.1
"""Part of the excess chi2 that a finer map has to remove; it removes little where an effect is missing."""
GIVEN_MAP_INTERVALS: int = 28
"""Spline intervals on each axis for a given map."""
MIN_AXIS_RANGE: float = 0.05
"""Range of the map on an axis where no current flowed, as a part of the other axis' range."""
MAX_OVERREACH: float = 0.005
"""Distance of currents beyond the map, relative to its range, from which it is widened. Outside, the map continues
linearly; the fitted rotor angle moves the currents after the map's range was chosen."""
LEAST_CHI2_FOR_FINER_MAP: float = 1.03
"""chi2 per degree of freedom above which a finer map is tried: noise alone stays within a few hundredths of one."""
LEAST_CHI2_FOR_KINK: float = 1.08
"""chi2 per degree of freedom of the best smooth map above which one with a kink is tried."""
MAX_CHI2_FOR_FINER_MAP: float = 10.0
"""chi2 per degree of freedom, on the whole recording, above which the misfit is a missing effect, not the map."""
MIN_GAIN_PER_MAP_FREEDOM: float = 6.0
"""Fall of the objective required per additional degree of freedom of a finer map; chance brings one."""
MIN_GAIN_OF_FINER_MAP: float = 30.0
"""Fall of the objective required of a finer map beyond that of its degrees of freedom."""
KNOWN_MAGNET_STD: float = 0.05
"""Standard deviation of a nameplate's magnet flux, relative to the larger of it and L I."""
UNKNOWN_MAGNET_STD: float = 10.0
"""Standard deviation of the magnet flux where the nameplate has none, relative to L I; machines have up to 10."""
GIVEN_MAP_STD: float = 1e-4
"""Standard deviation of a given map's fluxes for its spline fit, relative to L I."""


USUAL: Array = np.ones((1, 1))
"""The usual roughness of a map, the same everywhere."""


@dataclass(frozen=True)
class DiagnosisSetup:
    """A recording ready to be diagnosed."""

    prepared: PreparedRecording
    fitter: Fitter
    part_fitter: Fitter
    """Fitter of a part of the recording."""
    l_d_h: float
    l_q_h: float
    current_a: float
    """Rated current, but at most twice the largest used; the latter where it is unknown [A peak]."""
    remarks: tuple[Remark, ...]
    quantisers: tuple[QuantiserEstimate, ...] = ()
    """The modulator's quantiser as detected in the readings, and alternatives that round alike."""

    def with_executor(self, executor: Executor) -> DiagnosisSetup:
        """A copy whose equations are evaluated by this executor."""
        whole, part = (replace(f, executor=executor) for f in (self.fitter, self.part_fitter))
        return replace(self, fitter=whole, part_fitter=part)

    def with_noise(self, of_model: ModelNoise) -> DiagnosisSetup:
        """A copy with this model-error noise beside the readings' own."""
        if of_model == self.fitter.noise.of_model:
            return self
        whole, part = (f.with_noise(of_model) for f in (self.fitter, self.part_fitter))
        return replace(self, fitter=whole, part_fitter=part)

    def with_quantiser(self, timer: ModulatorTimer | None) -> DiagnosisSetup:
        """A copy with the voltages rounded by a modulator's timer, or as commanded (None)."""
        if timer is self.prepared.quantiser:
            return self
        return self._with_voltages(lambda prepared: with_quantiser(prepared, timer))

    def with_ripple(self, ripples: bool) -> DiagnosisSetup:
        """A copy with or without current ripple within a carrier period (without: linear between readings)."""
        return self._with_voltages(lambda prepared: replace(prepared, ripples=ripples))

    def _with_voltages(self, change: Callable[[PreparedRecording], PreparedRecording]) -> DiagnosisSetup:
        def changed(fitter: Fitter) -> Fitter:
            prepared = change(fitter.prepared)
            batches = fitter.batches.with_voltages_of(prepared.pieces)
            # A linearisation at the old voltages is invalid at the new ones: a new noise object marks it as such.
            return replace(fitter, prepared=prepared, noise=replace(fitter.noise), batches=batches)

        whole, part = changed(self.fitter), changed(self.part_fitter)
        return replace(self, prepared=whole.prepared, fitter=whole, part_fitter=part)

    @property
    def criteria(self) -> FittingCriteria:
        return self.prepared.criteria.fitting


def map_space(
    setup: DiagnosisSetup, baseline: Baseline, grid: EvenSpline, coefficients: Array, roughness: Array = USUAL
) -> MapSpace:
    """The space of maps for a fit from this baseline.

    Parameters
    ----------
    coefficients : array, shape (grid.size,)
        The map's present coefficients, at which a given map is held.
    roughness : array, shape (m, n)
        Of a free map, as in `MapSpace`.
    """
    if isinstance(baseline, GivenMap):
        return _held(grid, coefficients)
    if isinstance(baseline, Saturated) or CROSS_SATURATION in baseline.freed:
        return _free(setup, grid, roughness)
    return _separable(setup, grid) if SATURATION in baseline.freed else _linear(setup, grid)


def _held(grid: EvenSpline, coefficients: Array) -> MapSpace:
    return MapSpace(grid, coefficients, np.zeros((grid.size, 0)), np.zeros((0, 0)))


def _linear(setup: DiagnosisSetup, grid: EvenSpline) -> MapSpace:
    """Constant inductances: the nameplate's, or free ones where it has none."""
    motor = setup.prepared.manifest.motor
    if motor.d_inductance_h is not None and motor.q_inductance_h is not None:
        return _held(grid, linear_magnetics(grid, setup.l_d_h, setup.l_q_h).coefficients)
    d, q = linear_magnetics(grid, 1.0, 0.0).coefficients, linear_magnetics(grid, 0.0, 1.0).coefficients
    return MapSpace(grid, np.zeros(grid.size), np.stack([d, q], axis=1), np.zeros((1, 2)))


def _separable(setup: DiagnosisSetup, grid: EvenSpline) -> MapSpace:
    """W(i) = f(i_d) + g(i_q): inductances that vary with their own axis's current."""
    nd, nq = grid.functions
    directions = np.concatenate([np.kron(np.eye(nd), np.ones((nq, 1))), np.kron(np.ones((nd, 1)), np.eye(nq))], axis=1)
    # A constant may be in f or in g; the prior makes the sum unique.
    prior = np.concatenate([_free(setup, grid).prior @ directions, 1e-6 * np.eye(nd + nq)])
    return MapSpace(grid, np.zeros(grid.size), directions, prior)


def _free(setup: DiagnosisSetup, grid: EvenSpline, roughness: Array = USUAL) -> MapSpace:
    inductance_h, strength = math.sqrt(setup.l_d_h * setup.l_q_h), setup.criteria.roughness
    smooth = smoothness_prior(grid, inductance_h, setup.current_a, strength, roughness)
    prior = np.concatenate([smooth, magnet_prior(grid, _magnet_std_wb(setup))])
    known = inductances_at_rest(setup.prepared.fleet, grid)
    if known is None:
        return MapSpace(grid, np.zeros(grid.size), np.eye(grid.size), prior, roughness)
    return MapSpace(grid, known[0], np.eye(grid.size), np.concatenate([prior, known[1]]), roughness)


def _magnet_std_wb(setup: DiagnosisSetup) -> float:
    """Standard deviation of the magnet's flux about the value that effects use [Wb]."""
    magnet, by_current = setup.fitter.pm_flux_wb, math.sqrt(setup.l_d_h * setup.l_q_h) * setup.current_a
    if magnet > 0.0 or setup.prepared.manifest.motor.pm_flux_wb is not None:
        return KNOWN_MAGNET_STD * max(magnet, by_current)
    return UNKNOWN_MAGNET_STD * by_current


def baseline_model(setup: DiagnosisSetup, baseline: Nameplate | Saturated) -> Model:
    """The initial model of a baseline: the nameplate's inductances on the coarsest grid."""
    intervals = setup.criteria.intervals[0]
    grid = _grid(setup, (intervals, intervals))
    linear = linear_magnetics(grid, setup.l_d_h, setup.l_q_h)
    return Model(map_space(setup, baseline, grid, linear.coefficients), linear, _resistance(setup))


def with_freed_map(setup: DiagnosisSetup, model: Model, baseline: Nameplate) -> Model:
    """A model with the same R_s and effects, and a map as free as the baseline says."""
    bare = baseline_model(setup, baseline)
    return replace(bare, r_s=model.r_s, active=model.active)


def given_model(setup: DiagnosisSetup, flux_map: FluxMap) -> Model:
    """A model with a user's map, held fixed: splines fitted to its flux."""
    intervals = GIVEN_MAP_INTERVALS
    grid = _grid(setup, (intervals, intervals))
    i_d, i_q = np.meshgrid(np.asarray(flux_map.i_d, float), np.asarray(flux_map.i_q, float), indexing="ij")
    i_dq = np.stack([i_d.ravel(), i_q.ravel()], axis=1)
    psi = np.stack([np.asarray(flux_map.psi_d, float).ravel(), np.asarray(flux_map.psi_q, float).ravel()], axis=1)
    psi = psi - np.array([setup.fitter.pm_flux_wb, 0.0])
    good = np.isfinite(psi).all(axis=1) & (np.abs(i_dq[:, 1]) <= grid.reach)
    good &= (i_dq[:, 0] >= grid.low) & (i_dq[:, 0] <= grid.high)
    if good.sum() < 4:
        raise NotMeasuredError(flux_map.method, "psi_d, psi_q", "the map does not cover the recording's currents")
    rows = np.concatenate([grid.rows(i_dq[good], 1, 0), grid.rows(i_dq[good], 0, 1)])
    inductance_h = math.sqrt(setup.l_d_h * setup.l_q_h)
    prior = 1e-3 * smoothness_prior(grid, inductance_h, setup.current_a, setup.criteria.roughness)
    scale = 1.0 / (GIVEN_MAP_STD * inductance_h * setup.current_a)
    design = np.concatenate([rows * scale, prior])
    target = np.concatenate([psi[good].T.ravel() * scale, np.zeros(len(prior))])
    coefficients = np.linalg.lstsq(design, target, rcond=None)[0]
    return Model(_held(grid, coefficients), Magnetics(grid, coefficients), _resistance(setup))


def fit_baseline(setup: DiagnosisSetup) -> Fit:
    """Fit the free map, with the intervals that a part of the recording requires, or more if the whole does."""
    coarsest = setup.part_fitter.fit(baseline_model(setup, Saturated()), relinearisations=1)
    part = with_finest_map(setup, setup.part_fitter, coarsest)
    if part.chi2_per_dof > MAX_CHI2_FOR_FINER_MAP:
        # Such a misfit is a missing effect, to which a fine map would adapt.
        part = coarsest
    fit = setup.fitter.fit(part.model, relinearisations=2)
    # A large misfit is a missing effect; the resolution is reconsidered when the effects are known.
    worth_it = LEAST_CHI2_FOR_FINER_MAP < fit.chi2_per_dof < MAX_CHI2_FOR_FINER_MAP
    return with_finest_map(setup, setup.fitter, fit) if worth_it else with_local_roughness(setup, setup.fitter, fit)


def with_finest_map(setup: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
    """Refit on the finest map justified by its gain; all are tried, as a knee may lie between the nodes of one."""
    fit = widened_map(setup, fitter, fit)
    for intervals in setup.criteria.intervals[1:]:
        grid = replace(fit.model.space.grid, cells=(intervals, intervals))
        finer = finer_map(setup, fitter, fit, grid)
        fit = fit if finer is None else finer
    smooth = _refine_further(setup, fitter, fit)
    kinked = _refined_with_kink(setup, fitter, fit) if smooth.chi2_per_dof > LEAST_CHI2_FOR_KINK else None
    best = smooth if kinked is None else max(smooth, kinked, key=map_log_evidence)
    return with_local_roughness(setup, fitter, best)


def widened_map(setup: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
    """Refit on a map that covers the currents at the fitted rotor angle.

    The first map covers them at the believed angle. Its chi2 does not matter: beyond the edge nothing is fitted.
    """
    grid, space = _widened_grid(fit), fit.model.space
    if grid == space.grid or not space.is_free:
        return fit
    return _fit_on_map(fitter, _on_grid(setup, fit, grid, space.roughness), fit)


def _fit_on_map(fitter: Fitter, model: Model, fit: Fit) -> Fit:
    """Fit a model that differs from a fit's only by its map."""
    # Free effects may have moved since the linearisation and change the current; without any, only map columns are new.
    return fitter.fit(model, None if fit.model.free else fit.linearisation, steps=2, relinearisations=0)


def _widened_grid(fit: Fit) -> EvenSpline:
    """The fit's grid, widened to all true currents where one leaves it by more than `MAX_OVERREACH`."""
    grid = fit.model.space.grid
    seen = fit.true_currents()
    low, high = min(float(i[:, 0].min()) for i in seen), max(float(i[:, 0].max()) for i in seen)
    q = max(float(np.abs(i[:, 1]).max()) for i in seen)
    tolerance = MAX_OVERREACH
    inside = max(grid.low - low, high - grid.high) <= tolerance * (grid.high - grid.low)
    if inside and q <= (1.0 + tolerance) * grid.reach:
        return grid
    return replace(grid, low=min(low, grid.low), high=max(high, grid.high), reach=max(q, grid.reach))


def is_finer_map_justified(trial: Fit, fit: Fit) -> bool:
    """Whether a fit on a finer map gains more than its degrees of freedom and the threshold require."""
    threshold = MIN_GAIN_PER_MAP_FREEDOM * max(fit.dof - trial.dof, 1.0) + MIN_GAIN_OF_FINER_MAP
    return fit.objective - trial.objective > threshold * max(trial.chi2_per_dof, 1.0)


def has_fine_grid(fit: Fit) -> bool:
    """Whether a fit's free map is finer or rougher than the usual ones."""
    space = fit.model.space
    usual = max(space.grid.cells) <= fit.criteria.fitting.intervals[-1] and bool(np.all(space.roughness <= 1.0))
    return space.is_free and not usual


def on_usual_grid(setup: DiagnosisSetup, fit: Fit) -> Model:
    """The model of a fit on the finest of the usual maps, with a kink where it has one."""
    intervals = setup.criteria.intervals[-1]
    return _on_grid(setup, fit, replace(fit.model.space.grid, cells=(intervals, intervals)), USUAL)


def _on_grid(setup: DiagnosisSetup, fit: Fit, grid: EvenSpline, roughness: Array) -> Model:
    return replace(fit.model, space=_free(setup, grid, roughness), magnetics=fit.model.magnetics.on(grid))


def _removes_much(finer: Fit, fit: Fit) -> bool:
    """Whether a finer map removes enough of the excess chi2."""
    return _excess_chi2(finer) <= (1.0 - MIN_REMOVED_SHARE_OF_FINER_MAP) * _excess_chi2(fit)


def _refine_further(setup: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
    """Refit on maps that are finer along one axis, or rougher, while one removes enough of the excess chi2."""
    while fit.chi2_per_dof > LEAST_CHI2_FOR_FINER_MAP:
        rough = fit.model.space.roughness
        finer = [(grid, rough) for grid in _finer_grids(setup, fit)]
        finer.append((fit.model.space.grid, np.minimum(MAX_ROUGHNESS_STEP * rough, MAX_ROUGHNESS_FACTOR)))
        trials = [trial for grid, r in finer if (trial := finer_map(setup, fitter, fit, grid, r))]
        better = [trial for trial in trials if _removes_much(trial, fit)]
        if not better:
            break
        fit = max(better, key=map_log_evidence)
    return fit


def with_local_roughness(setup: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
    """Refit a fine map as rough as it is from place to place, where that gains evidence."""
    if not has_fine_grid(fit):
        return fit
    return max(_with_estimated_roughness(setup, fitter, fit), fit, key=map_log_evidence)


def _with_estimated_roughness(setup: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
    return _fit_on_map(fitter, _on_grid(setup, fit, fit.model.space.grid, estimated_roughness(fit)), fit)


def with_sharpest_map(setup: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
    """Refit a fine map on the likeliest of the finest grids, as rough as it is from place to place.

    Between points a bridge's corner hardly raises chi2, by which a search chooses its maps, but the flux beyond it is
    wrong by what it leaves there. Effects keep their values. Where they leave more than ``explained`` allows, finer
    maps would adapt to that.
    """
    if not has_fine_grid(fit) or fit.chi2_per_dof - 1.0 > fit.criteria.verdict.explained_excess_chi2:
        return fit
    space, active = fit.model.space, fit.model.active
    best = fitter.fit(fit.model.with_active([replace(a, free=()) for a in active]), fit.linearisation)
    trials = [best]
    for grid in _finest_grids(setup, fit):
        finer = _fit_on_map(fitter, _on_grid(setup, best, grid, space.roughness), best)
        trials.append(_with_estimated_roughness(setup, fitter, finer))
    finest = max(trials, key=map_log_evidence)
    return fit if finest is best else fitter.relinearise(finest.model.with_active(active), finest.linearisation)


def with_kink_switched(setup: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
    """Refit on the same map with a kink at i_q = 0 where it has none, and without where it has one."""
    space = fit.model.space
    return _fit_on_map(
        fitter, _on_grid(setup, fit, replace(space.grid, kink=not space.grid.kink), space.roughness), fit
    )


def _refined_with_kink(setup: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit | None:
    """Refit on maps with a kink at i_q = 0, finer or rougher ones too; None where a kink alone removes little."""
    grid, roughness = fit.model.space.grid, fit.model.space.roughness
    kinked = None if grid.kink else finer_map(setup, fitter, fit, replace(grid, kink=True), roughness)
    if kinked is None or not _removes_much(kinked, fit):
        return None
    return _refine_further(setup, fitter, kinked)


def map_log_evidence(fit: Fit) -> float:
    """Log evidence of a fit's free map, R_s and map integrated out, up to a constant of the recording [nat].

    -1/2 (J + log det N - log det P), N the normal matrix with the prior, P the prior's own; unlike J alone it compares
    maps of different grids, roughness and kink (D. MacKay, doi:10.1162/neco.1992.4.3.415).
    """
    log_det_normal = float(np.linalg.slogdet(fit.normal)[1])
    return -0.5 * (fit.objective + log_det_normal - fit.model.space.log_det_prior)


def _finer_grids(setup: DiagnosisSetup, fit: Fit) -> list[EvenSpline]:
    """Grids that are one step finer along one axis."""
    limits, grid = setup.criteria, fit.model.space.grid
    d, q = (next((n for n in limits.sharper_intervals if n > present), present) for present in grid.cells)
    finer = [replace(grid, cells=cells) for cells in ((d, grid.cells[1]), (grid.cells[0], q)) if cells != grid.cells]
    return [trial for trial in finer if trial.size <= limits.most_map_numbers]


def _finest_grids(setup: DiagnosisSetup, fit: Fit) -> list[EvenSpline]:
    """For each resolution along i_d the grid with the finest one along i_q that `most_map_numbers` allows."""
    limits, grid = setup.criteria, fit.model.space.grid
    every = [replace(grid, cells=(d, q)) for d in limits.sharper_intervals for q in limits.sharper_intervals]
    allowed = [one for one in every if one.size <= limits.most_map_numbers]
    return [max(of_d, key=lambda one: one.cells[1]) for _, of_d in groupby(allowed, key=lambda one: one.cells[0])]


def _excess_chi2(fit: Fit) -> float:
    """chi2 per degree of freedom beyond that of noise."""
    return fit.chi2_per_dof - 1.0


def finer_map(
    setup: DiagnosisSetup, fitter: Fitter, fit: Fit, grid: EvenSpline, roughness: Array = USUAL
) -> Fit | None:
    """Refit on a finer or rougher map; None where its gain does not justify it, or it is neither.

    Parameters
    ----------
    grid : EvenSpline
        Of the finer map; with a kink where the present one has it.
    roughness : array, shape (m, n)
        As in `MapSpace`.
    """
    space = fit.model.space
    is_finer = any(n > present for n, present in zip(grid.cells, space.grid.cells, strict=True))
    if not (is_finer or np.any(roughness > space.roughness) or (grid.kink and not space.grid.kink)):
        return None
    trial = _fit_on_map(fitter, _on_grid(setup, fit, grid, roughness), fit)
    return trial if is_finer_map_justified(trial, fit) else None


def _grid(setup: DiagnosisSetup, cells: tuple[int, int]) -> EvenSpline:
    low, high, q = setup.prepared.current_range
    min_range = MIN_AXIS_RANGE * max(-low, high, q)
    return EvenSpline(min(low, -min_range), max(high, min_range), max(q, min_range), cells)


def _resistance(setup: DiagnosisSetup) -> float:
    nominal = setup.prepared.manifest.motor.stator_resistance_ohm
    return nominal if nominal is not None else _mean_resistance(setup.prepared.pieces)


def _mean_resistance(pieces: Sequence[SegmentData]) -> float:
    drop, square = 0.0, 1e-12
    for piece in pieces:
        if piece.stage is SegmentStage.RESISTANCE:
            v = to_dq(piece.signals.v_ab, 0.0).mean(axis=0)
            i = piece.signals.i_ab.mean(axis=0)
            drop, square = drop + float(v @ i), square + float(i @ i)
    return max(drop / square, 1e-4) if drop > 0.0 else 1.0
