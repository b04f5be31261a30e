"""Effects that are known to be in a recording, as of a simulated motor: which it shows, and what fits as well.

Nothing is searched for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from orchestrator.diagnosis._prepare import open_for_refit
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm, scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.contrasts import CONTRASTS, MIN_IMITATED_SHARE, holds, own_signal, resembling
from orchestrator.diagnosis.selection.first_models import first_steps
from orchestrator.diagnosis.selection.scoring import fits_as_well
from orchestrator.diagnosis.selection.search import with_effect
from orchestrator.diagnosis.selection.search_state import evidence_gain
from orchestrator.diagnosis.weak_form.preparation import prepare
from orchestrator.recording import Recording
from protocols import Effect, ParameterRole


def inseparable_groups(recording: Recording, library: Sequence[Effect]) -> Mapping[str, tuple[str, ...]]:
    """Names of effects that act alike in a recording, by the measurement that it lacks, in words.

    Only what the effects declare as needed is compared with what was measured: no effect is fitted.

    Raises
    ------
    RecordingError, NotMeasuredError
        As `diagnose_recording`.
    """
    prepared = prepare(recording, Criteria())
    groups = {
        recognition.text: tuple(effect.name for effect in library if contrast in effect.needs)
        for contrast, recognition in CONTRASTS.items()
        if not holds(prepared, contrast)
    }
    return {text: names for text, names in groups.items() if len(names) > 1}


@dataclass(frozen=True)
class KnownEffects:
    """Effects of a recording with their true sizes, and the library that they are of.

    Attributes
    ----------
    true : mapping
        True parameters by the effect's name. Those that the library's effect does not have are ignored.
    library : sequence of Effect
        All effects that may be named.
    """

    recording: Recording
    true: Mapping[str, Mapping[str, float]]
    library: Sequence[Effect]

    def shows(self, name: str) -> bool:
        """Whether the recording shows one of the effects beside the others.

        It does where the part of its signal that the others do not imitate is enough for its name, and where the
        others alone fit worse.

        Raises
        ------
        RecordingError, NotMeasuredError
            As `diagnose_recording`.
        """
        fit, criteria = self._held, self._held.criteria.selection
        whole, own = (own_signal(self._setup.fitter, fit, name, beside) for beside in (False, True))
        if own < 2.0 * criteria.log_evidence:
            return False
        if own > (1.0 - MIN_IMITATED_SHARE) * whole:
            return True
        without = self._fit([other for other in self.true if other != name])
        return evidence_gain(self._with(without, name), without) > criteria.tie

    def fits_as_well(self, name: str, other: str) -> bool:
        """Whether another effect fits the recording as well in the place of one of them.

        Raises
        ------
        RecordingError, NotMeasuredError
            As `diagnose_recording`.
        """
        if other not in resembling(self._setup.fitter, self._held, name, [self._candidates[other]]):
            return False
        rest = self._fit([one for one in self.true if one != name])
        named, rival = (self._with(rest, one) for one in (name, other))
        return evidence_gain(rival, named) > -rest.criteria.selection.log_evidence or fits_as_well(rival, named)

    @cached_property
    def _setup(self) -> DiagnosisSetup:
        return open_for_refit(self.recording, None)

    @cached_property
    def _candidates(self) -> Mapping[str, CandidateEffect]:
        return {c.name: c for c in scaled_library(self.library, self._setup.prepared.manifest)}

    @cached_property
    def _held(self) -> Fit:
        """The model with every effect at its true size, where its signal is looked at."""
        terms = [self._true_term(name) for name in self.true]
        return self._setup.fitter.hold(self._bare.model.with_active(terms))

    @cached_property
    def _bare(self) -> Fit:
        return first_steps(self._setup, "saturated", {})[-1].fit

    def _true_term(self, name: str) -> EffectTerm:
        """The effect as it is; its amplitudes are free."""
        term = self._candidates[name].absent()
        known = {p: value for p, value in self.true[name].items() if p in term.values}
        # A form of the library's own that the true motor does not have stays at its typical value.
        shapes = term.candidate.of_role(ParameterRole.SHAPE, ParameterRole.AMPLITUDE)
        limits = {p: term.candidate.named(p) for p in known if p in shapes}
        values = {p: min(max(known[p], limit.low), limit.high) for p, limit in limits.items()}
        return replace(term, values={**term.values, **values})

    def _fit(self, names: Sequence[str]) -> Fit:
        fit = self._bare
        for name in names:
            fit = self._with(fit, name)
        return fit

    def _with(self, fit: Fit, name: str) -> Fit:
        return with_effect(self._setup, fit, self._candidates[name])
