"""`fluxbench check --isolability`: what a procedure will be able to tell, as two tables and what to add."""

from __future__ import annotations

from textwrap import wrap

from orchestrator.cli._output import say, say_table, stage_as_yaml
from orchestrator.experiment_design.outlook import IsolabilityReport
from orchestrator.formatting.quantities import quantity
from orchestrator.formatting.sentences import columns, listed

_TOO_LARGE = 0.995
"""Sizes that print as 100 % and more are dashes: such an effect is not found, or not told apart, at a typical size."""


def say_isolability(report: IsolabilityReport) -> None:
    """Print what a plan will be able to tell."""
    least = f"what it would find with {quantity(report.noise_a, 'A')} of noise"
    say("", f"{least} in each phase's reading:")
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
    say_table(("effect", "typical", "found from", "in %", "among all, in %"), rows)
    say("", "told apart from, in % of their typical size; -- only where they are larger than that:")
    say(*columns(_matrix(report, numbers), numbers=True))
    _say_what_to_do(report)


def _matrix(report: IsolabilityReport, numbers: dict[str, str]) -> list[list[str]]:
    """The lower half; the matrix is symmetric."""
    names = list(numbers)
    head = ["".ljust(3), "".join(n.rjust(3) for n in list(numbers.values())[:-1])]
    rows = []
    for k, name in enumerate(names[1:], 1):
        cells = "".join(_percent(report.parted_from(name, other)).rjust(3) for other in names[:k])
        rows.append([f"{numbers[name]:>2} {name}", cells.ljust(3 * (len(names) - 1))])
    return [head, *rows]


def _percent(size: float | None) -> str:
    return "--" if size is None or size >= _TOO_LARGE else f"{100.0 * size:.0f}"


def _say_what_to_do(report: IsolabilityReport) -> None:
    if report.additions:
        say("", "to add, as stages of the procedure:")
    for addition in report.additions:
        what = f"{addition.minutes:.2g} min: {', '.join(map(_question, addition.settles))}"
        say(*wrap(what, 96, initial_indent="  # ", subsequent_indent="  # "), stage_as_yaml(addition.stage))
    if report.open:
        say("", "open at typical sizes, whatever stage is added:")
    for one in report.open:
        what = f"{one.effects[0]} is not found" if len(one.effects) == 1 else "{} or {}".format(*one.effects)
        say(f"  {what}" + (f" (it takes {listed(one.needs)})" if one.needs else ""))


def _question(question: tuple[str, ...]) -> str:
    return f"{question[0]} is found" if len(question) == 1 else "{} or {}".format(*question)
