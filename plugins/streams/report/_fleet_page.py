"""A fleet's report as files: one page with pictures, and the JSON that holds all that the page shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from orchestrator.fleet.statistics import SECTIONS, change_rows, count_rows, date, judgement_rows, pair_rows
from orchestrator.formatting.quantities import plural
from orchestrator.formatting.sentences import typographic
from orchestrator.recording import replace_file, storage_error
from plugins.streams.report._content import Picture
from plugins.streams.report._fleet_figures import distance_figure, quantity_figure
from plugins.streams.report._page import filled
from protocols.fleet_report import FleetQuantity, FleetReport

PAGE, DATA = "fleet-report.html", "fleet-report.json"
_ABOUT = {
    "Distributions": "Spread: 1.4826 times the median distance from the median. Last column: the 95 % interval "
    "that a single recording reports.",
    "Limits": "Cpk by the whole sample’s standard deviation, interval by Bissell; share by Clopper and Pearson.",
    "Outliers": "By robust distance (minimum covariance determinant): 95 of 100 fleets without faults have "
    "no recording beyond the limit. Quantities outside the distance are tested singly.",
    "Batches": "By the median of all differences (Hodges and Lehmann). Shifted: significant among all tested batches "
    "and quantities.",
    "Over time": "By the median of all slopes (Theil and Sen). Chart: an exponentially weighted moving average about "
    "the median; by chance it exceeds its limits once in 500 recordings.",
}


def write_fleet_report(report: FleetReport, folder: Path) -> tuple[Path, Path]:
    """Write page and JSON into a folder, which is made; raises `StorageError` where that cannot be."""
    page, data = folder / PAGE, folder / DATA
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(folder, error) from None
    replace_file(data, report.model_dump_json(indent=1).encode("utf-8"))
    replace_file(page, render(report).encode("utf-8"))
    return page, data


def render(report: FleetReport, most_pictures: int = 16, most_rows: int = 60) -> str:
    """The page as text, with so many quantities drawn and so many rows of each table."""
    judgement, pairs = report.judgement, report.pairs
    tables = [(title, _ABOUT[title], rows) for title, make in SECTIONS.items() if (rows := make(report))]
    shown = sorted((one for one in report.quantities if one.histogram is not None), key=lambda one: not one.of_motor)
    return filled(
        "fleet.html",
        title=Path(report.table).name,
        under=_under(report),
        remarks=[typographic(remark.text) for remark in report.remarks],
        counts=count_rows(report),
        judgement=_judgement(report),
        judged=[] if judgement is None else judgement_rows(judgement),
        pairs="" if pairs is None else f"{plural(pairs.count, 'motor')} measured twice, {pairs.unpaired} once.",
        paired=[] if pairs is None else pair_rows(pairs),
        changed=[] if pairs is None else change_rows(pairs),
        tables=tables,
        most_rows=most_rows,
        pictures=list(_pictures(report, shown[:most_pictures])),
    )


def _under(report: FleetReport) -> str:
    parts = [plural(report.recordings, "recording")]
    if report.serials:
        parts.append(f"of {plural(report.serials, 'motor')}")
    if report.first is not None and report.last is not None:
        parts.append(f"from {date(report.first)} to {date(report.last)} UTC")
    return " ".join(parts)


def _judgement(report: FleetReport) -> dict[str, str] | None:
    counts = report.judgement
    if counts is None:
        return None
    mood = "bad" if counts.failed else "warning" if counts.unsure or counts.not_measured else "good"
    detail = (
        f"{counts.failed} fail, {counts.unsure} are undecided by their intervals, {counts.not_measured} not measured."
    )
    return {"mood": mood, "head": f"{counts.passed} of {report.recordings} pass", "detail": detail}


def _pictures(report: FleetReport, quantities: Sequence[FleetQuantity]) -> Iterator[Picture]:
    if report.distances is None:
        yield Picture("Robust distance", "Not drawn: too few complete recordings.")
    else:
        count, of = report.distances.counted, len(report.distances.quantities)
        caption = f"Of {of} quantities; middle and scatter by {count} recordings."
        yield Picture("Robust distance", caption, distance_figure(report.distances))
    for one in quantities:
        limits = " Dashed: the limits of the file." if one.capability is not None else ""
        caption = f"Known in {one.count} of {one.asked} recordings.{limits}"
        yield Picture(one.label, caption, quantity_figure(one))
