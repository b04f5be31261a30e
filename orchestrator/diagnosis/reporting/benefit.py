"""Whether an effect that was added or removed changes the error in held-out stages."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.determination import undetermined_words
from orchestrator.diagnosis.reporting.ladder import held_out, mean_rms_v, noise_rms_v, training
from orchestrator.diagnosis.reporting.parameter_bounds import bounds_reached
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.formatting.names import parameter_words, plain
from orchestrator.formatting.quantities import number, quantity
from orchestrator.formatting.sentences import listed
from protocols import FoundEffect, Remark

MAX_CHANGE_UNSEEN: float = 0.01
"""Relative change of the rms error that counts as none: where much is left, an effect has to change more to help."""
MAX_PART_LEFT: float = 0.5
"""Part of the error that an effect may leave for its benefit to speak for it, where the rest exceeds the noise."""
SEVERAL_TIMES_THE_NOISE: float = 5.0
"""Error over the noise's, beyond which something large is missing."""


def added_remark(
    name: str, before: Fit, after: Fit, found: FoundEffect | None, resembles: Sequence[str] = ()
) -> Remark:
    """Whether an added effect helps, by one of six codes.

    They are ``helps``, ``helps_at_bound``, ``helps_besides``, ``certain``, ``does_not_help`` and ``undetermined``.
    One with a parameter at its bound may help more within wider ones, or imitate something else. So may one that
    resembles another effect of the model. One is certain, and no more, where the likelihood of the held-out data
    requires it and the rms error does not fall: close to the noise, an rms shows no small effect.

    Parameters
    ----------
    before, after : Fit
        The model without and with the effect.
    found : FoundEffect or None
        The effect with its intervals; None for a freed map.
    resembles : sequence of str
        Other effects of the model that resemble it.
    """
    errors = _errors(before, after)
    if helps(before, after):
        course = "{of} {course}; noise alone leaves {noise}"
        bounds = [bound for term in after.model.active if term.name == name for bound in bounds_reached(term).items()]
        if bounds:
            at = listed([f"its {parameter_words(parameter)} is at its bound {words}" for parameter, words in bounds])
            return _remark("helps_at_bound", "{effect} may help: " + f"{course}; but {at}", name, errors)
        if resembles:
            others = f"{listed([plain(other) for other in resembles])}: their sizes are not determined separately"
            return _remark(
                "helps_besides", "{effect} may help: " + f"{course}; but it resembles {others}", name, errors
            )
        if not _falls(errors):
            text = "{effect} is certain by its evidence ({gain}), though {of} {course}; noise alone leaves {noise}"
            return _remark("certain", text, name, errors, _gain_words(before, after))
        return _remark("helps", "{effect} helps: " + course + _while_much_is_left(errors), name, errors)
    unknown = "" if found is None else undetermined_words(after, found)
    if unknown:
        return _remark("undetermined", "{effect} does not help, nor is it excluded: " + unknown, name, errors)
    zero = [] if found is None else _amplitudes_that_hold_zero(after, found)
    why = f", and the 95 % interval of its {listed(zero)} holds 0" if zero else ""
    if _is_far_from_noise(errors):
        text = "{effect} does not help by itself: {of} {only}{course}; noise alone leaves {noise}, so that something "
        return _remark("does_not_help", text + "else is missing" + why, name, errors)
    return _remark("does_not_help", "{effect} does not help: {of} {only}{course}" + why, name, errors)


def helps(before: Fit, after: Fit) -> bool:
    """Whether the fit with an effect predicts stages that were not fitted better than the fit without it.

    In likelihood, which weighs slow errors most, and in rms, which is what is reported. The rms may not rise. Far from
    the noise it has to fall: there, something else is missing, and a wrong effect gains likelihood, too.
    """
    errors = _errors(before, after)
    without, rest, _ = _volts(errors)
    limit = 1.0 + (-MAX_CHANGE_UNSEEN if _is_far_from_noise(errors) else MAX_CHANGE_UNSEEN)
    return _log_likelihood_gain(before, after) > _min_gain(after) and rest <= limit * without


def removed_remark(name: str, before: Fit, after: Fit) -> Remark:
    """Whether a removed effect is needed: code ``needed`` or ``not_needed``, by the same limits as `added_remark`.

    Parameters
    ----------
    before, after : Fit
        The model with and without the effect.
    """
    errors = _errors(before, after)
    if helps(after, before):
        with_it = {**errors, "before_v": errors["after_v"], "after_v": errors["before_v"]}
        if not _falls(with_it):
            text = "{effect} is needed by its evidence ({gain}), though without it {of} {course}"
            return _remark("needed", text, name, errors, _gain_words(after, before))
        text = "{effect} is needed: without it {of} {course}" + _while_much_is_left(with_it)
        return _remark("needed", text, name, errors)
    return _remark("not_needed", "{effect} is not needed: without it {of} {course}", name, errors)


def _remark(code: str, text: str, name: str, errors: dict[str, float | str | None], gain: str = "") -> Remark:
    remark = Remark.of(code, text, effect=plain(name), gain=gain, **_in_words(errors))
    return remark.model_copy(update={"values": {"effect": name, **errors}})


def _errors(before: Fit, after: Fit) -> dict[str, float | str | None]:
    """rms errors of held-out segments, or of fitted ones where none are held out [V]."""
    use = _evaluated_rows(before)
    return {
        "judged_on": "held_out" if use is held_out else "fitted",
        "before_v": mean_rms_v(before, use),
        "after_v": mean_rms_v(after, use),
        "noise_v": noise_rms_v(after, use),
    }


def _in_words(errors: dict[str, float | str | None]) -> dict[str, str]:
    first, last = (quantity(_number(errors[key]), "V") for key in ("before_v", "after_v"))
    if first == last:
        course = f"stays at {last}"
    else:
        falls = (_number(errors["after_v"]) or 0.0) < (_number(errors["before_v"]) or 0.0)
        course = f"{'falls' if falls else 'rises'} from {first} to {last}"
    of = "the held-out error" if errors["judged_on"] == "held_out" else "the error (nothing was held out)"
    only = "only " if course.startswith("falls") else ""
    return {"of": of, "only": only, "course": course, "noise": quantity(_number(errors["noise_v"]), "V")}


def _while_much_is_left(errors: dict[str, float | str | None]) -> str:
    """A warning where most of the error is left with the effect: then a wrong effect may help, too."""
    without, rest, _ = _volts(errors)
    if rest <= MAX_PART_LEFT * without or not _is_far_from_noise(errors):
        return ""
    return "; most of the error is still there, beside which this says little"


def _is_far_from_noise(errors: dict[str, float | str | None]) -> bool:
    """Whether the error with the effect is so far above the noise that something large is missing."""
    _, rest, noise = _volts(errors)
    return rest > SEVERAL_TIMES_THE_NOISE * noise


def _falls(errors: dict[str, float | str | None]) -> bool:
    """Whether the error falls with the effect in the digits that are printed."""
    return _in_words(errors)["course"].startswith("falls")


def _gain_words(worse: Fit, better: Fit) -> str:
    gain = number(_log_likelihood_gain(worse, better), 3, power_from=1e5)
    return f"+{gain} nat of log likelihood, {number(_min_gain(better), 2)} are enough"


def _volts(errors: dict[str, float | str | None]) -> tuple[float, float, float]:
    """Error without and with the effect, and of the noise [V]; zero where one is unknown."""
    without, rest, noise = (_number(errors[key]) or 0.0 for key in ("before_v", "after_v", "noise_v"))
    return without, rest, noise


def _number(value: float | str | None) -> float | None:
    return value if isinstance(value, float) else None


def _evaluated_rows(fit: Fit) -> Callable[[SegmentData], bool]:
    return held_out if any(map(held_out, fit.prepared.pieces)) else training


def _log_likelihood_gain(worse: Fit, better: Fit) -> float:
    """Gain in log likelihood of the evaluated rows by the better model, with the noise inflated to its chi2 [nat]."""
    use = _evaluated_rows(worse)
    rows = sum(e.size for p, e in zip(worse.prepared.pieces, worse.residual, strict=True) if use(p))
    first, last = worse.chi2_of(use) or 0.0, better.chi2_of(use) or 0.0
    return 0.5 * rows * (first - last) / max(1.0, last)


def _min_gain(fit: Fit) -> float:
    """Gain from which an effect helps [nat]; larger for fitted rows, which gain by any additional parameter."""
    limits = fit.criteria.selection
    return limits.tie if _evaluated_rows(fit) is held_out else limits.log_evidence


def _amplitudes_that_hold_zero(fit: Fit, found: FoundEffect) -> list[str]:
    """Text for the amplitudes if all of their intervals contain neutral; else empty."""
    active = next(a for a in fit.model.active if a.name == found.name)
    names = []
    for name in active.candidate.amplitudes:
        interval = found.parameters.get(name)
        if interval is None or interval.low is None or interval.high is None:
            continue
        if not interval.low <= active.candidate.named(name).neutral <= interval.high:
            return []
        names.append(parameter_words(name))
    return names
