"""Where the viewer's own program is. Starts nothing."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from protocols import PluginError


def executable() -> str:
    """The viewer's own program, as the package brings it.

    Raises
    ------
    PluginError
        Where it is not there.
    """
    spec = find_spec("rerun_cli")
    folder = Path(spec.origin).parent if spec is not None and spec.origin else Path()
    for place in (folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun", folder / "rerun", folder / "rerun.exe"):
        if place.is_file():
            return str(place)
    raise PluginError("stream rerun", "viewer", "rerun-sdk is installed without its viewer")
