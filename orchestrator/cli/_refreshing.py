"""A run's report after something was found out anew: written again, where it has one that is older."""

from __future__ import annotations

from pathlib import Path

from orchestrator.cli._output import complain
from protocols import FluxbenchError, StreamSetup

REPORT, PAGE = "report", "report.html"
SOURCES = ("run.json", "journal.jsonl", "model.json", "results/*")
"""What the page is made from; a recording.json that says something else is in all results."""


def has_report(directory: Path) -> bool:
    """Whether there is a page."""
    return (directory / PAGE).is_file()


def refresh_report(directory: Path, out: Path | None) -> None:
    """Have the stream `report` write its page again; what keeps it from that is said, and fails nothing.

    Nothing to do where there is no page yet, the results went elsewhere (`out`), or the page is as new as all that it
    is made from.
    """
    page = directory / PAGE
    if out is not None or not page.is_file() or not _is_older(page, directory):
        return
    from orchestrator.registry import PluginKind, load_plugin, make_options

    try:
        plugin = load_plugin(PluginKind.STREAMS, REPORT)
        plugin(StreamSetup(run=directory, options=make_options(plugin, {}, f"stream {REPORT}"))).close()
    except (FluxbenchError, OSError) as error:
        complain(f"{page} is older than these results: {error}")


def _is_older(page: Path, directory: Path) -> bool:
    written = page.stat().st_mtime_ns
    return any(source.stat().st_mtime_ns > written for name in SOURCES for source in directory.glob(name))
