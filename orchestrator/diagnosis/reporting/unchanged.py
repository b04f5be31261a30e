"""The report of an `add` that has nothing to fit: every effect is in the model already, with its size."""

from __future__ import annotations

import math
from collections.abc import Sequence

from orchestrator.formatting.names import parameter_words, plain
from orchestrator.formatting.quantities import measured
from protocols import AddReport, FoundEffect, ModelEffect, MotorModel, ParameterValue, Remark, Unexplained


def unchanged_model(saved: MotorModel, names: Sequence[str]) -> AddReport | None:
    """The report on effects that a model has all already; None where one of them is missing in it.

    Parameters
    ----------
    names : sequence of str
        Effects of the library, at least one.
    """
    effects = {effect.name: effect for effect in saved.effects}
    if not all(name in effects for name in names):
        return None
    first, last = saved.ladder[0].chi2, saved.ladder[-1].chi2
    is_known = first is not None and last is not None and first > 1.0
    fraction = math.sqrt(max(last - 1.0, 0.0) / (first - 1.0)) if is_known and first and last else None
    text = "{effect} is in the model already: {sizes}; nothing was fitted"
    remarks = [
        Remark.of("in_model", text, effect=plain(name), sizes=_sizes(effects[name])) for name in dict.fromkeys(names)
    ]
    return AddReport(
        effects=tuple(_found(effect) for effect in saved.effects),
        ladder=saved.ladder,
        unexplained=Unexplained(fraction=fraction, shape=()),
        remarks=tuple(remarks),
    )


def _sizes(effect: ModelEffect) -> str:
    """The fitted parameters of the first one's unit, which are the effect's size."""
    fitted = {name: p for name, p in effect.parameters.items() if p.fitted} or effect.parameters
    unit = next((p.unit for p in fitted.values()), "")
    sizes = {name: p for name, p in fitted.items() if p.unit == unit}
    return ", ".join(f"{parameter_words(name)} {measured(p.value, p.low, p.high, p.unit)}" for name, p in sizes.items())


def _found(effect: ModelEffect) -> FoundEffect:
    return FoundEffect(
        name=effect.name,
        parameters={
            name: ParameterValue(value=p.value, low=p.low, high=p.high, unit=p.unit)
            for name, p in effect.parameters.items()
        },
        twins=effect.twins,
        relative_size=effect.relative_size,
        log_evidence=effect.log_evidence,
    )
