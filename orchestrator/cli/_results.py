"""`fluxbench estimate`: maps and resistance out of any recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from orchestrator.cli._output import say, say_notes, say_table
from orchestrator.estimation import estimate_recording
from orchestrator.presentation.names import PAPER_CROSSINGS, symbol_of
from orchestrator.presentation.quantities import (
    UNKNOWN,
    Scale,
    axes_percent,
    measured,
    percent,
    value_and_error,
)
from orchestrator.registry import PluginKind, make_plugins
from orchestrator.runs import open_any, refuse_file
from protocols import EstimationReport


def estimate(path: Path, out: Path | None, names: Sequence[str], as_json: bool) -> int:
    """Run the estimators; results go into the recording's own results/, or below `out`."""
    target = out if out is not None else path
    refuse_file(target)
    refuse_file(target / "results")
    estimators = make_plugins(PluginKind.ESTIMATORS, names or None)
    report = estimate_recording(open_any(path, keep=out is None), estimators, target)
    if as_json:
        print(report.model_dump_json(indent=2))
    else:
        _print_report(report)
    return 0


def _print_report(report: EstimationReport) -> None:
    if report.resistance is not None:
        found = report.resistance
        scale = Scale.of(found.value_ohm, found.low, found.high, "ohm")
        course = f"{scale.quantity(found.first_ohm)} at the start, {scale.quantity(found.last_ohm)} at the end"
        say(f"R_s {measured(found.value_ohm, found.low, found.high, 'ohm')}; {course}")
    if report.method is not None:
        say(f"flux map by {report.method}: {'usable' if report.usable else 'NOT TO BE RELIED ON'}")
    rows = [
        ("crossings of paths", axes_percent(report.crossings), axes_percent(PAPER_CROSSINGS)),
        ("parity in i_q", axes_percent(report.parity), UNKNOWN),
        ("reciprocity", percent(report.reciprocity_percent), UNKNOWN),
        ("classical against injection", percent(report.classical_against_injection_percent), UNKNOWN),
    ]
    say_table(("check", "here", "in the paper"), rows)
    for method, made in report.maps.items():
        if made.form is not None:
            say(f"{method}: {made.form.formula}")
            rows = [(symbol_of(c.name), *value_and_error(c.value, c.std, c.unit)) for c in made.form.coefficients]
            say_table(("coefficient", "value", "standard deviation"), rows)
    say_notes(report.reasons)
    say(*(f"{name}: {file}" for name, file in report.files.items()))
