"""`fluxbench check --isolability`: the effects that a procedure detects and separates, and stages to add."""

from __future__ import annotations

from textwrap import wrap

from orchestrator.experiment_design.outlook import IsolabilityReport
from orchestrator.formatting.quantities import quantity
from orchestrator.formatting.sentences import columns, listed
from orchestrator.interface.cli._output import say, say_table, stage_as_yaml

_MAX_PRINTED_SIZE = 0.995
"""Larger sizes print as dashes: such an effect is not detected, or not separated, at its typical size."""


def say_isolability(report: IsolabilityReport) -> None:
    """Print the isolability of a plan's effects."""
    say("", f"detection with {quantity(report.noise_a, 'A')} of noise in each phase's reading:")
    numbers = {effect.name: str(k) for k, effect in enumerate(report.effects, 1)}
    rows = [
        (
            f"{numbers[e.name]:>2} {e.name}",
            quantity(e.typical, e.unit),
            quantity(e.least, e.unit),
            _percent(e.found_from),
            _percent(e.among_all_from),
        )
        for e in report.effects
    ]
    say_table(("effect", "typical", "detected from", "in %", "among all, in %"), rows)
    say("", "separated from, in % of their typical size; -- where a larger size is needed:")
    say(*columns(_matrix(report, numbers), numbers=True))
    _print_additions(report)


def _matrix(report: IsolabilityReport, numbers: dict[str, str]) -> list[list[str]]:
    """The lower half of the symmetric matrix."""
    names = list(numbers)
    head = ["".ljust(3), "".join(n.rjust(3) for n in list(numbers.values())[:-1])]
    rows = []
    for k, name in enumerate(names[1:], 1):
        cells = "".join(_percent(report.parted_from(name, other)).rjust(3) for other in names[:k])
        rows.append([f"{numbers[name]:>2} {name}", cells.ljust(3 * (len(names) - 1))])
    return [head, *rows]


def _percent(size: float | None) -> str:
    return "--" if size is None or size >= _MAX_PRINTED_SIZE else f"{100.0 * size:.0f}"


def _print_additions(report: IsolabilityReport) -> None:
    if report.additions:
        say("", "to add, as stages of the procedure:")
    for addition in report.additions:
        what = f"{addition.minutes:.2g} min: {', '.join(map(_question, addition.settles))}"
        say(*wrap(what, 96, initial_indent="  # ", subsequent_indent="  # "), stage_as_yaml(addition.stage))
    if report.open:
        say("", "undecided at typical sizes, whatever stage is added:")
    for one in report.open:
        what = f"{one.effects[0]} is not detected" if len(one.effects) == 1 else "{} or {}".format(*one.effects)
        say(f"  {what}" + (f" (needs {listed(one.needs)})" if one.needs else ""))


def _question(question: tuple[str, ...]) -> str:
    return f"{question[0]} is detected" if len(question) == 1 else "{} or {}".format(*question)
