"""`fluxbench estimate`: maps and resistance from a recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from orchestrator.formatting.quantities import UNKNOWN
from orchestrator.formatting.results import (
    USABILITY_WORDS,
    accuracy_words,
    check_rows,
    coefficient_rows,
    resistance,
    resistance_course,
    usability_rows,
)
from orchestrator.interface import api
from orchestrator.interface.api.analysing import estimates_folder
from orchestrator.interface.cli._output import say, say_document, say_notes, say_table
from orchestrator.interface.cli._refreshing import PAGE, refresh_report
from protocols import EstimationReport, Usability


def estimate(path: Path, out: Path | None, names: Sequence[str], as_json: bool) -> int:
    """Run the estimators; results go into the recording's own results/, or below `out`."""
    report = api.estimate(path, estimators=names, out=out)
    folder = estimates_folder(path, names, out)
    refresh_report(path, None if folder == path else folder)
    if as_json:
        say_document(report.model_dump_json(indent=2))
    else:
        _print_report(report, folder / "results")
        if names and out is None:
            say(f"of {', '.join(names)} alone; {path / 'results'} is unchanged")
        elif out is None and not (path / PAGE).is_file():
            say(f"as a page with pictures: fluxbench report {path}")
    return 0


def in_capitals(usability: Usability) -> str:
    """Whether a map can be relied on; in capitals where it cannot."""
    words = USABILITY_WORDS[usability]
    return words if usability is Usability.USABLE else words.upper()


def _print_report(report: EstimationReport, folder: Path) -> None:
    if report.resistance is not None:
        say(f"R_s {resistance(report.resistance)}; {resistance_course(report.resistance)}")
    if report.method is not None:
        say(f"flux map by {report.method}: {in_capitals(report.usability)}")
    if report.usability is Usability.NOT_JUDGED:
        say(f"whether it is usable: fluxbench diagnose {folder.parent}")
    known = [row for row in check_rows(report) if row[1] != UNKNOWN]
    if known:
        say_table(("agreement of the maps", "difference"), known)
    if report.checks:
        say_table(("usable only if", "value", "limit", "outcome"), usability_rows(report))
    if accuracy := accuracy_words(report):
        say(f"accuracy: {accuracy}")
    for method, map_report in report.maps.items():
        if map_report.form is not None:
            say(f"{method}: {map_report.form.formula}")
            say_table(("coefficient", "value", "standard deviation"), coefficient_rows(map_report.form))
    say_notes(report.reasons)
    say(*(f"{name}: {folder / file}" for name, file in report.files.items()))
