"""Fit of the model to the weak form: R_s, the co-energy's coefficients, and the parameters of active effects.

The equations are linear in R_s and the coefficients, so these are solved for exactly at every step (variable
projection); the effects' parameters move by Gauss-Newton with unit normal priors. What changes little from step
to step (the map's columns, the noise, the flux that effects see) is a `Frame`, renewed when the model has moved:
the equations themselves are always evaluated where the model stands. Decides nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from orchestrator.diagnosis.criteria import FittingCriteria
from orchestrator.diagnosis.fitting.candidates import Active, Candidate
from orchestrator.diagnosis.fitting.columns import answers_so_far, column_plan, probed_segments
from orchestrator.diagnosis.fitting.gauss_newton import moved_by, newton_step
from orchestrator.diagnosis.fitting.model import Answers, Fit, Frame, Model, SegmentRows
from orchestrator.diagnosis.fitting.segment_equations import SegmentEquations
from orchestrator.diagnosis.fitting.solution import solved
from orchestrator.diagnosis.weak_form.noise import SensorNoise
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from protocols import ModelNoise


@dataclass
class Effort:
    """How much was computed, in samples times columns: the same on every machine, unlike time."""

    most: float = math.inf
    spent: float = 0.0

    @property
    def exhausted(self) -> bool:
        return self.spent > self.most


@dataclass
class Fitter:
    """One recording, ready to be fitted again and again.

    Attributes
    ----------
    prepared : PreparedRecording
    noise : SensorNoise
    pm_flux_wb : float
    effort : Effort
        Of all fits; a search ends where it is exhausted.
    poll : callable
        Called before each evaluation; what it raises ends the fit.
    tell : callable
        Called with what is under way, in a few words.
    equations : SegmentEquations
    """

    prepared: PreparedRecording
    noise: SensorNoise
    pm_flux_wb: float
    effort: Effort = field(default_factory=Effort)
    poll: Callable[[], None] = lambda: None
    tell: Callable[[str], None] = lambda _: None
    equations: SegmentEquations = field(init=False)

    def __post_init__(self) -> None:
        self.equations = SegmentEquations(self.noise, self.pm_flux_wb, self.prepared.criteria)

    def with_noise(self, of_model: ModelNoise) -> Fitter:
        """The same where this is noise beside the readings' own; the effort is counted on."""
        return replace(self, noise=replace(self.noise, of_model=of_model))

    @property
    def criteria(self) -> FittingCriteria:
        return self.prepared.criteria.fitting

    def fit(
        self, model: Model, frame: Frame | None = None, *, steps: int = 8, renewals: int = 2, tolerance: float = 1e-4
    ) -> Fit:
        """Fit R_s, the map and every free parameter, from where the model stands.

        Parameters
        ----------
        frame : Frame, optional
            Kept from an earlier fit with the same map space.
        steps : int
            Most Gauss-Newton steps in one frame.
        renewals : int
            How often the frame is renewed and the fit continued.
        tolerance : float
            Gain of a step, as a part of the excess chi2, below which the fit ends.
        """
        if frame is None or frame.space is not model.space:
            frame = self.frame(model)
        best = self._descend(self.evaluate(model, frame), steps, tolerance)
        for _ in range(renewals):
            old = best
            best = self._descend(self.evaluate(best.model, self.frame(best.model, best.frame)), steps, tolerance)
            if abs(best.chi2 - old.chi2) < self.criteria.renewal_change * best.chi2:
                break
        return best

    def _descend(self, best: Fit, steps: int, tolerance: float) -> Fit:
        damping, limits = 0.0, self.criteria
        for _ in range(steps if best.model.free else 0):
            system = best.projected()
            enough = limits.least_gain + tolerance * max(best.chi2 - best.dof, 0.0)
            promised = newton_step(best, system, 0.0)[1]
            if promised < enough:
                break
            begun = damping
            while True:
                move, kept = newton_step(best, system, damping)
                trial = self._resized(self.evaluate(moved_by(best.model, move), best.frame), best.objective)
                missed = trial.objective >= best.objective + limits.slack
                if not missed or damping > limits.most_damping or promised < limits.least_promise:
                    break
                damping = 10.0 * damping or limits.first_damping
            gain = best.objective - trial.objective
            if gain > -limits.slack:
                best = trial
            if gain < enough:
                break
            # Where a step had to be damped more, the next one most likely has to be too.
            if damping == begun and gain > limits.promise_kept * kept:
                damping = 0.1 * damping if damping > limits.least_damping else 0.0
        return best

    def promise(self, fit: Fit) -> float:
        """How far one more step would bring the objective down, if all were linear."""
        return newton_step(fit, fit.projected(), 0.0)[1]

    def _resized(self, trial: Fit, wanted: float) -> Fit:
        """A trial that missed, with the amplitudes that belong to its shapes.

        Amplitude and shape of an effect lie along a curved valley (a heating's size and its time constant); a step
        straight ahead leaves it, and the amplitudes alone, in which the residual is nearly linear, lead back.
        """
        sizes = np.array([name in active.candidate.amplitudes for active, name in trial.model.free])
        if trial.objective < wanted or sizes.all():
            return trial
        move, _ = newton_step(trial, trial.projected(), 0.0, sizes)
        again = self.evaluate(moved_by(trial.model, move), trial.frame)
        return again if again.objective < trial.objective else trial

    def frame(self, model: Model, old: Frame | None = None) -> Frame:
        """All that is kept between steps, made anew where the model stands, as far as it changed since `old`."""
        if old is not None and (old.space is not model.space or old.noise is not self.noise):
            old = None
        before = old.pieces if old is not None else (None,) * len(self.prepared.pieces)
        jobs = list(zip(self.prepared.pieces, before, strict=True))
        pieces = tuple(self.equations.frame(model, piece, known) for piece, known in jobs)
        if old is not None and all(a.white_basis is b.white_basis for a, b in zip(pieces, old.pieces, strict=True)):
            return Frame(model.space, self.noise, pieces, old.gram)
        free = model.space.directions.shape[1]
        gram = np.zeros((free, free))
        for piece, segment_frame in zip(self.prepared.pieces, pieces, strict=True):
            if not piece.held_out:
                gram += segment_frame.white_basis.T @ segment_frame.white_basis
        return Frame(model.space, self.noise, pieces, gram)

    def evaluate(
        self,
        model: Model,
        frame: Frame,
        extra: Sequence[tuple[Active, str]] = (),
        *,
        held: bool = False,
        known: Fit | None = None,
        renew: bool = True,
    ) -> Fit:
        """Solve for R_s and the map with the effects where they are; `extra` asks for more columns.

        Parameters
        ----------
        held : bool
            Nothing is solved for: R_s and the map stay the model's too.
        known : Fit, optional
            An earlier one, whose columns stand for those that have not moved since.
        renew : bool
            False: the columns of `known`, whose parameters are the same, stand for all.
        """
        self.poll()
        wanted = [*model.free, *extra] if known is None or renew else []
        rows, answers = self._rows(model, frame, wanted, known)
        fit = solved(self.prepared, model, frame, rows, [(a.name, n) for a, n in wanted], held)
        if known is not None and not renew:
            return replace(fit, columns=known.columns, parameters=known.parameters, answers=known.answers)
        return replace(fit, answers=answers)

    def _rows(
        self, model: Model, frame: Frame, wanted: Sequence[tuple[Active, str]], known: Fit | None
    ) -> tuple[list[SegmentRows], Answers]:
        """The equations of every segment, with columns on those that are not held out, and what answers to these."""
        jobs = list(zip(self.prepared.pieces, frame.pieces, strict=True))
        samples = sum(len(p.signals.v_dc) for p in self.prepared.pieces)
        self.effort.spent += samples * self.criteria.evaluation_columns
        if len(wanted) <= self.criteria.few_columns:
            self.effort.spent += samples * len(wanted)
            rows = [self.equations.rows(model, p, f, () if p.held_out else wanted) for p, f in jobs]
            return rows, Answers() if known is None else known.answers
        names = [(a.name, n) for a, n in wanted]
        asked = answers_so_far(model, known, self.criteria)
        at = probed_segments(self.prepared.pieces, self.criteria)
        probed = {k: self.equations.probed(model, *jobs[k], wanted, [asked.of.get(n) for n in names]) for k in at}
        plan = column_plan(names, {k: probe for k, (_, probe) in probed.items()}, known, self.criteria, asked.of)
        anew = [wanted[k] for k in plan.anew]
        self.effort.spent += samples * (len(anew) + len(wanted) / self.criteria.probe_every)
        answering = [plan.answering[k] for k in plan.anew]

        def made(k: int) -> SegmentRows:
            if k in probed:
                return probed[k][0]
            if jobs[k][0].held_out:
                return self.equations.rows(model, *jobs[k], ())
            rows = self.equations.rows(model, *jobs[k], anew, answering)
            columns = plan.whole(rows.columns, None if known is None else known.columns[k])
            return replace(rows, white=np.column_stack([rows.white[:, :2], columns]))

        answers = Answers({**asked.of, **dict(zip(names, plan.answering, strict=True))}, asked.sizes)
        return [made(k) for k in range(len(jobs))], answers

    def hold(self, model: Model) -> Fit:
        """The recording held against a model as it stands: nothing is fitted, the noise is what it makes of it.

        chi2 is per degree of freedom as in a fit of the same freedom.
        """
        return self.evaluate(model, self.frame(model), held=True)


def absent_columns(candidates: Sequence[Candidate]) -> list[tuple[Active, str]]:
    """Every amplitude of effects that are not in the model, as `Fitter.evaluate` takes them."""
    return [(c.absent(), n) for c in candidates for n in c.amplitudes]
