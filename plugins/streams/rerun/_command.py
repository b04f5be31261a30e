"""`fluxbench view`: a run in the viewer, or a folder of runs. Everything stays on this machine."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orchestrator.formatting.sentences import shown, visible
from plugins.command_line import entry_point
from protocols import FluxbenchError, InputError, PluginError, RecordingError

if TYPE_CHECKING:
    from plugins.streams.rerun._making import Found

HELP_GROUP = "Use the results"
"""Its place in the list of commands."""


MEMORY_LIMIT = "4GB"
SUFFIX = ".rrd"
MAX_NAMES = 8
"""Runs of a folder that an error lists."""
TABS = (
    "What is it doing?", "Is every point reached?", "What does the ripple say?", "How does R_s move?",
    "What is the flux?", "How does it saturate?", "Can I trust the map?",
    "Which effect is missing?", "Where does the model fail?", "Does it predict the current?",
    "Do the flux loops close?", "Which law is missing?",
)  # fmt: skip
"""Names of the tabs of a commissioning, then of a diagnosis."""
TAB_HELP = f"Tab that the picture shows: {', '.join(repr(tab) for tab in TABS)}."


def view(
    paths: Annotated[
        list[Path],
        typer.Argument(help="A run, a recording, a .rrd file, a folder of runs; or several runs.", metavar="RUN..."),
    ],
    web: Annotated[bool, typer.Option("--web", help="Open in the browser; always so without a display.")] = False,
    port: Annotated[int | None, typer.Option(min=1, max=65535, help="Port of the viewer, or of its page.")] = None,
    screenshot: Annotated[
        Path | None, typer.Option(help="Write a picture to this file and open nothing.", metavar="FILE")
    ] = None,
    tab: Annotated[str | None, typer.Option(help=TAB_HELP, metavar="NAME")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print a folder's table as JSON only.")] = False,
) -> int:
    """See a run: while it happens, or afterwards; or several side by side."""
    from orchestrator.recording import require_recording

    of_run = len(paths) == 1 and paths[0].suffix != SUFFIX  # other views have tabs of their own
    if of_run and tab is not None and tab not in TABS:
        raise InputError("--tab", tab, f"no such tab; there are {', '.join(map(repr, TABS))}")
    if screenshot is not None and screenshot.suffix != ".png":
        raise InputError("--screenshot", str(screenshot), "expected a file that ends in .png")
    for path in paths:
        if not path.exists():
            require_recording(path)
    if len(paths) > 1:
        from orchestrator.runs import without_private

        paths = without_private(paths)
    if len(paths) > 1:
        from plugins.streams.rerun._making import comparison_view

        return _see_made(comparison_view(paths), web, port, screenshot, tab)
    (path,) = paths
    from plugins.streams.rerun._catalogue import as_text, row, runs_in
    from plugins.streams.rerun._making import is_viewable, refuse_unreadable

    if path.suffix == SUFFIX and path.is_file():
        refuse_unreadable(path)
        return _see(path, web, port, screenshot, tab)
    if is_viewable(path):
        from plugins.streams.rerun._making import whole_view

        return _see_made(whole_view(path, _tell), web, port, screenshot, tab, of=path)
    runs = runs_in(path)
    if not runs:
        require_recording(path)
    if screenshot is not None or not (as_json or web or sys.stdout.isatty()):
        names = ", ".join(run.name for run in runs[:MAX_NAMES])
        more = f" and {len(runs) - MAX_NAMES} more" if len(runs) > MAX_NAMES else ""
        raise RecordingError(
            str(path), "", f"a folder of runs, not a run: {names}{more}; name one, or --web serves all"
        )
    rows = [row(run, _tell) for run in runs]
    print(visible(json.dumps(rows, indent=2)) if as_json else shown(as_text(rows)), flush=True)
    return 0 if as_json else _browse(runs, web, port)


def command(arguments: Sequence[str]) -> int:
    """Entry point of the command."""
    from plugins.streams.rerun._viewer import interruptible

    with interruptible():
        return entry_point(view, "Example: fluxbench view runs/first --port 9090")(arguments)


def _see_made(
    found: Found, web: bool, port: int | None, screenshot: Path | None, tab: str | None, of: Path | None = None
) -> int:
    """A view; what had to be made elsewhere goes when it was seen, but stays where a window shows it."""
    from plugins.streams.rerun._viewer import has_display

    stays = screenshot is None and not web and has_display()
    if found.remark and (stays or found.folder is None):
        _tell(found.remark)
    try:
        return _see(found.file, web, port, screenshot, tab, of)
    finally:
        if not stays:
            found.remove()


def _see(
    file: Path, web: bool, port: int | None, screenshot: Path | None, tab: str | None, of: Path | None = None
) -> int:
    """Open a file; where it is `of` a run, a page that is served keeps up with what is found out later."""
    if screenshot is not None:
        return _picture(file, screenshot, tab)
    from plugins.streams.rerun._viewer import has_display, start, viewer_words

    if web or not has_display():
        return _serve(file, port, None if of is None else Later(of, file))
    start(viewer_words(port or 9876, MEMORY_LIMIT, files=[file]))
    _tell(f"the viewer opens {file}")
    return 0


@dataclass(frozen=True)
class Later:
    """A run whose view is served, and may grow old meanwhile."""

    run: Path
    file: Path

    def is_due(self, settled_s: float = 2.0) -> bool:
        """Whether results are newer than the view, and written to no more."""
        from plugins.streams.rerun._making import is_stale

        if not self.file.is_file() or not is_stale(self.run, self.file):
            return False
        newest = max(result.stat().st_mtime for result in (self.run / "results").glob("*"))
        return time.time() - newest > settled_s

    def make(self) -> None:
        """The view anew, in its place."""
        from plugins.streams.rerun._making import make_view

        made = make_view(self.run)
        if made.file != self.file:
            made.file.replace(self.file)
            made.remove()


def _serve(source: Path | str, port: int | None, later: Later | None = None) -> int:
    """A page for the browser, until it is interrupted: of a file, or of the catalogue at an address."""
    from plugins.streams.rerun._handing import handed_out
    from plugins.streams.rerun._live import free_port, wait_for_viewer
    from plugins.streams.rerun._viewer import page_origin, page_url, start, tied, viewer_words

    data_port, web_port = free_port(), port or free_port()
    server = start(tied(viewer_words(data_port, MEMORY_LIMIT, web_port=web_port)))
    try:
        if not wait_for_viewer(web_port, 30.0, lambda: server.has_ended):
            raise RecordingError(str(source), "", f"the page's server does not start; is port {web_port} taken?")
        found = handed_out(source, page_origin(web_port)) if isinstance(source, Path) else nullcontext(source)
        with found as address:
            print(page_url(data_port, web_port, address), flush=True)
            _tell("open this address in a browser on this machine; Ctrl-C ends it")
            while not server.has_ended:
                time.sleep(0.2)
                if later is not None and later.is_due():
                    later = _made_anew(later)
    except KeyboardInterrupt:
        return 0
    finally:
        server.stop()
    return 0


def _made_anew(later: Later) -> Later | None:
    """A view that follows its run; None, with a message, where it cannot any more."""
    _tell(f"{later.run} has newer results: the view is made anew")
    try:
        later.make()
    except FluxbenchError as error:
        _tell(f"what is shown is older than the results: {error}")
        return None
    _tell("reload the page")
    return later


def _browse(runs: Sequence[Path], web: bool, port: int | None) -> int:
    """Serve the catalogue and open it."""
    from plugins.streams.rerun._making import whole_view

    views = [whole_view(run, _tell) for run in runs]
    try:
        return _show_catalogue([one.file for one in views], web, port)
    finally:
        for one in views:
            one.remove()


def _show_catalogue(files: Sequence[Path], web: bool, port: int | None) -> int:
    from plugins.streams.rerun._catalogue import served
    from plugins.streams.rerun._tape import is_whole
    from plugins.streams.rerun._viewer import has_display, start, viewer_words

    with served([file for file in files if is_whole(file)]) as url:
        if web or not has_display():
            return _serve(url, port)
        _tell("the viewer opens the catalogue; Ctrl-C ends it")
        window = start(viewer_words(port or 9876, MEMORY_LIMIT, files=[url]))
        try:
            while not window.has_ended:
                time.sleep(0.2)
        except KeyboardInterrupt:
            return 0
    return 0


def _picture(file: Path, to: Path, tab: str | None) -> int:
    from orchestrator.recording import replace_file
    from orchestrator.runs import require_file_place
    from plugins.streams.rerun._shooting import headless_viewer, shoot

    require_file_place(to, "--screenshot")
    try:
        with headless_viewer() as viewer:
            shots = shoot(viewer, file, tab, most=1 if tab is None else None)
    except OSError as error:
        if error.errno is not None:
            raise
        raise PluginError("stream rerun", "viewer", f"ended before the picture was drawn ({error})") from error
    replace_file(to, shots[0].png)
    print(shown(str(to)))
    return 0


def _tell(line: str) -> None:
    print(shown(f"fluxbench: {line}"), file=sys.stderr, flush=True)
