"""Random errors that are constant within a segment, with variances estimated by restricted likelihood.

A current sensor's offset drifts during an experiment, and a constant voltage has the rounding error of the modulator's
timer (a varying voltage is dithered). With e the whitened residual of the
training segments, X all columns (R_s, the map, every effect of the library) and U the columns of these two errors in
each segment, per standard deviation,

    e = X b + U d + noise,    d ~ N(0, 1),    V = 1 + U U^T
    -2 log L = log det V + log det (X^T V^-1 X + P) + e^T V^-1 e - h^T (X^T V^-1 X + P)^-1 h

with the priors P and the gradient h at b = 0: the restricted likelihood (H. D. Patterson, R. Thompson, Biometrika 58
(1971), doi:10.1093/biomet/58.3.545), in which errors that the map or an effect can explain are not scatter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import Library
from orchestrator.diagnosis.fitting.fit import Fitter, absent_columns
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.nuisances.pwm_quantiser import leg_step_v, nominal_leg_step_of, scatter_sizes, scatter_units
from orchestrator.diagnosis.nuisances.quantiser_search import MAX_TIMER_STEP_S
from orchestrator.numerics.types import Array
from protocols import ModelNoise, Remark

MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH: float = 1.0
"""chi2 - 1 up to which a search takes its effects as complete; beyond, a form must be wrong."""
MAX_OFFSET_SCATTER: float = 0.002
"""Largest offset scatter between segments (rms), relative to the rated current, that counts as noise. A sound sensor
drifts that much in warm-up and over minutes; more is a fault that has to be found."""

MAX_SCATTER_CHANGE: float = 0.2
"""Relative difference of two scatters that does not matter for a fit."""
SEARCH_DECADES = tuple(range(-5, 1))
"""Decades of the scatter's standard deviations [A] and [V] where a search starts: from far below a sensor's noise."""
MAX_DECADE = 6.0
"""Largest decade in a search; beyond, the data carry no information on a scatter."""


@dataclass(frozen=True)
class Scatter:
    """Estimated scatter between segments.

    Attributes
    ----------
    noise : ModelNoise
        Model-error noise with the components that the data require.
    chi2 : float
        chi2 per degree of freedom with the scatter as noise, all effects adapting to first order.
    """

    noise: ModelNoise
    chi2: float


@dataclass(frozen=True)
class _Segment:
    """One segment's errors: information matrix, cross information with all columns, gradient, and `scatter_units`."""

    information: Array
    shared: Array
    pull: Array
    units: Array
    pwm_hz: float


@dataclass(frozen=True)
class Likelihood:
    """Restricted likelihood of a scatter; costs are minus twice its logarithm."""

    segments: Sequence[_Segment]
    normal: Array
    gradient: Array
    chi2: float
    dof: float

    @property
    def dwells(self) -> int:
        """Number of dwells."""
        return sum(len(segment.information) // 2 - 1 for segment in self.segments)

    def cost(self, noise: ModelNoise) -> float:
        """Minus twice the log likelihood of a scatter."""
        return sum(self._parts(noise))

    def chi2_per_dof(self, noise: ModelNoise) -> float:
        return self._parts(noise)[0] / self.dof

    def chance(self, noise: ModelNoise) -> float:
        """Probability that equal voltage scatters differ so much between PWM frequencies (Fisher's F test)."""
        from scipy.stats import f

        if noise.voltage_scatter_v == 0.0:
            return 1.0
        roots, factors, normal, gradient = self._reduced(noise)[:4]
        follow = -np.linalg.solve(normal, gradient)
        drawn: dict[float, list[float]] = {}
        for segment, root, factor in zip(self.segments, roots, factors, strict=True):
            deviates = np.linalg.solve(factor.T, root[:, :-1] @ follow + root[:, -1])
            drawn.setdefault(segment.pwm_hz, []).extend(deviates[2:] ** 2)
        groups = [np.array(squares) for squares in drawn.values() if squares]
        chances = [1.0]
        for k, squares in enumerate(groups):
            others = [g for j, g in enumerate(groups) if j != k]
            if others:
                rest = np.concatenate(others)
                ratio = squares.mean() / max(float(rest.mean()), np.finfo(np.float64).tiny)
                chances.append(float(f.sf(ratio, len(squares), len(rest))))
        return min(chances)

    def held_volts(self, noise: ModelNoise) -> tuple[Array, Array]:
        """Normal matrix and gradient of voltages in each dwell, with this scatter as noise and all else adapting.

        Returns
        -------
        normal : array, shape (2 dwells, 2 dwells)
        gradient : array, shape (2 dwells,)
        """
        _, _, normal, gradient, _ = self._reduced(noise)
        information, shared, pull = [], [], []
        for segment in self.segments:
            scale = scatter_sizes(segment.units, noise)
            inside = np.linalg.inv(np.eye(len(scale)) + scale[:, None] * segment.information * scale)
            less = np.eye(len(scale)) - segment.information @ (scale[:, None] * inside * scale)
            information.append((less @ segment.information)[2:, 2:])
            shared.append((less @ segment.shared)[2:])
            pull.append((less @ segment.pull)[2:])
        shared_rows = np.concatenate(shared)
        follow = np.linalg.solve(normal, np.column_stack([shared_rows.T, gradient]))
        volts = np.zeros((len(shared_rows), len(shared_rows)))
        at = 0
        for block in information:
            volts[at : at + len(block), at : at + len(block)] = block
            at += len(block)
        return volts - shared_rows @ follow[:, :-1], np.concatenate(pull) - shared_rows @ follow[:, -1]

    def with_volts(self, volts: Array) -> Likelihood:
        """The likelihood with voltages (2 dwells,) added to the equations."""
        at, moved, shift = 0, list[_Segment](), np.zeros_like(self.gradient)
        squares = 0.0
        for segment in self.segments:
            count = len(segment.information) - 2
            added = np.concatenate([np.zeros(2), volts[at : at + count]])
            at += count
            moved.append(replace(segment, pull=segment.pull + segment.information @ added))
            shift += segment.shared.T @ added
            squares += float(added @ (2.0 * segment.pull + segment.information @ added))
        return replace(self, segments=moved, gradient=self.gradient + shift, chi2=self.chi2 + squares)

    def most_likely(self, which: tuple[bool, bool], *, near: ModelNoise | None = None) -> ModelNoise:
        """The likeliest scatter; of its two standard deviations those not in `which` are zero.

        The search starts at `near`, or scans all decades.
        """
        from scipy.optimize import minimize

        def noise(decades: Array) -> ModelNoise:
            given = iter(decades.tolist())
            offset, voltage = (10.0 ** min(next(given), MAX_DECADE) if is_free else 0.0 for is_free in which)
            return ModelNoise(offset_scatter_a=offset, voltage_scatter_v=voltage)

        def cost(decades: Array) -> float:
            return self.cost(noise(decades))

        if near is None:
            grid = [np.array(place, dtype=np.float64) for place in product(SEARCH_DECADES, repeat=sum(which))]
            start = min(grid, key=cost)
        else:
            sizes = np.array([near.offset_scatter_a, near.voltage_scatter_v])[list(which)]
            start = np.log10(np.maximum(sizes, 10.0 ** SEARCH_DECADES[0]))
        found = minimize(cost, start, method="Nelder-Mead", options={"xatol": 0.01, "fatol": 0.1})
        return noise(np.asarray(found.x))

    @cached_property
    def _groups(self) -> list[tuple[list[int], Array, Array]]:
        """Segments by number of dwells: their indices, information, and cross information with columns and gradient."""
        sizes = [len(segment.information) for segment in self.segments]
        groups = []
        for size in dict.fromkeys(sizes):
            places = [k for k, other in enumerate(sizes) if other == size]
            group = [self.segments[k] for k in places]
            shared = np.stack([np.column_stack([segment.shared, segment.pull]) for segment in group])
            groups.append((places, np.stack([segment.information for segment in group]), shared))
        return groups

    def _reduced(self, noise: ModelNoise) -> tuple[list[Array], list[Array], Array, Array, float]:
        """Each segment's scales and factor, then the normal matrix, gradient and chi2 with the scatter eliminated."""
        parts = dict[int, tuple[Array, Array]]()
        for places, information, shared in self._groups:
            scale = np.array([scatter_sizes(self.segments[k].units, noise) for k in places])
            inside = np.eye(scale.shape[1]) + scale[:, :, None] * information * scale[:, None, :]
            factor = np.linalg.cholesky(inside)
            root = np.linalg.solve(factor, scale[:, :, None] * shared)
            parts.update(zip(places, zip(root, factor, strict=True), strict=True))
        roots, factors = ([parts[k][which] for k in range(len(parts))] for which in (0, 1))
        taken = np.concatenate(roots)
        normal: Array = self.normal - taken[:, :-1].T @ taken[:, :-1]
        gradient: Array = self.gradient - taken[:, :-1].T @ taken[:, -1]
        return roots, factors, normal, gradient, self.chi2 - float(taken[:, -1] @ taken[:, -1])

    def _parts(self, noise: ModelNoise) -> tuple[float, float]:
        """chi2 with the scatter as noise, and the sum of the log determinants."""
        _, factors, normal, gradient, chi2 = self._reduced(noise)
        log_det = 2.0 * sum(float(np.log(np.diag(factor)).sum()) for factor in factors)
        squares = chi2 - float(gradient @ np.linalg.solve(normal, gradient))
        return squares, log_det + float(np.linalg.slogdet(normal)[1])


def with_scatter(
    setup: DiagnosisSetup, fitter: Fitter, fit: Fit, library: Library, *, max_chi2: float = math.inf
) -> DiagnosisSetup | None:
    """The setup with a scatter around a fit as noise, if sensors and modulator may have it; else None.

    Parameters
    ----------
    max_chi2 : float
        chi2 per degree of freedom that the scatter and effects to first order may leave.
    """
    scatter = scatter_of(fitter, fit, library)
    noise = scatter.noise
    small = noise.offset_scatter_a <= MAX_OFFSET_SCATTER * setup.current_a
    is_plausible = small and quantiser_step_s(noise, setup) <= MAX_TIMER_STEP_S
    return setup.with_noise(noise) if noise.scatters and is_plausible and scatter.chi2 <= max_chi2 else None


def is_same_scatter(noise: ModelNoise, other: ModelNoise) -> bool:
    """Whether two scatters differ too little to matter for a fit."""
    pairs = (noise.offset_scatter_a, other.offset_scatter_a), (noise.voltage_scatter_v, other.voltage_scatter_v)
    return all(abs(a - b) <= MAX_SCATTER_CHANGE * max(a, b) for a, b in pairs)


def quantiser_step_s(noise: ModelNoise, setup: DiagnosisSetup) -> float:
    """The step of a modulator's timer that causes a scatter of held voltages [s].

    A step of t_q moves both edges of a symmetric carrier's pulse, and a leg's mean voltage by 2 t_q f V_dc.
    """
    return leg_step_v(noise.voltage_scatter_v) / nominal_leg_step_of(1.0, setup.prepared.manifest.drive)


def scatter_of(fitter: Fitter, fit: Fit, library: Library) -> Scatter:
    """The likeliest scatter around a fit's model, all effects of the library adapting.

    Parameters
    ----------
    fitter : Fitter
        Scatter that is already part of its noise is not estimated again.
    """
    likelihood, min_gain = likelihood_of(fitter, fit, library), 2.0 * fit.criteria.selection.log_evidence
    # The simpler scatter is kept unless the data require another.
    best = ModelNoise()
    cost = likelihood.cost(best)
    for which in ((True, False), (False, True), (True, True)):
        found = likelihood.most_likely(which)
        # A timer's step in volts is proportional to the PWM frequency; voltages that scatter otherwise are no timer's.
        if likelihood.chance(found) <= fit.criteria.uncertainty.scatter_chance:
            continue
        if cost - likelihood.cost(found) > min_gain:
            best, cost = found, likelihood.cost(found)
    return Scatter(best, likelihood.chi2_per_dof(best))


def likelihood_of(fitter: Fitter, fit: Fit, library: Library) -> Likelihood:
    """The likelihood of any scatter around a fit's model, all effects of the library adapting.

    Parameters
    ----------
    fitter : Fitter
        Scatter that is already part of its noise is excluded.
    """
    fitter = fitter.with_noise(ModelNoise())
    absent = absent_columns([c for c in library if c.name not in fit.model.names])
    # A fit of the whole recording has no columns for a part of it.
    known = fit if fit.prepared.rows == fitter.prepared.rows else None
    loose = fitter.relinearise(fit.model, None, absent, known=known)
    normal, pulls = loose.system()
    width, free = loose.normal.shape[0], loose.model.free
    gradient = pulls.sum(axis=0)
    # R_s and the map are at their minimum: their gradient, prior included, is zero.
    gradient[:width] = 0.0
    gradient[width : width + len(free)] += [a.prior_residual(n) for a, n in free]
    segments = []
    common: dict[int, Array] = {}
    for linearisation in loose.linearisation.batches:
        if not linearisation.batch.pieces[0].held_out:
            common |= dict(
                zip(linearisation.batch.places, fitter.equations.common(loose.model, linearisation), strict=True)
            )
    pieces = [(piece, common[k]) for k, piece in enumerate(loose.prepared.pieces) if not piece.held_out]
    for (piece, u), (linear, d, e) in zip(pieces, loose.training(), strict=True):
        shared, pwm_hz = u.T @ np.column_stack([linear, d]), piece.signals.pwm_frequency_hz
        segments.append(_Segment(u.T @ u, shared, u.T @ e, scatter_units(piece), pwm_hz))
    return Likelihood(segments, normal, gradient, loose.chi2, loose.dof)


def nuisance_remarks(setup: DiagnosisSetup) -> list[Remark]:
    """Remarks on the scatters that are modelled as noise, and on the timer whose rounding is corrected."""
    scatter, remarks = setup.fitter.noise.of_model, list[Remark]()
    if scatter.offset_scatter_a > 0.0:
        text = "the readings' zero differs as if by {scatter_ma:.2g} mA rms between segments: modelled as noise"
        remarks.append(Remark.of("offset_scatter", text, scatter_ma=1e3 * scatter.offset_scatter_a))
    timer = setup.prepared.quantiser
    if timer is not None:
        text = "the modulator's timer rounds edges to {step_ns:.4g} ns, a leg by up to {leg_mv:.2g} mV: corrected"
        sizes = {
            "step_ns": 1e9 * timer.step_s,
            "leg_mv": 0.5e3 * nominal_leg_step_of(timer.step_s, setup.prepared.manifest.drive),
        }
        remarks.append(Remark.of("timer", text, **sizes))
    if scatter.voltage_scatter_v > 0.0 and timer is not None:
        text = "held voltages are off as if by another {scatter_mv:.2g} mV rms each: modelled as noise"
        remarks.append(Remark.of("voltage_scatter", text, scatter_mv=1e3 * scatter.voltage_scatter_v))
    elif scatter.voltage_scatter_v > 0.0:
        text = (
            "held voltages are off by {scatter_mv:.2g} mV rms, as by a timer's step of {step_ns:.2g} ns: modelled "
            "as noise"
        )
        sizes = {"scatter_mv": 1e3 * scatter.voltage_scatter_v, "step_ns": 1e9 * quantiser_step_s(scatter, setup)}
        remarks.append(Remark.of("voltage_scatter", text, **sizes))
    return remarks
