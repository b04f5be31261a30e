"""Changes of the signals by one effect's parameter, propagated through the effects further inside.

Most effects do not respond to a given change: a resistance does not depend on the voltage. Those that respond are
found on a few segments (`orchestrator.diagnosis.fitting.columns`); the others are not evaluated again.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis.fitting.candidates import EffectTerm, standardised, typical_standardised_value
from orchestrator.diagnosis.fitting.corrections import Corrected, apply_effect, random_directions_of
from orchestrator.numerics.types import Array
from protocols import ParameterRole, SignalBatch

SECANT_STEP: float = 0.01
"""Step of a secant, relative to the standardised value: far above rounding, and small enough to be nearly linear."""
MIN_SECANT_AMPLITUDE: float = 0.02
"""Standardised value of an amplitude below which the secant's step stays constant."""

Change = dict[str, Array]
"""Changes of the signals' arrays by name; arrays that do not change are omitted."""


@dataclass(frozen=True)
class Cascade:
    """The signals of a batch before and after each of a model's effects, from the sensors inwards.

    Attributes
    ----------
    effects : tuple of EffectTerm
        Outermost first.
    stages : tuple of Corrected
        The signals before each effect and after the last, each with the names changed by the preceding effect.
    """

    effects: tuple[EffectTerm, ...]
    stages: tuple[Corrected, ...]

    @classmethod
    def of(cls, signals: SignalBatch, active: Sequence[EffectTerm]) -> Cascade:
        """Apply all effects to measured signals."""
        effects = tuple(sorted(active, key=lambda a: a.candidate.effect.layer))
        stages = [Corrected(signals)]
        for one in effects:
            stages.append(apply_effect(stages[-1].signals, one))
        return cls(effects, tuple(stages))

    @property
    def corrected(self) -> SignalBatch:
        return self.stages[-1].signals

    @property
    def changed(self) -> frozenset[str]:
        """Names of the arrays that any of the effects changed."""
        return frozenset[str]().union(*(stage.changed for stage in self.stages))

    def change_by(self, moved: EffectTerm, answering: Container[str] | None = None) -> tuple[Change, dict[str, Change]]:
        """Change of the innermost signals when one effect, in the model or not, is replaced by `moved`.

        Parameters
        ----------
        answering : container of str, optional
            Effects that respond to the change; all by default.

        Returns
        -------
        change : dict
        responses : dict
            Contribution of each inner effect to the change, where `answering` is None.
        """
        at = next((k for k, a in enumerate(self.effects) if a.name == moved.name), None)
        if at is None:
            at = behind = sum(a.candidate.effect.layer <= moved.candidate.effect.layer for a in self.effects)
        else:
            behind = at + 1
        other = apply_effect(self.stages[at].signals, moved)
        names = other.changed | (self.stages[behind].changed if behind > at else frozenset())
        return self._inwards(behind, _less(other.signals, self.stages[behind].signals, names), answering)

    def random_directions(self) -> Iterator[Change]:
        """Change of the innermost signals by each random direction of each effect."""
        for k, active in enumerate(self.effects):
            before = self.stages[k].signals
            for doubted in random_directions_of(active, before):
                yield self._inwards(k + 1, _less(doubted.signals, before, doubted.changed))[0]

    def _inwards(
        self, behind: int, change: Change, answering: Container[str] | None = None
    ) -> tuple[Change, dict[str, Change]]:
        """Propagate a change through the effects from a place on; also each one's part where all are applied."""
        responses = dict[str, Change]()
        for k in range(behind, len(self.effects)):
            inner = self.effects[k]
            if inner.is_absent or (answering is not None and inner.name not in answering):
                continue
            other = apply_effect(_plus(self.stages[k].signals, change), inner)
            names = other.changed | self.stages[k + 1].changed
            if not names:
                continue
            carried = _less(other.signals, self.stages[k + 1].signals, names | change.keys())
            if answering is None:
                responses[inner.name] = {n: d - change[n] if n in change else d for n, d in carried.items()}
            change = carried
        return change, responses


def step_of(active: EffectTerm, name: str) -> float:
    """Secant step of one parameter's standardised value.

    It goes to the typical size where the effect is absent, and from the first form to the second, a separate minimum.
    Where a bound is nearer than the step, it goes to the other side.
    """
    p = active.candidate.named(name)
    x = active.standardised_value(name)
    refines = p.role is ParameterRole.REFINEMENT
    if refines and p.other_form is not None and active.values[name] == p.neutral:
        return standardised(p, p.other_form) - x
    if p.role is not ParameterRole.AMPLITUDE:
        step = SECANT_STEP * max(abs(x), 1.0)
    elif active.is_absent:
        step = typical_standardised_value(p)
    else:
        step = SECANT_STEP * max(abs(x), MIN_SECANT_AMPLITUDE)
    return max((_within(active, name, side) for side in (step, -step)), key=abs)


def _within(active: EffectTerm, name: str, step: float) -> float:
    """A step of one parameter's standardised value, limited to its bounds."""
    x = active.standardised_value(name)
    moved = active.moved(name, x + step).standardised_value(name) - x
    return step if math.isclose(moved, step, rel_tol=1e-6) else moved


def _plus(signals: SignalBatch, change: Change) -> SignalBatch:
    return signals.replaced({name: array_of(signals, name) + d for name, d in change.items()})


def _less(one: SignalBatch, other: SignalBatch, names: frozenset[str]) -> Change:
    return {name: np.ascontiguousarray(array_of(one, name) - array_of(other, name)) for name in names}


def array_of(signals: SignalBatch, name: str) -> Array | float:
    """An array of the signals; 0 where it is absent."""
    array: Array | None = getattr(signals, name)
    return 0.0 if array is None else array
