"""`fluxbench estimate`: maps and resistance out of any recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from orchestrator.cli._tables import print_table
from orchestrator.engine import installed_estimators
from orchestrator.estimation import estimate_recording
from orchestrator.registry import PluginKind, load_plugin
from orchestrator.runs import open_any, refuse_file
from protocols import AxisPercent, EstimationReport

PAPER = {"crossings": "1.3 % d, 2.9 % q"}
"""What the paper prints of its own measurement."""


def estimate(path: Path, out: Path | None, names: Sequence[str], as_json: bool) -> int:
    """Run the estimators; results go into the recording's own results/, or below `out`."""
    target = out if out is not None else path
    refuse_file(target)
    refuse_file(target / "results")
    estimators = [load_plugin(PluginKind.ESTIMATORS, name)() for name in (names or installed_estimators())]
    report = estimate_recording(open_any(path, keep=out is None), estimators, target)
    if as_json:
        print(report.model_dump_json(indent=2))
    else:
        _print_report(report)
    return 0


def _print_report(report: EstimationReport) -> None:
    if report.resistance is not None:
        found = report.resistance
        print(
            f"R_s {found.value_ohm:.4g} ohm, 95 % {found.low:.4g} to {found.high:.4g}; "
            f"{found.first_ohm:.4g} at the start, {found.last_ohm:.4g} at the end"
        )
    if report.method is not None:
        print(f"flux map by {report.method}: {'usable' if report.usable else 'NOT TO BE RELIED ON'}")
    rows = [
        ("crossings of paths", _axes(report.crossings), PAPER["crossings"]),
        ("parity in i_q", _axes(report.parity), "-"),
        ("reciprocity", _percent(report.reciprocity_percent), "-"),
        ("classical against injection", _percent(report.classical_against_injection_percent), "-"),
    ]
    print_table(("check", "here", "in the paper"), rows)
    for method, made in report.maps.items():
        if made.form is not None:
            print(f"{method}: {made.form.formula}")
            print_table(
                ("coefficient", "value", "std", "unit"),
                [(c.name, f"{c.value:.5g}", f"{c.std:.2g}", c.unit) for c in made.form.coefficients],
            )
    for reason in report.reasons:
        print(f"note: {reason}")
    for name, file in report.files.items():
        print(f"{name}: {file}")


def _axes(value: AxisPercent | None) -> str:
    if value is None:
        return "-"
    return f"{_percent(value.d_percent)} d, {_percent(value.q_percent)} q"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g} %"
