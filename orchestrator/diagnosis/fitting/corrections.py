"""Effects applied to a batch of segments, from the sensors inwards; returned arrays are checked, not copied.

A change by one effect's parameter is propagated through the effects further inside. Most of them do not respond to it:
a resistance does not depend on the voltage. Those that respond are found on a few segments
(`orchestrator.diagnosis.fitting.columns`); the others are not evaluated again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis.fitting.candidates import EffectTerm, standardised, typical_standardised_value
from orchestrator.diagnosis.fitting.guarded import method_source
from orchestrator.numerics.types import Array
from protocols import (
    Correction,
    EffectHook,
    EffectLayer,
    FluxbenchError,
    ParameterRole,
    PluginError,
    RealArray,
    SignalBatch,
    Signals,
    hook_of,
)


@dataclass(frozen=True)
class Corrected:
    """Signals corrected by some effects.

    Attributes
    ----------
    signals : SignalBatch
    changed : frozenset of str
        Names of the arrays that the effects changed.
    """

    signals: SignalBatch
    changed: frozenset[str] = frozenset()


def apply_effects(signals: SignalBatch, active: Sequence[EffectTerm]) -> Corrected:
    """The signals corrected by all effects that are not neutral.

    Raises
    ------
    PluginError
        If an effect raises, or returns arrays that are invalid as signals.
    """
    cascade = Cascade.of(signals, active)
    return Corrected(cascade.corrected, cascade.changed)


def apply_effect(signals: SignalBatch, item: EffectTerm) -> Corrected:
    """The signals corrected by one effect unless it is neutral; with the bridge off only sensor effects act.

    Raises
    ------
    PluginError
        As in `apply_effects`.
    """
    if item.is_absent or not (_bridge_on(signals) or item.candidate.effect.layer is EffectLayer.CURRENT_SENSORS):
        return Corrected(signals)
    return _corrected(signals, _evaluate(item, signals))


def has_random_directions(item: EffectTerm) -> bool:
    """Whether an effect that is not neutral has random directions."""
    return not item.is_absent and any(hook_of(item.candidate.effect, hook) is not None for hook in _RANDOM_DIRECTIONS)


def random_directions_of(item: EffectTerm, signals: SignalBatch) -> list[Corrected]:
    """The signals changed by one standard deviation along each random direction of an effect, all segments at once.

    Raises
    ------
    PluginError
        As in `apply_effects`.
    """
    if not (_bridge_on(signals) and has_random_directions(item)):
        return []
    return [_corrected(signals, arrays) for arrays in _evaluate_random_directions(item, signals)]


def _bridge_on(signals: SignalBatch) -> bool:
    """Whether the bridge is on, which is the same for all segments of a batch."""
    return any(s.bridge_on for s in signals.segments)


def _corrected(signals: SignalBatch, arrays: Mapping[str, RealArray]) -> Corrected:
    changed = signals.changed_along(arrays)
    return Corrected(signals.replaced(changed), frozenset(changed))


def _evaluate(item: EffectTerm, signals: SignalBatch) -> Mapping[str, RealArray]:
    """The arrays that an effect changes in a batch, by one call if it supports batches, else segment by segment."""
    effect = item.candidate.effect
    correct_batch = hook_of(effect, "correct_batch")
    if correct_batch is not None:
        return _checked(item, "correct", signals, _call(item, "correct_batch", correct_batch, signals))
    parts = [_call(item, "correct", effect.correct, signals.segment(k)) for k in range(len(signals.segments))]
    correction = parts[0] if len(parts) == 1 else _end_to_end(item, "correct", signals, parts)
    return _checked(item, "correct", signals, correction)


def _evaluate_random_directions(item: EffectTerm, signals: SignalBatch) -> list[Mapping[str, RealArray]]:
    name = "random_directions"
    of_batch, of_segment = (hook_of(item.candidate.effect, hook) for hook in _RANDOM_DIRECTIONS)
    if of_batch is not None:
        directions = _sequence(item, _call(item, "random_directions_batch", of_batch, signals))
        return [_checked(item, name, signals, one) for one in directions]
    if of_segment is None:
        return []
    found = [_sequence(item, _call(item, name, of_segment, signals.segment(k))) for k in range(len(signals.segments))]
    count = max(map(len, found))
    rows = [[one[m] if m < len(one) else Correction() for one in found] for m in range(count)]
    return [_checked(item, name, signals, _end_to_end(item, name, signals, row)) for row in rows]


_RANDOM_DIRECTIONS: tuple[EffectHook, EffectHook] = ("random_directions_batch", "random_directions")


def _sequence(item: EffectTerm, found: object) -> Sequence[object]:
    if not isinstance(found, Sequence):
        raise _error(item, "random_directions", f"returned {type(found).__name__}, no sequence")
    return found


def _end_to_end(item: EffectTerm, method: str, signals: SignalBatch, parts: Sequence[object]) -> Correction:
    """Concatenate the corrections of a batch's segments; arrays changed in some segments only are completed."""
    corrections = [_require_correction(item, method, part) for part in parts]

    def part_of(k: int, name: str) -> RealArray:
        before: RealArray | None = getattr(signals, name)
        return (np.zeros_like(signals.v_ab) if before is None else before)[signals.slice_of(k)]

    for k, one in enumerate(corrections):
        for name, array in one.arrays.items():
            _require_array(item, method, name, part_of(k, name), array)
    arrays: dict[str, RealArray] = {}
    for name in dict.fromkeys(name for one in corrections for name in one.arrays):
        pieces = []
        for k, one in enumerate(corrections):
            before = part_of(k, name)
            if name == "i_m_ab" and "i_ab" in one.arrays:
                before = before + (one.arrays["i_ab"] - part_of(k, "i_ab"))
            pieces.append(one.arrays.get(name, before))
        arrays[name] = np.concatenate(pieces)
    return Correction(**arrays)


def _call(item: EffectTerm, method: str, function: Callable[..., object], signals: Signals | SignalBatch) -> object:
    try:
        return function(signals, item.parameters)
    except FluxbenchError:
        raise
    except (Exception, SystemExit) as error:  # somebody else's code may raise anything
        raise PluginError("effects", item.name, f"{method}: {type(error).__name__}: {error}") from error


def _require_correction(item: EffectTerm, method: str, correction: object) -> Correction:
    if not isinstance(correction, Correction):
        raise _error(item, method, f"returned {type(correction).__name__} instead of a Correction")
    return correction


def _checked(item: EffectTerm, method: str, signals: SignalBatch, correction: object) -> Mapping[str, RealArray]:
    """The arrays of a correction returned by an effect's method, each checked."""
    arrays = _require_correction(item, method, correction).arrays
    for name, array in arrays.items():
        before = getattr(signals, name)
        _require_array(item, method, name, signals.v_ab if before is None else before, array)
    return arrays


def _require_array(item: EffectTerm, method: str, name: str, before: RealArray, now: object) -> None:
    shape = getattr(now, "shape", None)
    if not isinstance(now, np.ndarray) or shape != before.shape:
        raise _error(item, method, f"{name} has shape {shape}, not {before.shape}")
    if now.dtype.kind != "f":
        raise _error(item, method, f"{name} is of type {now.dtype}, not float64")
    # A finite array has a finite sum of squares, unless that overflows: then each number is checked.
    if not math.isfinite(np.vdot(now, now)) and not np.isfinite(now).all():
        raise _error(item, method, f"{name} is not finite")


def _error(item: EffectTerm, method: str, problem: str) -> PluginError:
    """Of what a method returned, with the place of the method."""
    source = method_source(item.candidate.effect, f"{method}_batch", method)
    return PluginError("effects", item.name, f"{method}: {problem}{source}")


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
            Contribution of each inner effect to the change beyond rounding, where `answering` is None.
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
                part = {n: d - change[n] if n in change else d for n, d in carried.items()}
                if _exceeds_rounding(part, self.corrected):
                    responses[inner.name] = part
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
    return signals.replaced({name: _array_of(signals, name) + d for name, d in change.items()})


def _less(one: SignalBatch, other: SignalBatch, names: frozenset[str]) -> Change:
    return {name: np.ascontiguousarray(_array_of(one, name) - _array_of(other, name)) for name in names}


def _exceeds_rounding(change: Change, signals: SignalBatch) -> bool:
    """Whether a change exceeds the rounding of an addition followed by a subtraction."""
    return any(
        float(np.abs(array).max()) > 1e3 * np.finfo(np.float64).eps * float(np.max(np.abs(_array_of(signals, name))))
        for name, array in change.items()
    )


def _array_of(signals: SignalBatch, name: str) -> Array | float:
    """An array of the signals; 0 where it is absent."""
    array: Array | None = getattr(signals, name)
    return 0.0 if array is None else array
