"""The reasons of a diagnosis as rows and sentences, for terminal, page and viewer."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import UNKNOWN, number, percent
from orchestrator.formatting.results import part_words, probability_words
from orchestrator.formatting.sentences import listed
from protocols import DiagnosisReport, EffectBasis, Explanation, Reason, SearchEvent, SearchMeasure, VerdictLimits

SEARCH_HEAD = ("step", "move", "recording", "effects", "gain", "needed", "chi2", "outcome")
LOG_EVIDENCE_SCALE = (
    "log evidence in nat: 5 nat are odds of 150 to 1; each sample adds to it, so that large values are usual"
)
_MOVE_NAMES: Mapping[str, str] = {"free_shape": "fit its shape", "fix_shape": "hold its shape"}
"""Moves whose names in `diagnosis.json` are not plain words."""
_OUTCOMES: Mapping[tuple[str, str], str] = {
    ("screen", "tested"): "refitted next",
    ("screen", "rejected"): "too small",
    ("refit", "tested"): "compared",
}
"""Decisions of `diagnosis.json` that mean something of their own in a move."""
_MOVE_MEANINGS: Mapping[str, str] = {
    "screen": "the fall of chi2 that each absent effect promises, without a fit; below a tenth of the misfit that is "
    "left, or within chance, none is tried",
    "refit": "a fit with one of these effects each; the one of the largest gain is added next",
    "add": "fitted on from the refit, linearised anew, so that its chi2 may differ from the refit's",
    "full_model": "all effects of the library at once, where two leave more than noise, or no single one promises half "
    "of what all do; those that nothing requires are removed again",
    "swap": "one effect in place of another",
    "merge": "two effects that the recording does not separate become one",
    "free_shape": "the form of an effect's curve is fitted, too",
    "fix_shape": "the form of an effect's curve is held",
    "switch_form": "the other form of an effect",
    "finer_map": "more detail of the flux map; after an add it was tried in its place, hence from the same chi2",
    "coarser_map": "less detail of the flux map",
    "noise": "scatter between segments, or the model's own error, as noise",
    "quantiser": "the rounding of the PWM timer",
    "switching_ripple": "the current's ripple within a carrier period",
    "name": "an effect of the model as a cause in the report",
}
"""Of the moves whose names do not say it, for a legend."""
_MEASURE_MEANINGS: Mapping[str, str] = {
    "chi2": "Δchi2: fall of the squared error over the noise's variance, summed over all samples",
    "objective": "Δchi2: fall of the squared error over the noise's variance, summed over all samples",
    "log_evidence": "nat: rise of the log evidence, the natural logarithm of the odds; 3 nat are odds of 20 to 1, "
    "16 nat of 9 million to 1",
    "chi2_per_dof": "chi2: its value after the move, per degree of freedom; it has to stay below what is needed",
    "block_scatter": "%: scatter of the effect's size between parts of the recording; above the limit it is no cause",
    "share": "%: part of the first model's error",
}
_MAX_NAMES = 4
"""Effects of one step of the search that are written out."""


def reason_sentences(reasons: Sequence[Reason]) -> list[str]:
    """The reasons' sentences; one value beside several limits is one sentence."""
    limits: dict[str, list[str]] = {}
    for reason in reasons:
        value, separator, limit = reason.sentence.partition("; ")
        limits.setdefault(value, []).extend([limit.removesuffix(".")] if separator else [])
    return [f"{value}; {', '.join(some)}." if some else value for value, some in limits.items()]


def search_rows(events: Sequence[SearchEvent]) -> list[tuple[str, ...]]:
    """The steps of a search: number, move, part or whole of the recording, effects, gain, needed, chi2, outcome."""
    return [
        (
            str(event.step),
            _move_name(event.move),
            event.data,
            _names(event) if event.effects else event.note or UNKNOWN,
            _scored(event.score, event.measure),
            _scored(event.threshold, event.measure),
            " → ".join(number(x, 4) for x in (event.chi2_before, event.chi2_after) if x is not None) or UNKNOWN,
            _outcome(event),
        )
        for event in events
    ]


def search_legend(events: Sequence[SearchEvent]) -> list[str]:
    """The meaning of the moves and gains that occur in a search, a line each."""
    moves = dict.fromkeys(event.move for event in events if event.move in _MOVE_MEANINGS)
    gains = dict.fromkeys(
        _MEASURE_MEANINGS[event.measure] for event in events if event.measure and event.score is not None
    )
    parts = {event.data for event in events}
    data = ["recording: part is a share of the segments, on which a search begins because it is faster; whole is all"]
    return [
        *(data if "part" in parts else []),
        *(f"{_move_name(move)}: {_MOVE_MEANINGS[move]}" for move in moves),
        *gains,
    ]


def _outcome(event: SearchEvent) -> str:
    outcome = _OUTCOMES.get((event.move, event.decision), event.decision)
    return f"{outcome}: {event.note}" if event.effects and event.note else outcome


def _move_name(move: str) -> str:
    return _MOVE_NAMES.get(move, plain(move))


def search_lines(events: Sequence[SearchEvent]) -> list[str]:
    """The steps of a search, one line each."""
    lines = []
    for event, row in zip(events, search_rows(events), strict=True):
        step, move, data, effects, gain, threshold, chi2, decision = row
        where = " on a part of the recording" if data == "part" else ""
        parts = [f"{step}. {move}{where}" + (f": {effects}" if effects != UNKNOWN else "")]
        if event.score is not None:
            parts.append(f"gain {gain}" + ("" if event.threshold is None else f" (needed {threshold})"))
        parts += [f"chi2 {chi2}"] if chi2 != UNKNOWN else []
        lines.append("; ".join([*parts, decision]))
    return lines


def basis_head(explanation: Explanation) -> tuple[str, ...]:
    """Heads of the columns of `basis_rows`; below them the limits that this diagnosis compared them with."""
    search, record = explanation.search, explanation.verdict_record
    heads = (
        ["effect"],
        ["of its typical size"],
        ["error without it", *_limit(search, "name", "share")],
        ["log evidence", *_limit(search, "add", "log_evidence")],
        ["probability"],
        ["material", *([] if record is None else _material_limits(record.limits))],
        ["steps"],
        ["indistinguishable from"],
    )
    height = max(map(len, heads))
    return tuple("\n".join([*lines, *[" "] * (height - len(lines))]) for lines in heads)


def limit_notes(explanation: Explanation) -> list[str]:
    """What the limits in `basis_head` decide, for those that occur."""
    search = explanation.search
    added = "limit of the log evidence: what an effect that is added alone has to bring"
    named = (
        "limit of the error without it: above it, or if material, an effect is a cause where all were fitted at once"
    )
    pairs = ((added, _limit(search, "add", "log_evidence")), (named, _limit(search, "name", "share")))
    return [note for note, limit in pairs if limit]


def _limit(events: Sequence[SearchEvent], move: str, measure: SearchMeasure) -> list[str]:
    """The one limit of the accepted moves of a kind, for the head of a column; none where there are several."""
    limits = {e.threshold for e in events if (e.move, e.measure, e.decision) == (move, measure, "accepted")}
    limit = limits.pop() if len(limits) == 1 else None
    return [] if limit is None else [f"> {_scored(limit, measure)}"]


def _material_limits(limits: VerdictLimits) -> list[str]:
    flux, volts = percent(100.0 * limits.material_flux), percent(100.0 * limits.material_voltage)
    return [f"> {flux} of flux", f"or {volts} of voltage"]


def basis_rows(effects: Sequence[EffectBasis], events: Sequence[SearchEvent] = ()) -> list[tuple[str, ...]]:
    """The evidence for each named effect, marked where it is of a part of the recording; see `basis_head`."""
    return [
        (
            plain(effect.name),
            percent(None if effect.relative_size is None else 100.0 * effect.relative_size),
            part_words(effect),
            _scored(effect.log_evidence, "log_evidence") + (" (part)" if _is_of_part(effect, events) else ""),
            probability_words(effect, [other.name for other in effects]),
            {None: UNKNOWN, True: "yes", False: "no"}[effect.material],
            ", ".join(map(str, effect.steps)) or UNKNOWN,
            listed([plain(twin) for twin in effect.twins]) or "nothing",
        )
        for effect in effects
    ]


def log_evidence_notes(effects: Sequence[EffectBasis], events: Sequence[SearchEvent]) -> list[str]:
    """How to read the log evidence of named effects."""
    part = "part: on that part of the recording on which the search added the effect; of the whole it is mostly more"
    return [LOG_EVIDENCE_SCALE] + [part] * any(_is_of_part(effect, events) for effect in effects)


def _is_of_part(effect: EffectBasis, events: Sequence[SearchEvent]) -> bool:
    """Whether an effect's log evidence is the gain of a move on a part of the recording."""
    return effect.log_evidence is not None and any(
        event.data == "part"
        and event.move == "add"
        and event.step in effect.steps
        and event.score is not None
        and math.isclose(event.score, effect.log_evidence)
        for event in events
    )


def accuracy_sentences(report: DiagnosisReport) -> list[str]:
    """Sentences on the error of the predicted current and of the map; none where these are unknown."""
    sentences = []
    if report.reproduces_current_percent is not None:
        sentences.append(
            "The current that the model predicts from the voltage differs from the measured one by "
            f"{percent(report.reproduces_current_percent)} of its range (rms)."
        )
    if report.map_error_percent is not None:
        is_right = report.verdict in ("clean", "explained", "explained_in_another_form")
        start = "The model's" if is_right else "If the model is right, its"
        sentences.append(
            f"{start} flux map is known to ±{percent(report.map_error_percent)} of the rated flux (95 %, of noise "
            "alone, rms over the measured currents; over the whole map, edges included, it is more)."
        )
    return sentences


def _names(event: SearchEvent) -> str:
    """Names of the effects of a step, as many as fit on a line."""
    names = event.effects
    if event.move in ("swap", "merge") and len(names) == 2:
        return f"{plain(names[0])} for {plain(names[1])}"
    if len(names) <= _MAX_NAMES:
        return listed([plain(name) for name in names]) or UNKNOWN
    return f"{', '.join(map(plain, names[: _MAX_NAMES - 1]))} and {len(names) - _MAX_NAMES + 1} more"


def _scored(value: float | None, measure: SearchMeasure | None) -> str:
    if value is None or measure is None:
        return UNKNOWN
    if measure in ("block_scatter", "share"):
        return percent(100.0 * value)
    # For large values, digits after the point decide nothing.
    text = number(round(value) if abs(value) >= 1000.0 and math.isfinite(value) else value, 3, power_from=1e5)
    return {"log_evidence": f"{text} nat", "chi2_per_dof": f"chi2 {text}"}.get(measure, f"Δchi2 {text}")
