"""The course of a search in a few sentences: the moves that changed the model, and what kept each effect in it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number, percent
from orchestrator.formatting.sentences import listed
from protocols import SearchEvent, SearchMove

MIN_FALL_RATIO = 0.1
"""Fall of chi2 over its former value from which a shape that is fitted too is worth a sentence."""
LESS_EVIDENCE = "with less log evidence, which decides and counts parameters and usual sizes, too"
LEFT_OUT = (
    "numbers left out: trials that changed nothing, fits that prepare the next step, changes of an effect's form that "
    f"lower chi2 by less than {percent(100.0 * MIN_FALL_RATIO)}, and the choice of the causes below"
)
WITHOUT_IT = (
    "without it: the other effects are refitted then; the ladder of `diagnose` adds the effects one by one, at their "
    "final sizes, so that its chi2 over the same stages is another"
)
DATA_LINES = {
    "part": "on a part of the recording, which is faster; chi2 is that of this part:",
    "whole": "on the whole recording; chi2 is that of all fitted stages:",
}


def search_summary(events: Sequence[SearchEvent]) -> list[str]:
    """What a search did, in order: a sentence for each decisive move, with its number.

    A line without a number says on which data the next moves were made. A sentence that would be repeated is left out,
    and so is a tie that another move states.
    """
    last_screen = max((e.step for e in events if e.move == "screen" and e.data == "whole"), default=None)
    lines: list[str] = []
    data = "whole"
    tried: list[SearchEvent] = []
    model: set[str] = set()
    found_together: set[str] = set()
    stated: set[str] = set()
    repeated = _repeated(events)
    for event in events:
        if event.move == "screen":
            tried = []
        if event.move == "refit":
            tried.append(event)
        sentence = _none_is_missing(event) if event.step == last_screen else _sentence(event, tried, model)
        if event.decision == "accepted":
            if event.move == "full_model":
                found_together = set(event.effects) - model
            elif event.move == "remove" and found_together:
                sentence = f"{sentence}{_new_ones(found_together - set(event.effects))}"
                found_together = set()
            model = _model_after(event, model)
        if sentence is None or sentence in stated or event.step in repeated:
            continue
        stated.add(sentence)
        if event.data != data:
            data = event.data
            lines.append(DATA_LINES[data])
        lines.append(f"{event.step}. {sentence}")
    return lines


def search_notes(events: Sequence[SearchEvent]) -> list[str]:
    """What a search's summary leaves out, and how its values of chi2 stand to those of `diagnose`."""
    numbers = [int(line.split(".")[0]) for line in search_summary(events) if line[0].isdigit()]
    is_kept = any(event.move == "remove" and _is_kept(event) for event in events)
    return [LEFT_OUT] * (len(numbers) < len(events)) + [WITHOUT_IT] * is_kept


def noise_note(events: Sequence[SearchEvent]) -> str:
    """Why the reasons' first chi2 is not that of the search's beginning; empty where noise was not counted anew."""
    counted = [event.step for event in events if event.move == "noise" and event.decision == "accepted"]
    first = next((event.chi2_after for event in events if event.move == "baseline"), None)
    if not counted or first is None:
        return ""
    begins = f"the search begins at chi2 {number(first, 4)}, before that step"
    return f"These values count the noise as step {counted[-1]} of the search does; {begins}."


def _model_after(event: SearchEvent, model: set[str]) -> set[str]:
    """The effects of the model after an accepted move."""
    names = set(event.effects)
    if event.move in ("baseline", "add", "full_model"):
        return model | names
    if event.move in ("swap", "merge"):
        return model - names | set(event.effects[:1])
    return model - names if event.move == "remove" else model


def _new_ones(names: set[str]) -> str:
    return (
        f"; {listed(sorted(plain(name) for name in names))} {'is' if len(names) == 1 else 'are'} new" if names else ""
    )


def _sentence(event: SearchEvent, tried: Sequence[SearchEvent], model: Collection[str]) -> str | None:
    """A sentence on a move; None for one that left the model as it was and decided nothing."""
    if event.move == "add" and event.decision == "accepted":
        return f"{_names(event)} {_is(event)} added: {_course(event)}{_runner_up(event, tried)}"
    if event.move == "full_model" and event.decision == "accepted":
        return _all_together(event, model)
    if event.move == "remove":
        return _removed(event)
    if event.move in ("swap", "merge") and len(event.effects) == 2:
        return _exchanged(event)
    if event.move == "name" and event.decision == "rejected" and event.measure == "share":
        return _no_cause(event)
    text = _ACCEPTED.get(event.move)
    return None if text is None or event.decision != "accepted" else text(event)


def _all_together(event: SearchEvent, model: Collection[str]) -> str:
    """Why and with what success all effects are fitted at once."""
    why = (
        f"{listed(sorted(plain(name) for name in model))} leave more than noise"
        if len(model) > 1
        else "no single one promises half of what all absent ones do together"
    )
    return f"{why}, so all {len(event.effects)} effects that it can show are fitted together: {_course(event)}"


def _no_cause(event: SearchEvent) -> str:
    """Why an effect of the model is not named: too small a share, or the reason where the share is large enough."""
    share, limit = (percent(None if x is None else 100.0 * x) for x in (event.score, event.threshold))
    is_enough = event.score is not None and event.threshold is not None and event.score >= event.threshold
    what = f"{_names(event)} is in the model and no cause"
    if is_enough and event.note:
        return f"{what}, although it is {share} of the first error and {limit} are needed: {event.note}"
    return f"{what}: {share} of the first error, {limit} needed{f'; {event.note}' if event.note else ''}"


def _removed(event: SearchEvent) -> str | None:
    if event.decision == "accepted" and event.measure == "block_scatter":
        scatter = percent(None if event.score is None else 100.0 * event.score)
        return f"{_names(event)} {_is(event)} removed: the size differs by {scatter} between parts of the recording"
    allowed = f", where explained allows up to {number(event.threshold, 3)}" if event.measure == "chi2_per_dof" else ""
    if event.decision == "accepted":
        why = f" ({event.note})" if event.note else ", which the data do not require"
        return f"{_names(event)} {_is(event)} removed{why}: {_course(event)}{allowed}"
    if not _is_kept(event):
        return None
    without = "it" if len(event.effects) == 1 else "them"
    return f"{_names(event)} {_stays(event)}: without {without} chi2 is {number(event.chi2_after, 4)}{allowed}"


def _is_kept(event: SearchEvent) -> bool:
    """Whether a removal on the whole recording was refused for what it leaves."""
    return event.decision != "accepted" and event.data == "whole" and event.chi2_after is not None


def _exchanged(event: SearchEvent) -> str | None:
    new, old = (plain(name) for name in event.effects)
    if event.decision == "accepted":
        tie = f", two that {_BY[event.data]} does not separate" if event.note else ""
        return f"{new} takes the place of {old}: {_course(event)}{tie}"
    if not event.note:
        return None
    values = [number(x, 4) for x in (event.chi2_before, event.chi2_after) if x is not None]
    sizes = f"chi2 {values[0]} with {old}, {values[1]} with {new}" if len(values) == 2 else f"chi2 {listed(values)}"
    return f"{new} in place of {old}: {_BY[event.data]} does not separate the two, {sizes}"


def _repeated(events: Sequence[SearchEvent]) -> set[int]:
    """Steps that changed nothing and found what another step states: a tie of two effects, or what one absent leaves.

    A tie is stated where the model changed, else last; an absence where its limit is known, else first.
    """
    ties: dict[frozenset[str], list[SearchEvent]] = {}
    absences: dict[tuple[object, ...], list[SearchEvent]] = {}
    for event in events:
        if event.move in ("swap", "merge") and event.note:
            ties.setdefault(frozenset(event.effects), []).append(event)
        elif event.move == "remove" and _is_kept(event):
            absences.setdefault((event.effects, number(event.chi2_after, 4)), []).append(event)
    repeated = set()
    for tied in ties.values():
        stated = next((event for event in tied if event.decision == "accepted"), tied[-1])
        repeated |= {event.step for event in tied if event.decision != "accepted" and event is not stated}
    for same in absences.values():
        stated = next((event for event in same if event.measure == "chi2_per_dof"), same[0])
        repeated |= {event.step for event in same if event is not stated}
    return repeated


_BY: Mapping[str, str] = {"part": "this part", "whole": "the recording"}


def _none_is_missing(event: SearchEvent) -> str | None:
    if event.decision != "rejected" or event.score is None or event.threshold is None:
        return None
    best, gain, needed = _names(event), number(event.score, 3), number(event.threshold, 3)
    return f"no absent effect is worth adding: the best, {best}, lowers the summed chi2 by {gain}, {needed} needed"


def _runner_up(event: SearchEvent, tried: Sequence[SearchEvent]) -> str:
    others = [one for one in tried if one.effects != event.effects and one.chi2_after is not None]
    if not others:
        return ""
    best = max(others, key=lambda one: one.score or 0.0)
    leaves = f"; {_names(best)} instead would leave {number(best.chi2_after, 4)}"
    is_lower = event.chi2_after is not None and best.chi2_after is not None and best.chi2_after < event.chi2_after
    return f"{leaves}, {LESS_EVIDENCE}" if is_lower else leaves


def _shape(event: SearchEvent) -> str | None:
    before, after = event.chi2_before, event.chi2_after
    if before is None or after is None or before - after < MIN_FALL_RATIO * before:
        return None
    return f"the form of {_names(event)} is fitted, too: {_course(event)}"


_ACCEPTED: Mapping[SearchMove, Callable[[SearchEvent], str | None]] = {
    "baseline": lambda e: f"the search begins at chi2 {number(e.chi2_after, 4)}",
    "free_shape": _shape,
    "switch_form": lambda e: f"{_names(e)} takes its other form: {_course_with_evidence(e)}",
    "finer_map": lambda e: f"a finer flux map is taken: {_course_with_evidence(e)}",
    "coarser_map": lambda e: f"a coarser flux map is enough: {_course_with_evidence(e)}",
    "noise": lambda e: (
        f"scatter between segments, or the model's own error, counts as noise: {_course_with_evidence(e)}"
    ),
    "quantiser": lambda e: f"the PWM timer's rounding is accounted for: {_course(e)}",
    "switching_ripple": lambda e: f"the current's ripple within a PWM period is accounted for: {_course(e)}",
}
"""Sentences on moves that change the model when they are accepted."""


def _course(event: SearchEvent) -> str:
    values = [number(x, 4) for x in (event.chi2_before, event.chi2_after) if x is not None]
    return f"chi2 {' → '.join(dict.fromkeys(values))}"


def _course_with_evidence(event: SearchEvent) -> str:
    """The course of chi2, and what decided: the rise of the log evidence, or the fall of the summed chi2."""
    change = _CHANGES.get(event.measure or "")
    if change is None or event.score is None or event.threshold is None:
        return _course(event)
    return f"{_course(event)}; {change.format(number(event.score, 3))}, {number(event.threshold, 3)} needed"


_CHANGES: Mapping[str, str] = {
    "log_evidence": "log evidence rises by {} nat",
    "objective": "the summed chi2 falls by {}",
}
"""Changes by which a map, a form or noise is accepted."""


def _names(event: SearchEvent) -> str:
    names = [plain(name) for name in event.effects]
    return listed(names) if len(names) <= 3 else f"{len(names)} effects"


def _is(event: SearchEvent) -> str:
    return "is" if len(event.effects) == 1 else "are"


def _stays(event: SearchEvent) -> str:
    return "stays" if len(event.effects) == 1 else "stay"
