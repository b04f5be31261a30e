"""Acceptance of a motor: each measured quantity against its limits, with the reason in words."""

from __future__ import annotations

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import measured, quantity
from orchestrator.formatting.results import USABILITY_WORDS
from orchestrator.shelf.results import RunResults
from protocols import Acceptance, AcceptanceReason, AcceptanceResult, Interval, Usability

SYMBOLS = {
    "resistance_ohm": "R_s", "l_dd_h": "L_dd", "l_qq_h": "L_qq", "rated_flux_wb": "rated flux",
    "map_error_percent": "map error",
}  # fmt: skip
"""Name in print of each quantity that may have limits."""
UNITS = {"resistance_ohm": "ohm", "l_dd_h": "H", "l_qq_h": "H", "rated_flux_wb": "Wb", "map_error_percent": "%"}
_OF_MAP = ("l_dd_h", "l_qq_h", "rated_flux_wb", "map_error_percent")


def judge_acceptance(limits: Acceptance, results: RunResults) -> AcceptanceResult:
    """Whether results keep their limits, with a reason for each quantity that has one.

    What was not measured does not pass, nor what comes of a map that is not usable.
    """
    reasons = [_reason(name, limits, results) for name in SYMBOLS if limits.bounds(name) != (None, None)]
    if limits.verdicts:
        reasons.append(_of_verdict(limits, results))
    return AcceptanceResult(passed=all(reason.passed for reason in reasons), reasons=tuple(reasons))


def _reason(name: str, limits: Acceptance, results: RunResults) -> AcceptanceReason:
    value, (low, high) = results.quantities.get(name), limits.bounds(name)
    objection = _objection(name, value, low, high, results.usability)
    text = "not measured" if value is None else measured(value.value, value.low, value.high, value.unit)
    sentence = f"{SYMBOLS[name]} {text}: {objection or 'passes'}, limit {_limit_words(name, low, high)}"
    return AcceptanceReason(quantity=name, passed=objection == "", value=value, min=low, max=high, sentence=sentence)


def _objection(
    name: str, value: Interval | None, low: float | None, high: float | None, usability: Usability | None
) -> str:
    """Why a quantity does not pass; empty where it does."""
    if value is None:
        return "does not pass"
    if low is not None and value.value < low:
        return "too small"
    if high is not None and value.value > high:
        return "too large"
    if (low is not None and value.low < low) or (high is not None and value.high > high):
        return "its interval exceeds the limit"
    if name in _OF_MAP and usability is not Usability.USABLE:
        return f"the map is {USABILITY_WORDS[usability or Usability.NOT_JUDGED]}"
    return ""


def _limit_words(name: str, low: float | None, high: float | None) -> str:
    least, most = (quantity(bound, UNITS[name], 5) for bound in (low, high))
    if low is None:
        return f"at most {most}"
    return f"at least {least}" if high is None else f"{least} to {most}"


def _of_verdict(limits: Acceptance, results: RunResults) -> AcceptanceReason:
    passed = results.verdict in limits.verdicts
    expected = " or ".join(plain(verdict) for verdict in limits.verdicts)
    text = "not diagnosed" if results.verdict is None else plain(results.verdict)
    sentence = f"verdict {text}: {'passes' if passed else 'does not pass'}, limit {expected}"
    return AcceptanceReason(quantity="verdict", passed=passed, value=None, sentence=sentence)
