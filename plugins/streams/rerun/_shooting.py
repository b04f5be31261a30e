"""Looks at a ``view.rrd`` without a screen: pictures of its tabs, and what its views have to complain about.

The viewer draws without a window; that takes a graphics driver, software being enough (Mesa's lavapipe, Debian's
mesa-vulkan-drivers). Nothing here makes a recording.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rerun.experimental import View, ViewerClient

from plugins.streams.rerun._live import address, free_port, wait_for_viewer
from plugins.streams.rerun._viewer import start, viewer_words
from protocols import PluginError, RecordingError

START_TIMEOUT_S = 60.0
DRAW_TIMEOUT_S = 30.0
NO_DRIVER = "does not start: it needs a graphics driver (Debian: mesa-vulkan-drivers)"


@dataclass(frozen=True)
class Shot:
    """One tab as it was drawn.

    Attributes
    ----------
    tab : str
        Its name.
    png : bytes
    complaints : tuple of str
        What its views reported, "view: summary" each.
    views : tuple of View
        Those on the tab.
    """

    tab: str
    png: bytes
    complaints: tuple[str, ...]
    views: tuple[View, ...]


@contextmanager
def headless_viewer(size: tuple[int, int] = (1600, 1000)) -> Iterator[ViewerClient]:
    """A viewer without a window on a free port of this machine.

    Raises
    ------
    PluginError
        Where it does not come up.
    """
    port = free_port()
    words = [*viewer_words(port, "2GB", headless=True), "--window-size", f"{size[0]}x{size[1]}"]
    with tempfile.TemporaryDirectory() as runtime:
        process = start(words, {"XDG_RUNTIME_DIR": os.environ.get("XDG_RUNTIME_DIR") or runtime})
        try:
            if not wait_for_viewer(port, START_TIMEOUT_S, lambda: process.has_ended):
                raise PluginError("stream rerun", "viewer", NO_DRIVER)
            yield ViewerClient.connect(address(port))
        finally:
            process.stop()


def shoot(viewer: ViewerClient, file: Path, wanted: str | None = None, most: int | None = None) -> list[Shot]:
    """Open a recording and take a picture of each tab of its layout (of the one `wanted`; of the first few),
    at the end of its time; raises `RecordingError` where the file has no recording, no tabs, or not the wanted one."""
    opened = viewer.open(str(file)).store_ids
    if not opened:
        raise RecordingError(str(file), "", "the viewer finds no recording in it")
    _until(lambda: not viewer.get_state().loading)
    recording = opened[0]
    viewer.set_time(play_state="paused", recording=recording)
    shots = []
    layout = viewer.get_blueprint(of="recording", store_id=recording).blueprint
    if not any(part.get("container_kind") == "Tabs" for part in _containers(layout).values()):
        raise RecordingError(str(file), "", "has no layout of tabs to take a picture of; was it made by fluxbench?")
    named = tabs(layout)
    if wanted is not None and wanted not in named:
        raise RecordingError(str(file), "tab", f"none is named {wanted!r}; there are: {', '.join(named)}")
    for name, path in list(named.items())[:most]:
        if wanted in (None, name):
            layout[f"/{_root(layout)}"]["ContainerBlueprint"]["active_tab"] = path
            viewer.set_blueprint(layout, of="recording", store_id=recording)
            shots.append(_settled(viewer, name, _views_of(layout, path)))
    return shots


def _until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DRAW_TIMEOUT_S
    while not holds():
        if time.monotonic() > deadline:
            raise PluginError("stream rerun", "viewer", f"did not come to rest within {DRAW_TIMEOUT_S:.0f} s")
        time.sleep(0.1)


def _containers(layout: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {
        path.strip("/"): parts["ContainerBlueprint"] for path, parts in layout.items() if "ContainerBlueprint" in parts
    }


def _root(layout: dict[str, Any]) -> str:
    """Path of the container of tabs."""
    return next(path for path, c in _containers(layout).items() if c.get("container_kind") == "Tabs")


def tabs(layout: dict[str, Any]) -> dict[str, str]:
    """Paths of the tabs by their names, in order."""
    all_ = _containers(layout)
    return {all_[path].get("display_name", path): path for path in all_[_root(layout)]["contents"]}


def _views_of(layout: dict[str, Any], path: str) -> set[str]:
    """Ids of the views below a container."""
    if path.startswith("view/"):
        return {path.removeprefix("view/")}
    contents = _containers(layout)[path]["contents"]
    # A single view is no list.
    parts = [contents] if isinstance(contents, str) else contents
    return {view for part in parts for view in _views_of(layout, part)}


def _settled(viewer: ViewerClient, tab: str, views: set[str]) -> Shot:
    """The picture, once two in a row are the same."""
    deadline = time.monotonic() + DRAW_TIMEOUT_S
    last = b""
    while (png := viewer.take_screenshot()) != last and time.monotonic() < deadline:
        last = png
        time.sleep(0.15)
    shown = [view for view in viewer.get_state().views if view.view_id in views]
    complaints = tuple(f"{view.name}: {r.severity}: {r.summary}" for view in shown for r in view.reports)
    return Shot(tab, png, complaints, tuple(shown))
