"""A run's report after something was found out anew: written again, where it has one."""

from __future__ import annotations

from pathlib import Path

from orchestrator.cli._output import complain
from orchestrator.registry import PluginKind, load_plugin, make_options
from protocols import FluxbenchError, StreamSetup

REPORT = "report"


def refresh_report(directory: Path, out: Path | None) -> None:
    """Have the stream `report` write its page again; what keeps it from that is said, and fails nothing.

    Nothing to do where there is no page yet, or the results went elsewhere (`out`).
    """
    page = directory / "report.html"
    if out is not None or not page.is_file():
        return
    try:
        plugin = load_plugin(PluginKind.STREAMS, REPORT)
        plugin(StreamSetup(run=directory, options=make_options(plugin, {}, f"stream {REPORT}"))).close()
    except (FluxbenchError, OSError) as error:
        complain(f"{page} is older than these results: {error}")
