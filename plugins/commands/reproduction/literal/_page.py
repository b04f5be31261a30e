"""The literal page: the paper's own evaluation beside fluxbench's, what makes its errors, and what differs from it."""

from __future__ import annotations

import time
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path

from orchestrator.formatting.names import PAPER_CROSSINGS
from orchestrator.formatting.quantities import UNKNOWN, fixed, percent
from orchestrator.formatting.sentences import markdown_table
from orchestrator.numerics.types import Array
from orchestrator.recording import replace_file
from plugins.commands.reproduction.literal._budget import ALL, IRON, IRON_ALL, NOISE, RULE, Budget, Row
from plugins.commands.reproduction.literal._evaluation import Errors, Literal
from plugins.commands.reproduction.literal._figures import GAP, SIGNAL, draw_all
from plugins.commands.reproduction.literal._paths import parity_percent

PAGE_NAME = "literal.md"


def write_page(measured: Literal, budget: Budget, folder: Path) -> Path:
    """Write the literal page and its pictures into a folder; returns the page's path."""
    folder.mkdir(parents=True, exist_ok=True)
    draw_all(measured, budget, folder)
    page = folder / PAGE_NAME
    replace_file(page, _text(measured, budget).encode())
    return page


def _text(measured: Literal, budget: Budget) -> str:
    rule = budget.row(RULE)
    iron = budget.sources.hysteresis
    most = max(float(row.literal.crossings[1]) for row in budget.rows)
    return f"""# The paper, literally

The same experiment as on [the other page](README.md), evaluated as the paper prints it: R_s as voltage over
current, no knowledge of the inverter, the printed demodulator with its misprint corrected, inductances summed by
rectangles from zero flux outwards, and the polynomial energy fitted to second derivatives. Beside it what fluxbench
makes of the same samples, and what makes the errors: each source switched on alone, on the simulated plant, an
experiment to the letter each time.

Written by `fluxbench reproduce --literal` on {time.strftime("%Y-%m-%d", time.gmtime())}. Percentages are of the rated
flux, |psi(rated i_q) - psi(0, 0)|, unless they say otherwise.

## The numbers

{_numbers(measured, budget)}

## What makes the errors

Injection as printed. The paper's figures are 1.3 % on d and 2.9 % on q, and it does not say of what: "relative" may
be to the flux where the paths cross, so both readings are given (the second where there is a quarter of the rated
flux or more). The last columns are what the paper could not know: the distance from the plant's flux over all points.

{_sources(budget)}

The rule makes {_pair(rule.literal.crossings)} by itself, and nearly all of the map's error on a sound bench: each step
takes the inductance at its outer end, which saturation has made the smaller one, so the flux comes out up to
{_two(rule.literal.worst)} short. R_s, which the method never uses, and noise add nothing. The inverter does: dead time
follows the ripple where a phase current passes zero. The largest psi_q of the table is {_two(most)}: what made the
paper's 2.9 % is not known.

Integration without a model of the inverter is worth nothing, as the paper's figure 2 shows:

{_integration(budget)}

## What each step of the method is worth

{_steps(budget)}

Vectors that stand, half of the time on d and half on q ("at least two independent vectors"), instead of one that
turns, on the bench with all of it:

{_vectors(budget)}

A vector that turns averages over the directions in which dead time hurts.

## Figure 7's gap

By how much the flux of injection is above that of integration, by least squares along both axes; without an inverter,
for integration is then right. Hysteresis: {1e3 * iron["half_width_a"]:.0f} mA of half width, a
reversible inductance of {100.0 * iron["reversible_ratio"]:.0f} % of the slope.

{_gaps(budget)}

The paper suspects hysteresis. The sums by rectangles make a gap of the same sign without any: whoever looks for
hysteresis in it has to take the rule out first.

![gap]({GAP})

*Flux by injection less flux by integration (figure 7's difference), with hysteresis and without, by rectangles and
improved.*

## Parity

Largest departure from even (11, 22) and odd (12) in i_q, in percent of the mean of the diagonal: "experimentally
satisfied, both for the Hessian matrix and its inverse".

{_parity(measured, budget)}

## The energy from second derivatives

The paper's polynomial, x², y², x³, xy², x⁴, x²y², y⁴, fitted to the measured Hessians, and to the flux by rectangles.

{_energies(budget)}

"It is numerically better to fit the derivatives of a function than the function itself": so it is, for no sum is
needed before. What is left on the bench without errors is the polynomial's own: the plant has terms of the sixth
degree too.

## The virtual measurement as a signal

![signal]({SIGNAL})

*Mean current and virtual measurement of the point whose ripple is least of a sine, one turn of the injected vector.
Dashed: the fitted Hessian times that vector; what departs from it is the inverter's. At the beginning the offset of the
wave that was switched on decays.*

## In what fluxbench and these pages differ from the paper

{(files(__package__) / "differences.md").read_text(encoding="utf-8")}"""


def _numbers(measured: Literal, budget: Budget) -> str:
    whole = budget.row(ALL)
    low, high = measured.resistance_ohm
    printed = [percent(getattr(PAPER_CROSSINGS, f"{axis}_percent")) for axis in "dq"]
    rows = [
        ("R_s over the classical sweep", "4.5 to 5.25 Ω", f"{fixed(low, 2)} to {fixed(high, 2)} Ω", "the other page")
    ]
    for k, axis in enumerate("dq"):
        own = f"{_two(whole.literal.crossings[k])} ({_two(whole.literal.relative[k])} of the flux there)"
        rows.append((f"psi_{axis} where paths cross", printed[k], own, _two(whole.regression.crossings[k])))
    rows += [
        ("distance from the true flux, rms", UNKNOWN, _two(whole.literal.rms), _two(whole.graph.rms)),
        ("... at worst", UNKNOWN, _two(whole.literal.worst), _two(whole.graph.worst)),
    ]
    return markdown_table(("", "paper", "as printed", "fluxbench, by injection alone"), rows)


def _sources(budget: Budget) -> str:
    return _table(
        ("switched on", "psi_d crossing", "psi_q crossing", "... of the flux there", "rms", "worst"),
        (
            (
                _words(row),
                _two(row.literal.crossings[0]),
                _two(row.literal.crossings[1]),
                _pair(row.literal.relative),
                _two(row.literal.rms),
                _two(row.literal.worst),
            )
            for row in budget.rows
        ),
    )


def _integration(budget: Budget) -> str:
    return _table(
        ("switched on", "R_s = v/i", "rms as printed", "rms, each sweep's drift taken out"),
        (
            (
                _words(row),
                " to ".join(fixed(ohm, 2) for ohm in row.resistance_ohm) + " Ω",
                _two(row.classical.rms),
                _two(row.closed.rms),
            )
            for row in budget.rows
        ),
    )


def _steps(budget: Budget) -> str:
    paths: tuple[tuple[str, str], ...] = (
        ("literal", "as printed"),
        ("trapezoids", "trapezoids instead of rectangles"),
        ("regression", "ripple regressed on the injected flux and its squares"),
        ("graph", "... and least squares over all neighbouring points"),
    )
    benches = [budget.row(name) for name in (RULE, ALL)]

    def cells(name: str) -> list[str]:
        errors: list[Errors] = [getattr(row, name) for row in benches]
        return [cell for one in errors for cell in (_pair(one.crossings), _two(one.rms), _two(one.worst))]

    head = (
        "evaluation",
        *(f"{bench}: {what}" for bench in ("no errors", "all") for what in ("crossings", "rms", "worst")),
    )
    return _table(head, ((words, *cells(name)) for name, words in paths))


def _vectors(budget: Budget) -> str:
    whole = budget.row(ALL)
    compared = (("turning", whole.literal, whole.trapezoids), ("standing", *budget.standing))
    rows = [
        (words, rule, _pair(one.crossings), _two(one.rms), _two(one.worst))
        for words, *both in compared
        for rule, one in zip(("rectangles", "trapezoids"), both, strict=True)
    ]
    return _table(("vector", "sums by", "crossings", "rms", "worst"), rows)


def _gaps(budget: Budget) -> str:
    rows = []
    for name in (RULE, IRON):
        gaps = budget.row(name).gap_percent
        rows += [(_words(budget.row(name)), how, _signed(gaps[key])) for key, how in _HOW]
    return _table(("switched on", "injection evaluated", "psi_d, psi_q against integration"), rows)


_HOW = (("literal", "as printed"), ("regression", "ripple regressed, trapezoids"))


def _parity(measured: Literal, budget: Budget) -> str:
    rows = []
    for words, one in (("no errors", budget.still), ("all", measured)):
        for name, entries in (("H", one.hessian), ("L", one.inductance)):
            rows.append((words, name, *map(_two, parity_percent(one.lines, one.current, entries))))
    return _table(("bench", "matrix", "11, dd", "22, qq", "12, dq"), rows)


def _energies(budget: Budget) -> str:
    rows = []
    for name in (RULE, NOISE, ALL):
        row = budget.row(name)
        both = (row.second_derivatives, row.first_derivatives)
        rows.append((_words(row), *(cell for one in both for cell in (_two(one.rms), _two(one.worst)))))
    return _table(("switched on", "to H_kl: rms", "worst", "to the flux: rms", "worst"), rows)


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    return markdown_table(tuple(head), [tuple(row) for row in rows])


def _words(row: Row) -> str:
    known = {
        RULE: "nothing: the rule alone",
        NOISE: "noise and resolution of the sensors",
        ALL: "all of the paper's (the run)",
        IRON_ALL: "all, and hysteresis",
        "winding_heating": "a winding that warms: R_s",
        "dead_time": "dead time, not compensated",
    }
    return known.get(row.name, row.name.replace("_", " "))


def _two(value: float) -> str:
    return UNKNOWN if value != value else f"{fixed(float(value), 2)} %"


def _pair(values: Array) -> str:
    return " / ".join(_two(float(value)) for value in values)


def _signed(values: Array) -> str:
    return " / ".join(f"{'+' if value > 0 else ''}{_two(float(value))}" for value in values)
