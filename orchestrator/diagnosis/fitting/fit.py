"""Fit of the model to the weak form: R_s, the co-energy's coefficients, and the parameters of active effects.

The equations are linear in R_s and the coefficients, so these are solved for exactly at every step (variable
projection); the effects' parameters move by Gauss-Newton with unit normal priors. What changes little from step
to step (the map's columns, the noise, the flux effects see) is a `Linearisation`, renewed once the model has moved;
the residual is always evaluated exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from orchestrator.diagnosis.criteria import FittingCriteria
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm
from orchestrator.diagnosis.fitting.columns import (
    PROBE_EVERY,
    ColumnPlan,
    ColumnProbe,
    column_plan,
    known_responses,
    probe_segments,
)
from orchestrator.diagnosis.fitting.equations import BatchState, WeakFormEquations
from orchestrator.diagnosis.fitting.gauss_newton import MAX_STEP, MIN_STEP, STEP_FACTOR, frozen_steps
from orchestrator.diagnosis.fitting.model import (
    BatchLinearisation,
    Fit,
    Linearisation,
    MapSpace,
    Model,
    Responses,
    SegmentRows,
)
from orchestrator.diagnosis.fitting.progress import Budget, SearchRecorder
from orchestrator.diagnosis.fitting.solution import solved
from orchestrator.diagnosis.fitting.workers import Executor
from orchestrator.diagnosis.weak_form.batches import RecordingBatches, SegmentBatch, in_batches
from orchestrator.diagnosis.weak_form.noise import SensorNoise
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from orchestrator.formatting.quantities import number, plural
from protocols import ModelNoise

MIN_GAIN: float = 0.2
"""Fall of the objective below which a step is not worth its evaluation: a tenth in log evidence."""
MIN_RELINEARISATION_CHANGE: float = 1e-3
"""Relative change of chi2 below which relinearisation ends."""
MIN_JOINT_GAIN: float = 2.0
"""Fall of the objective below which a round with all effects ends; a round costs as much as a fit of one effect."""
FEW_COLUMNS: int = 6
"""Columns up to which all are renewed without a probe."""
COLUMNS_PER_EVALUATION: int = 3
"""Cost of an evaluation without effects, in columns."""

Columns = Sequence[tuple[EffectTerm, str]]
"""Pairs of an effect and a parameter to differentiate by."""
_Linearised = tuple[SegmentBatch, BatchLinearisation | None]
"""A batch, and its linearisation in an earlier evaluation."""


@dataclass
class Fitter:
    """One recording, ready to be fitted again and again.

    Attributes
    ----------
    prepared : PreparedRecording
    noise : SensorNoise
    pm_flux_wb : float
    budget : Budget
        Computation budget of all fits together; a search ends when it is exhausted.
    poll : callable
        Called before each evaluation; what it raises ends the fit.
    tell : callable
        Called with a short description of the current operation.
    executor : Executor
        Evaluates the batches, serially or in threads.
    trace : SearchRecorder
        Records every model that is tried.
    batches : RecordingBatches
        The segments grouped for evaluation; regrouped where `prepared` has other segments.
    equations : WeakFormEquations
    """

    prepared: PreparedRecording
    noise: SensorNoise
    pm_flux_wb: float
    budget: Budget = field(default_factory=Budget)
    poll: Callable[[], None] = lambda: None
    tell: Callable[[str], None] = lambda _: None
    executor: Executor = field(default_factory=Executor)
    trace: SearchRecorder = field(default_factory=SearchRecorder)
    batches: RecordingBatches = field(default_factory=RecordingBatches)
    equations: WeakFormEquations = field(init=False)

    def __post_init__(self) -> None:
        if self.batches.pieces is not self.prepared.pieces:
            self.batches = in_batches(self.prepared.pieces, probe_segments(self.prepared.pieces))
        self.equations = WeakFormEquations(self.noise, self.pm_flux_wb, self.prepared.ripples)

    def begin(self, text: str, evaluations: float) -> None:
        """Report the beginning of a phase, and an upper bound of the remaining time.

        Parameters
        ----------
        evaluations : float
            Expected remaining cost, in evaluations of the first model on the whole recording.
        """
        self.budget.expect(evaluations * self.trace.samples)
        self.under_way(text)

    def under_way(self, text: str) -> None:
        """Report the current operation, with the remaining time where it is known."""
        self.tell(text + self.budget.remaining_time)

    def with_noise(self, of_model: ModelNoise) -> Fitter:
        """A copy whose equations also have this model-error noise; the budget is shared."""
        return replace(self, noise=replace(self.noise, of_model=of_model))

    @property
    def criteria(self) -> FittingCriteria:
        return self.prepared.criteria.fitting

    def fit(
        self,
        model: Model,
        linearisation: Linearisation | None = None,
        *,
        steps: int = 16,
        relinearisations: int = 2,
        tolerance: float = 1e-4,
    ) -> Fit:
        """Fit R_s, the map and every free parameter, starting at the model's values.

        Parameters
        ----------
        linearisation : Linearisation, optional
            An earlier fit's; reused if it has the same map, else renewed as far as the map changes it.
        steps : int
            Maximum number of times that the columns are renewed with one linearisation.
        relinearisations : int
            Maximum number of relinearisations.
        tolerance : float
            Fall of the objective over the excess chi2, below which the fit ends.
        """
        if linearisation is not None and linearisation.space is model.space:
            best = self.evaluate(model, linearisation)
        else:
            best = self.relinearise(model, linearisation)
        best = self._descend(best, steps, tolerance)
        for _ in range(relinearisations):
            old = best
            known = best if best.model.free else None
            best = self._descend(self.relinearise(best.model, best.linearisation, known=known), steps, tolerance)
            if abs(best.chi2 - old.chi2) < MIN_RELINEARISATION_CHANGE * best.chi2:
                break
        return best

    def _descend(self, best: Fit, steps: int, tolerance: float) -> Fit:
        """At most so many times frozen steps, each with new columns."""
        for _ in range(steps if best.model.free else 0):
            min_gain = MIN_GAIN + tolerance * max(best.chi2 - best.dof, 0.0)
            trial, _ = frozen_steps(best, self.with_columns_of, min_gain)
            if trial is best:
                break
            renewed = self.evaluate(trial.model, trial.linearisation, known=trial)
            gain, best = best.objective - renewed.objective, renewed
            if gain < min_gain:
                break
        return best

    def with_columns_of(self, model: Model, known: Fit) -> Fit:
        """`evaluate` with all columns of a fit, which has the same parameters."""
        return self.evaluate(model, known.linearisation, known=known, renew=False)

    def linearise(self, model: Model) -> Linearisation:
        """Linearise at the model."""
        states = self.executor.map(lambda batch: self.equations.relinearise(model, batch, None), self.batches.all)
        return self._linearisation_of(model, [state.linearisation for state in states], None)

    def relinearise(
        self,
        model: Model,
        old: Linearisation | None = None,
        extra: Sequence[tuple[EffectTerm, str]] = (),
        *,
        held: bool = False,
        known: Fit | None = None,
    ) -> Fit:
        """`linearise` and `evaluate` in one pass through the effects.

        Parameters
        ----------
        held : bool
            R_s and the map also keep the model's values, and there are no columns.
        """
        self.poll()
        wanted = [] if held else [*model.free, *extra]
        old = self._reusable(model, old)
        linearisations, rows, responses = self._rows(model, old, True, wanted, known)
        linearisation = self._linearisation_of(model, linearisations, old)
        fit = solved(self.prepared, model, linearisation, rows, [(a.name, n) for a, n in wanted], held)
        return replace(fit, responses=responses)

    def evaluate(
        self,
        model: Model,
        linearisation: Linearisation,
        extra: Sequence[tuple[EffectTerm, str]] = (),
        *,
        known: Fit | None = None,
        renew: bool = True,
    ) -> Fit:
        """Solve for R_s and the map with all effect parameters fixed; `extra` adds columns.

        Parameters
        ----------
        known : Fit, optional
            An earlier fit, whose columns are reused where they have not changed.
        renew : bool
            False: reuse all columns of `known`, which has the same parameters.
        """
        self.poll()
        wanted = [*model.free, *extra] if known is None or renew else []
        _, rows, responses = self._rows(model, linearisation, False, wanted, known)
        fit = solved(self.prepared, model, linearisation, rows, [(a.name, n) for a, n in wanted], held=False)
        if known is not None and not renew:
            return replace(fit, columns=known.columns, parameters=known.parameters, responses=known.responses)
        return replace(fit, responses=responses)

    def _reusable(self, model: Model, old: Linearisation | None) -> Linearisation | None:
        """`old` if it has the same noise, segments and freedom of the map, else None."""
        if old is None or old.noise is not self.noise or not _is_equally_free(old.space, model.space):
            return None
        ours, theirs = self.batches.all, [one.batch for one in old.batches]
        is_same = len(ours) == len(theirs) and all(a is b for a, b in zip(ours, theirs, strict=True))
        return old if is_same else None

    def _linearisation_of(
        self, model: Model, linearisations: Sequence[BatchLinearisation], old: Linearisation | None
    ) -> Linearisation:
        linearisation = Linearisation(model.space, self.noise, tuple(linearisations), np.zeros((0, 0)))
        pairs = zip(linearisation.pieces, old.pieces, strict=True) if old is not None else ()
        if old is not None and all(a.white_basis is b.white_basis for a, b in pairs):
            return replace(linearisation, gram=old.gram)
        free = model.space.directions.shape[1]
        gram = np.zeros((free, free))
        for piece, segment_linearisation in zip(self.prepared.pieces, linearisation.pieces, strict=True):
            if not piece.held_out:
                gram += segment_linearisation.white_basis.T @ segment_linearisation.white_basis
        return replace(linearisation, gram=gram)

    def _state(self, model: Model, one: _Linearised, renew: bool) -> BatchState:
        """A batch at the model, linearised anew where the model has moved, else with the earlier linearisation."""
        batch, before = one
        if renew or before is None:
            return self.equations.relinearise(model, batch, before)
        return self.equations.at(model, before)

    def _rows(
        self, model: Model, linearisation: Linearisation | None, renew: bool, wanted: Columns, known: Fit | None
    ) -> tuple[list[BatchLinearisation], list[SegmentRows], Responses]:
        """Each batch's linearisation, each segment's equations (with columns unless held out), and the responses."""
        samples = sum(len(p.signals.v_dc) for p in self.prepared.pieces)
        self.budget.spend(samples * COLUMNS_PER_EVALUATION)
        batches, earlier = self.batches.all, None if linearisation is None else linearisation.batches
        ours = list(zip(batches, earlier or [None] * len(batches), strict=True))
        if len(wanted) > FEW_COLUMNS:
            return self._rows_by_plan(model, ours, renew, wanted, known, samples)
        self.budget.spend(samples * len(wanted))

        def evaluate(one: _Linearised) -> tuple[BatchLinearisation, list[SegmentRows]]:
            state = self._state(model, one, renew)
            return state.linearisation, self.equations.rows(state, () if state.is_held_out else wanted)

        results = self.executor.map(evaluate, ours)
        responses = Responses() if known is None else known.responses
        return [linearisation for linearisation, _ in results], _in_order(results), responses

    def _rows_by_plan(
        self,
        model: Model,
        ours: Sequence[_Linearised],
        renew: bool,
        wanted: Columns,
        known: Fit | None,
        samples: int,
    ) -> tuple[list[BatchLinearisation], list[SegmentRows], Responses]:
        """`_rows` that reuses the known fit's columns which have not changed on a few segments evaluated first."""
        names = [(a.name, n) for a, n in wanted]
        before = known_responses(model, known)
        answering = [before.of.get(n) for n in names]
        first, later = ours[: len(self.batches.probes)], ours[len(self.batches.probes) :]

        def probe(one: _Linearised) -> tuple[BatchLinearisation, list[SegmentRows], list[ColumnProbe]]:
            state = self._state(model, one, renew)
            return state.linearisation, *self.equations.probed(state, wanted, answering)

        probed = self.executor.map(probe, first)
        probes = {k: p for one, _, found in probed for k, p in zip(one.batch.places, found, strict=True)}
        plan = column_plan(names, probes, known, before.of)
        moved, inner = [wanted[k] for k in plan.anew], [plan.answering[k] for k in plan.anew]
        self.budget.spend(samples * (len(moved) + len(wanted) / PROBE_EVERY))

        def complete(one: _Linearised) -> tuple[BatchLinearisation, list[SegmentRows]]:
            state = self._state(model, one, renew)
            if state.is_held_out:
                return state.linearisation, self.equations.rows(state)
            rows = zip(state.batch.places, self.equations.rows(state, moved, inner), strict=True)
            return state.linearisation, [_with_columns(row, plan, known, k) for k, row in rows]

        results = [*((one, rows) for one, rows, _ in probed), *self.executor.map(complete, later)]
        responses = Responses({**before.of, **dict(zip(names, plan.answering, strict=True))}, before.sizes)
        return [linearisation for linearisation, _ in results], _in_order(results), responses

    def hold(self, model: Model) -> Fit:
        """Evaluate a model without fitting anything.

        The degrees of freedom of chi2 are those of a fit with the same free parameters.
        """
        return self.relinearise(model, held=True)


def fit_with_frozen_jacobian(
    fitter: Fitter, model: Model, *, rounds: int, tolerance: float, known: Fit | None = None
) -> Fit:
    """Fit many effects: columns and linearisation are renewed together, and a round that does not hold is undone.

    Parameters
    ----------
    known : Fit, optional
        Fit of a similar model, whose columns are reused where they have not changed.
    rounds : int
        Number of relinearisations, each with new columns.
    tolerance : float
        Fall of the objective in a round over the excess chi2, below which the fit ends.
    """
    radius = widest = MAX_STEP
    if known is not None and known.model.space is not model.space:
        known = None
    # Slightly old columns do no harm; a linearisation older than its map leads away from the minimum.
    best = fitter.relinearise(model, known.linearisation if known else None, known=known)
    for _ in range(rounds if model.free else 0):
        fitter.under_way(f"{plural(len(model.active), 'effect')} together: chi2 {number(best.chi2_per_dof)}")
        min_gain = MIN_JOINT_GAIN + tolerance * max(best.chi2 - best.dof, 0.0)
        trial, radius = frozen_steps(best, fitter.with_columns_of, min_gain, min(radius, widest), widest)
        if trial is best:
            break
        renewed = fitter.relinearise(trial.model, best.linearisation, known=trial)
        gain = best.objective - renewed.objective
        if gain < 0.0:
            # The linearisation does not hold that far; repeating the steps would not help.
            widest = STEP_FACTOR * min(radius, widest)
            if widest < MIN_STEP:
                break
            continue
        best = renewed
        if gain < min_gain:
            break
    return best


def trial_step(fitter: Fitter, model: Model, known: Fit) -> Fit:
    """Improve a model similar to an earlier fit's with that fit's columns and linearisation."""
    best = fitter.evaluate(model, known.linearisation, known=known)
    return frozen_steps(best, fitter.with_columns_of, MIN_GAIN)[0]


def _in_order(results: Sequence[tuple[BatchLinearisation, Sequence[SegmentRows]]]) -> list[SegmentRows]:
    """Each segment's equations, in the recording's order."""
    rows = {k: row for one, found in results for k, row in zip(one.batch.places, found, strict=True)}
    return [rows[k] for k in sorted(rows)]


def _with_columns(row: SegmentRows, plan: ColumnPlan, known: Fit | None, k: int) -> SegmentRows:
    """Segment k's equations with all columns: those evaluated now, and the known fit's."""
    columns = plan.whole(row.columns, None if known is None else known.columns[k])
    return replace(row, white=np.column_stack([row.white[:, :2], columns]))


def _is_equally_free(one: MapSpace, other: MapSpace) -> bool:
    """Whether the basis columns of one map serve the other: both are free, or they are the same object."""
    return one is other or (one.is_free and other.is_free)


def absent_columns(candidates: Sequence[CandidateEffect]) -> list[tuple[EffectTerm, str]]:
    """Every amplitude of effects that are not in the model, for `Fitter.evaluate`'s `extra`."""
    return [(c.absent(), n) for c in candidates for n in c.amplitudes]
