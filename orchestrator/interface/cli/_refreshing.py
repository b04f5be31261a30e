"""A run's report after new results: written again where the run has an older one."""

from __future__ import annotations

from pathlib import Path

from orchestrator.interface.cli._output import complain
from protocols import FluxbenchError, StreamSetup

REPORT, PAGE = "report", "report.html"
SOURCES = ("run.json", "journal.jsonl", "model.json", "results/*", "tuning/tuning.json")
"""Sources of the page; changes of recording.json show in all results."""


def refresh_report(directory: Path, out: Path | None) -> None:
    """Have the stream `report` write its page again; an error is printed, and fails nothing.

    It does nothing where there is no page yet, the results went elsewhere (`out`), or the page is newer than its
    sources.
    """
    page = directory / PAGE
    if out is not None or not page.is_file():
        return
    written = page.stat().st_mtime_ns
    if all(source.stat().st_mtime_ns <= written for name in SOURCES for source in directory.glob(name)):
        return
    from orchestrator.registry.plugins import PluginKind, load_plugin, make_options

    try:
        plugin = load_plugin(PluginKind.STREAMS, REPORT)
        plugin(StreamSetup(run=directory, options=make_options(plugin, {}, f"stream {REPORT}"))).close()
    except (FluxbenchError, OSError) as error:
        complain(f"{page} is older than these results: {error}")
