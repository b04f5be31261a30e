"""A fleet's report as a file for the viewer: its tables, and each quantity over time with its control limits."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rerun as rr

from orchestrator.fleet.statistics import SECTIONS, count_rows
from orchestrator.formatting.colours import D_AXIS, GUIDE, MEASURED_ON_SCREEN, packed_all
from orchestrator.formatting.sentences import markdown_table, shown
from plugins.streams.rerun._blueprints import of_a_fleet
from plugins.streams.rerun._tape import ALWAYS, Entry, When, blueprint, entry, properties, scalars, titled, write_file
from protocols.fleet_report import FleetQuantity, FleetReport

_NOW = When(experiment_s=0.0)
"""The viewer wants one time at least."""
_LINES = {"measured": MEASURED_ON_SCREEN, "average": D_AXIS, "lower limit": GUIDE, "upper limit": GUIDE}


def write_fleet_view(report: FleetReport, file: Path) -> None:
    """Draw a fleet's report; raises `StorageError` where the file cannot be written."""
    file.unlink(missing_ok=True)
    write_file(file, "fleet", _entries(report))


def _entries(report: FleetReport, most_courses: int = 8) -> Iterator[Entry]:
    yield titled(Path(report.table).name)
    judged = report.judgement
    facts = {
        "recordings": report.recordings,
        "motors": report.serials,
        "outliers": len(report.outliers),
        "passed": None if judged is None else judged.passed,
    }
    yield properties("fleet", facts)
    pages = {"remarks": "\n".join(f"- {remark.text}" for remark in report.remarks)}
    pages |= {title.lower().replace(" ", "_"): _table(make(report)) for title, make in SECTIONS.items()}
    pages["verdicts"] = _table(count_rows(report))
    for name, text in pages.items():
        yield entry(f"fleet/{name}", _NOW, rr.TextDocument(shown(text), media_type=rr.MediaType.MARKDOWN))
    charts = [one for one in report.quantities if one.chart is not None and one.of_motor][:most_courses]
    for place, one in enumerate(charts):
        yield from _course(f"course/{place}", one, report)
    titles = [shown(f"{one.label} [{one.unit}]" if one.unit != "1" else one.label) for one in charts]
    timed = report.first is not None and report.last is not None
    end_s = (report.last - report.first).total_seconds() if timed else 0.0  # type: ignore[operator]
    yield blueprint("fleet", of_a_fleet(list(pages), titles, end_s))


def _course(path: str, one: FleetQuantity, report: FleetReport) -> Iterator[Entry]:
    assert one.chart is not None  # whoever asks has one
    assert report.first is not None  # and so it has times
    seconds = np.array([(point.at - report.first).total_seconds() for point in one.chart.points])
    values = np.array([(point.value, point.average, point.lower, point.upper) for point in one.chart.points])
    lines = rr.SeriesLines(names=list(_LINES), colors=packed_all(_LINES.values()), widths=[1.2] * len(_LINES))
    yield entry(path, ALWAYS, lines)
    yield scalars(path, seconds, values)


def _table(rows: list[tuple[str, ...]], most_rows: int = 200) -> str:
    return markdown_table(rows[0], rows[1 : most_rows + 1]) if rows else "Nothing."
