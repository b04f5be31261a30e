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
from orchestrator.diagnosis.fitting.gauss_newton import midway, moved_by, newton_step
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
from protocols import ModelNoise

MIN_GAIN: float = 0.2
"""Fall of the objective below which a step is not worth its evaluation: a tenth in log evidence."""
OBJECTIVE_SLACK: float = 0.05
"""Rise of the objective that rounding and a relinearised noise covariance explain."""
MIN_RELINEARISATION_CHANGE: float = 1e-3
"""Relative change of chi2 below which relinearisation ends."""
FIRST_DAMPING: float = 0.1
"""Levenberg-Marquardt damping with which a failed step is tried again; it grows tenfold each time."""
MIN_DAMPING: float = 2e-3
"""Damping falls to a tenth after each good step, and to zero below this value."""
MAX_DAMPING: float = 50.0
"""Damping beyond which no further step is tried."""
GOOD_REDUCTION_RATIO: float = 0.75
"""Ratio of actual to predicted reduction of a damped step from which the next one may be damped less."""
MIN_PREDICTED_REDUCTION: float = 2.0
"""Predicted reduction below which a failed step is not tried again: one in log evidence."""
MAX_RETURNS: int = 5
"""Steps after a failed one in which a fit may come back to a curved valley further on."""
MAX_RISE: float = 2.0
"""Rise of the objective by relinearisation that a descent may end with: one in log evidence."""
MAX_HALVINGS: int = 4
"""Halvings of a descent whose end does not bear relinearisation."""
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
        steps: int = 8,
        relinearisations: int = 2,
        tolerance: float = 1e-4,
    ) -> Fit:
        """Fit R_s, the map and every free parameter, starting at the model's values.

        Parameters
        ----------
        linearisation : Linearisation, optional
            An earlier fit's; reused if it has the same map, else renewed as far as the map changes it.
        steps : int
            Maximum number of Gauss-Newton steps with one linearisation.
        relinearisations : int
            Maximum number of relinearisations.
        tolerance : float
            Fall of the objective over the excess chi2, below which the fit ends.
        """
        if linearisation is not None and linearisation.space is model.space:
            start = self.evaluate(model, linearisation)
        else:
            start = self.relinearise(model, linearisation)
        best = self._descend(start, steps, tolerance)
        for _ in range(relinearisations):
            old = best
            best = start = self.renewed(best, start.objective)
            best = self._descend(best, steps, tolerance)
            if abs(best.chi2 - old.chi2) < MIN_RELINEARISATION_CHANGE * best.chi2:
                break
        return best

    def renewed(self, fit: Fit, bearable: float) -> Fit:
        """The fit relinearised, or a point nearer to where it was linearised, if the objective rises above `bearable`.

        A position that follows the torque changes the map, which changes the torque: far from where this was
        linearised, the descent may end at a model that is worse than none. Steps are halved while that helps.
        """
        renewed = self.relinearise(fit.model, fit.linearisation)
        model, bearable = fit.model, bearable + max(MAX_RISE, MIN_RELINEARISATION_CHANGE * fit.chi2)
        for _ in range(MAX_HALVINGS if renewed.objective > bearable else 0):
            model = midway(fit.linearisation.model, model)
            nearer = self.relinearise(model, fit.linearisation)
            if nearer.objective >= renewed.objective:
                break
            renewed = nearer
        return renewed

    def _descend(self, best: Fit, steps: int, tolerance: float) -> Fit:
        damping = 0.0
        for _ in range(steps if best.model.free else 0):
            system = best.projected()
            min_gain = MIN_GAIN + tolerance * max(best.chi2 - best.dof, 0.0)
            predicted = newton_step(best, system, 0.0)[1]
            if predicted < min_gain:
                break
            first_damping = damping
            while True:
                move, damped_reduction = newton_step(best, system, damping)
                trial = self.correct_step(self.evaluate(moved_by(best.model, move), best.linearisation), best.objective)
                missed = trial.objective >= best.objective + OBJECTIVE_SLACK
                if not missed or damping > MAX_DAMPING or predicted < MIN_PREDICTED_REDUCTION:
                    break
                damping = 10.0 * damping or FIRST_DAMPING
            gain = best.objective - trial.objective
            if gain > -OBJECTIVE_SLACK:
                best = trial
            if gain < min_gain:
                break
            # A step that needed more damping is usually followed by one that does.
            if damping == first_damping and gain > GOOD_REDUCTION_RATIO * damped_reduction:
                damping = 0.1 * damping if damping > MIN_DAMPING else 0.0
        return best

    def correct_step(self, trial: Fit, wanted: float) -> Fit:
        """Correct a failed trial step that has left a curved valley of the objective.

        An effect's amplitude and shape lie along such a valley (a heating's size and its time constant), as do the
        parameters of a flexible form. First only the amplitudes are refitted, in which the residual is nearly linear;
        then full steps follow, while each one's predicted reduction reaches `wanted`.
        """
        sizes = np.array([name in active.candidate.amplitudes for active, name in trial.model.free])
        for which in (sizes, *[None] * MAX_RETURNS):
            if trial.objective < wanted:
                break
            move, predicted = newton_step(trial, trial.projected(), 0.0, which)
            if which is None and trial.objective - predicted > wanted:
                break
            again = self.evaluate(moved_by(trial.model, move), trial.linearisation)
            if again.objective >= trial.objective:
                break
            trial = again
        return trial

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
        linearisation = Linearisation(model, self.noise, tuple(linearisations), np.zeros((0, 0)))
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
