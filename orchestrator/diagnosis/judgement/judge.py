"""The verdict of a diagnosis and its reasons as a function of its record.

With the excess e = chi2/dof - 1 of the fitted stages, and l the larger one of the fitted and the held-out stages:

- noise: e and l are within noise or chance: ``clean`` without effects, ``explained`` with some;
- without effects, the residual may be immaterial (``clean``), else it is unknown;
- with effects, u = sqrt(e_after / e_before) and l decide between ``explained``, ``mostly_explained`` and unknown;
- where a mixture of the effects' forms takes up much of the residual, it is ``explained_in_another_form``.

A periodic disturbance, or a reading with the gates off that contradicts the model, is unknown whatever the fit. A good
fit under large noise, with a wrong simulated current, with implausibly many large effects, or ``clean`` where a
material effect may be hidden, is ``cannot_tell``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number, plural, quantity
from orchestrator.formatting.sentences import listed
from protocols import Judgement, Reason, Verdict, VerdictLimits, VerdictRecord

Outcome = tuple[Verdict, list[Reason]]


def judge(record: VerdictRecord, limits: VerdictLimits | None = None) -> Judgement:
    """The verdict that follows from a record, with the comparisons behind it.

    Parameters
    ----------
    limits : VerdictLimits, optional
        Limits; the record's by default.
    """
    record = record if limits is None else record.model_copy(update={"limits": limits})
    limits = record.limits
    verdict, reasons = _by_residual(record, limits)
    contradictions = [*_periodic(record), *_gates_off(record, limits)]
    if contradictions:
        more = reasons if verdict == "unknown_remains" else []
        return Judgement(verdict="unknown_remains", reasons=(*contradictions, *more))
    doubts = [] if verdict == "unknown_remains" else _doubts(record, limits)
    if verdict == "clean":
        doubts += _hidden_effects(record, limits)
    return Judgement(verdict="cannot_tell" if doubts else verdict, reasons=(*doubts, *reasons))


def residual_fraction(chi2_before: float, chi2_after: float, noise_chi2: float) -> float:
    """Ratio of the final error to the first (of amplitudes); 0 where the first model fits within the noise."""
    if chi2_before <= noise_chi2:
        return 0.0
    return math.sqrt(max(chi2_after - 1.0, 0.0) / (chi2_before - 1.0))


def jointly_implausible(widths: Mapping[str, float | None], limits: VerdictLimits) -> list[str]:
    """Effects that are larger than in most drives, the largest first; empty unless they are implausibly many."""
    sizes = {name: _or_infinite(size) for name, size in widths.items()}
    large = [name for name in sizes if sizes[name] > limits.large_effect_widths]
    return sorted(large, key=lambda name: -sizes[name]) if len(large) >= limits.large_effects else []


def _by_residual(record: VerdictRecord, limits: VerdictLimits) -> Outcome:
    """The verdict from the residual."""
    chance = limits.chance_sigmas * math.sqrt(2.0 / record.degrees_of_freedom)
    excess, largest_excess = _or_infinite(record.chi2_after) - 1.0, _largest_chi2(record) - 1.0
    noise, bearable = max(limits.noise_chi2 - 1.0, chance), max(limits.explained_excess_chi2, chance)
    if excess <= noise and largest_excess <= bearable:
        held_out_limit = 1.0 + bearable + _held_out_chance(record)
        return "explained" if record.effects else "clean", _within_noise(record, 1.0 + noise, held_out_limit)
    if not record.effects:
        return _without_effects(record, limits, chance)
    return _with_effects(record, limits)


def _without_effects(record: VerdictRecord, limits: VerdictLimits, chance: float) -> Outcome:
    """The verdict without effects: the residual is immaterial or unknown."""
    largest_excess, voltage = _largest_chi2(record) - 1.0, _or_infinite(record.left_of_excitation)
    known = max(limits.explained_excess_chi2, chance)
    bounds = ((known, limits.material_voltage), (limits.clean_excess_chi2, limits.negligible_voltage))
    passed = [bound for bound in bounds if largest_excess <= bound[0] and voltage <= bound[1]]
    max_excess, max_part = passed[0] if passed else bounds[0 if largest_excess <= known else 1]
    reasons = [_of_chi2(record, max_excess, "clean with an immaterial rest"), _of_voltage(record, max_part)]
    if passed:
        return "clean", reasons
    found = Reason(
        quantity="effects", value=0.0, limit=None, sentence="No effect of the library explains a part of the error."
    )
    above = [largest_excess > max_excess, voltage > max_part]
    return "unknown_remains", [found, *(r for r, is_above in zip(reasons, above, strict=True) if is_above)]


def _with_effects(record: VerdictRecord, limits: VerdictLimits) -> Outcome:
    """The verdict with effects, from the ratio of the final error to the first."""
    largest_excess = _largest_chi2(record) - 1.0
    fraction = residual_fraction(_or_infinite(record.chi2_before), _or_infinite(record.chi2_after), limits.noise_chi2)
    if fraction <= limits.mostly_explained_fraction and (in_other_forms := _in_other_forms(record, limits)):
        return "explained_in_another_form", in_other_forms
    broken = []
    if fraction > limits.mostly_explained_fraction:
        broken.append(_of_fraction(fraction, limits.mostly_explained_fraction, "mostly_explained"))
    if largest_excess > limits.immaterial_excess_chi2:
        broken.append(_of_chi2(record, limits.immaterial_excess_chi2, "mostly_explained"))
    if broken:
        return "unknown_remains", broken
    explained = (
        (fraction <= limits.explained_fraction, _of_fraction(fraction, limits.explained_fraction, "explained")),
        (largest_excess <= limits.explained_excess_chi2, _of_chi2(record, limits.explained_excess_chi2, "explained")),
    )
    if all(kept for kept, _ in explained):
        return "explained", [reason for _, reason in explained]
    small = largest_excess <= limits.mostly_explained_excess_chi2
    immaterial = explained[0][0] and _or_infinite(record.left_of_excitation) <= limits.material_voltage
    strained = _or_infinite(record.shape_widths) > limits.shape_widths
    if (small or immaterial) and not strained:
        reasons = [reason for kept, reason in explained if not kept]
        reasons.append(_of_fraction(fraction, limits.mostly_explained_fraction, "mostly_explained"))
        allowed = _of_chi2(record, limits.mostly_explained_excess_chi2, "mostly_explained")
        return "mostly_explained", [*reasons, allowed if small else _of_voltage(record, limits.material_voltage)]
    broken = [_of_shape(record, limits)] if strained else []
    if not (small or immaterial):
        broken.append(_of_chi2(record, limits.mostly_explained_excess_chi2, "mostly_explained"))
        by_voltage = explained[0][0]
        broken.append(_of_voltage(record, limits.material_voltage) if by_voltage else _of_large_chi2(fraction, limits))
    return "unknown_remains", broken


def _in_other_forms(record: VerdictRecord, limits: VerdictLimits) -> list[Reason]:
    """The reasons for an explanation in another form; empty where other forms do not take up what is left."""
    if record.chi2_in_other_forms is None or record.chi2_after is None or record.chi2_after <= 1.0:
        return []
    if _largest_chi2(record) - 1.0 <= limits.explained_excess_chi2:
        return []
    share = (record.chi2_after - record.chi2_in_other_forms) / (record.chi2_after - 1.0)
    left = residual_fraction(_or_infinite(record.chi2_before), record.chi2_in_other_forms, limits.noise_chi2)
    too_much = record.chi2_in_other_forms - 1.0 > limits.immaterial_excess_chi2 or left > limits.explained_fraction
    if share < limits.other_form_share or too_much:
        return []
    value, allowed = _as_texts(100.0 * share, 100.0 * limits.other_form_share)
    names = listed([plain(name) for name in record.other_forms])
    text = (
        f"Other forms of {names} take up {value} % of the excess chi2, which falls from {number(record.chi2_after, 3)} "
        f"to {number(record.chi2_in_other_forms, 3)}; {allowed} % is required."
    )
    rest, most = _as_texts(100.0 * left, 100.0 * limits.explained_fraction)
    remaining = f"{rest} % of the first error is left then; up to {most} % is allowed."
    return [
        _percentage("taken_up_by_other_forms", share, limits.other_form_share, text),
        _percentage("left_of_first_error", left, limits.explained_fraction, remaining),
    ]


def _periodic(record: VerdictRecord) -> list[Reason]:
    if not record.periodic_lines:
        return []
    text = (
        f"The holds contain {plural(record.periodic_lines, 'periodic disturbance')} beside the switching ripple; "
        "the limit is 0, for no effect of the library makes one."
    )
    return [Reason(quantity="periodic_lines", value=float(record.periodic_lines), limit=0.0, sentence=text)]


def _gates_off(record: VerdictRecord, limits: VerdictLimits) -> list[Reason]:
    """Readings with the gates off are few among thousands of equations, so that they are tested separately."""
    volts, least = record.gates_off_v or 0.0, _or_infinite(record.least_excitation_v)
    limit = limits.material_voltage * least
    chance = 1.0 if record.gates_off_probability is None else record.gates_off_probability
    if volts <= limit or chance >= limits.chance_probability:
        return []
    text = (
        f"With the gates off, the readings contradict the model by {quantity(volts, 'V')} (rms, R_s times current). "
        f"The limit is {quantity(limit, 'V')}, {_percent(limits.material_voltage)} of the applied voltage. Chance "
        f"makes as much less than once in {number(1.0 / limits.chance_probability)} recordings."
    )
    return [Reason(quantity="gates_off_v", value=volts, limit=limit, sentence=text)]


def _doubts(record: VerdictRecord, limits: VerdictLimits) -> list[Reason]:
    """Reasons why a model that fits may still be wrong."""
    doubts = []
    if record.chi2_after is not None and record.chi2_after < limits.least_chi2:
        value, allowed = _as_texts(record.chi2_after, limits.least_chi2)
        text = (
            f"chi2 per degree of freedom is {value}, far below one; the limit is {allowed}. The readings' noise was "
            "overestimated, and an effect may hide in it."
        )
        doubts.append(Reason(quantity="chi2_per_dof", value=record.chi2_after, limit=limits.least_chi2, sentence=text))
    if large := jointly_implausible(record.effect_widths, limits):
        sizes = listed([f"{plain(name)} ({number(record.effect_widths[name], 2)})" for name in large])
        text = (
            f"{len(large)} effects at once are larger than in most drives: {sizes}, in standard deviations of their "
            f"priors, with a limit of {number(limits.large_effect_widths)}. From {limits.large_effects} on this is "
            "implausible: one unknown effect may act like all of them."
        )
        count = Reason(quantity="large_effects", value=len(large), limit=limits.large_effects, sentence=text)
        doubts.append(count)
    noise_v, excited_v = record.noise_v, record.excitation_v or 0.0
    if noise_v is not None and noise_v > limits.noise_of_excitation * excited_v:
        part = noise_v / excited_v if excited_v > 0.0 else math.inf
        text = (
            f"Noise alone makes {quantity(noise_v, 'V')} of the {quantity(excited_v, 'V')} that were applied, "
            f"{_percent(part)}. Above {_percent(limits.noise_of_excitation)} a good fit proves nothing."
        )
        doubts.append(_percentage("noise_of_excitation", part, limits.noise_of_excitation, text))
    error = record.current_error
    if error is not None and error > limits.current_error:
        text = (
            f"The current simulated from the voltage differs from the measured one by {_percent(error)} of its range "
            f"(rms). The limit is {_percent(limits.current_error)}. The map is wrong somewhere, for example where "
            "points are too far apart for the iron's saturation."
        )
        doubts.append(_percentage("current_error", error, limits.current_error, text))
    return doubts


def _hidden_effects(record: VerdictRecord, limits: VerdictLimits) -> list[Reason]:
    """The reason against ``clean`` where an effect that the recording hardly shows may be material."""
    hidden = record.hidden_map_error
    if hidden is None or hidden <= limits.material_flux:
        return []
    value, allowed = _as_texts(100.0 * hidden, 100.0 * limits.material_flux)
    text = (
        f"Effects that this recording hardly shows may move the map by {value} % of the rated flux (95 %); above "
        f"{allowed} % that matters. More or longer stages show them."
    )
    return [_percentage("hidden_map_error", hidden, limits.material_flux, text)]


def _within_noise(record: VerdictRecord, limit: float, held_out_limit: float) -> list[Reason]:
    chi2 = _or_infinite(record.chi2_after)
    value, allowed = _as_texts(chi2, limit)
    fell = f"fell from {number(record.chi2_before)} to {value}" if record.effects else f"is {value}"
    text = f"chi2 per degree of freedom of the fitted stages {fell}; noise alone makes up to {allowed}."
    reasons = [Reason(quantity="chi2_per_dof", value=chi2, limit=limit, sentence=text)]
    if record.held_out_chi2 is not None:
        value, allowed = _as_texts(record.held_out_chi2, held_out_limit)
        text = f"The stages that were not fitted have chi2 {value} per degree of freedom; up to {allowed} is allowed."
        held_out = Reason(
            quantity="held_out_chi2_per_dof", value=record.held_out_chi2, limit=held_out_limit, sentence=text
        )
        reasons.append(held_out)
    return reasons


def _of_chi2(record: VerdictRecord, limit: float, claim: str) -> Reason:
    """Comparison of the larger chi2 of fitted and held-out stages with the excess that a verdict allows."""
    name, stages, chi2, most = "chi2_per_dof", "The fitted stages", _or_infinite(record.chi2_after), 1.0 + limit
    if _largest_chi2(record) > chi2:
        name, stages, chi2 = "held_out_chi2_per_dof", "The stages that were not fitted", record.held_out_chi2 or 0.0
        most += _held_out_chance(record)
    value, allowed = _as_texts(chi2, most)
    text = f"{stages} have chi2 {value} per degree of freedom; {plain(claim)} allows up to {allowed}."
    return Reason(quantity=name, value=chi2, limit=most, sentence=text)


def _of_fraction(fraction: float, limit: float, claim: str) -> Reason:
    value, allowed = _as_texts(100.0 * fraction, 100.0 * limit)
    text = f"{value} % of the first error is left; {plain(claim)} allows up to {allowed} %."
    return _percentage("left_of_first_error", fraction, limit, text)


def _of_large_chi2(fraction: float, limits: VerdictLimits) -> Reason:
    value, allowed = _as_texts(100.0 * fraction, 100.0 * limits.explained_fraction)
    chi2 = number(1.0 + limits.mostly_explained_excess_chi2)
    text = (
        f"{value} % of the first error is left; a chi2 above {chi2} is allowed only where at most {allowed} % is left."
    )
    return _percentage("left_of_first_error", fraction, limits.explained_fraction, text)


def _of_voltage(record: VerdictRecord, limit: float) -> Reason:
    part = _or_infinite(record.left_of_excitation)
    value, allowed = _as_texts(100.0 * part, 100.0 * limit)
    text = f"What is left is {value} % of the applied voltage (rms); up to {allowed} % does not matter."
    return _percentage("left_of_excitation", part, limit, text)


def _of_shape(record: VerdictRecord, limits: VerdictLimits) -> Reason:
    widths = _or_infinite(record.shape_widths)
    value, allowed = _as_texts(widths, limits.shape_widths)
    text = (
        f"A refinement of {plain(record.shape_effect or 'an effect')} is {value} standard deviations of its prior "
        f"from its usual value, and {allowed} is the limit: the effect may stand in for another one."
    )
    return Reason(quantity="shape_widths", value=widths, limit=limits.shape_widths, sentence=text)


def _percentage(name: str, part: float, limit: float, sentence: str) -> Reason:
    return Reason(quantity=f"{name}_percent", value=100.0 * part, limit=100.0 * limit, sentence=sentence)


def _percent(part: float) -> str:
    return f"{_text(100.0 * part)} %"


def _largest_chi2(record: VerdictRecord) -> float:
    """chi2 of the fitted stages, or of the held-out ones less what chance makes of so few equations."""
    return max(_or_infinite(record.chi2_after), (record.held_out_chi2 or 0.0) - _held_out_chance(record))


def _held_out_chance(record: VerdictRecord) -> float:
    """Excess chi2 of the held-out stages that is due to chance."""
    few = record.held_out_equations
    return record.limits.chance_sigmas * math.sqrt(2.0 / few) if few else 0.0


def _or_infinite(value: float | None) -> float:
    """A record's number; None in the record stands for a number that is not finite."""
    return math.inf if value is None else value


def _as_texts(value: float, limit: float) -> tuple[str, str]:
    """Value and limit as texts with enough digits to show which one is larger."""
    digits = next((d for d in range(3, 12) if _text(value, d) != _text(limit, d)), 3)
    return _text(value, digits), number(limit, 3) if float(f"{limit:.3g}") == limit else _text(limit, digits)


def _text(value: float, digits: int = 3) -> str:
    return number(value, digits) if math.isfinite(value) else "infinite"
