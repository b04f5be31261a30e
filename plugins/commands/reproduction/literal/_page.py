"""The literal page: the paper's evaluation beside fluxbench's, its error budget, and the differences."""

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
    values = {
        "day": time.strftime("%Y-%m-%d", time.gmtime()),
        "numbers": _numbers(measured, budget),
        "sources": _sources(budget),
        "rule_crossings": _pair(rule.literal.crossings),
        "rule_worst": _two(rule.literal.worst),
        "worst_crossing": _two(max(float(row.literal.crossings[1]) for row in budget.rows)),
        "integration": _integration(budget),
        "steps": _steps(budget),
        "vectors": _vectors(budget),
        "half_width_ma": 1e3 * iron["half_width_a"],
        "reversible_percent": 100.0 * iron["reversible_ratio"],
        "gaps": _gaps(budget),
        "gap": GAP,
        "parity": _parity(measured, budget),
        "energies": _energies(budget),
        "signal": SIGNAL,
    }
    return (files(__package__) / "page.md").read_text(encoding="utf-8").format(**values)


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
    evaluations = {"literal": "as printed", "regression": "ripple regressed, trapezoids"}
    rows = [
        (_words(row), how, _signed(row.gap_percent[key]))
        for row in (budget.row(RULE), budget.row(IRON))
        for key, how in evaluations.items()
    ]
    return _table(("switched on", "injection evaluated", "psi_d, psi_q against integration"), rows)


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
