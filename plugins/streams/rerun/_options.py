"""Options of the rerun stream."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from protocols import Strict


class RerunOptions(Strict):
    """What is written always goes to ``view.rrd``; these say who may look on meanwhile."""

    view: Literal["none", "auto", "spawn", "web", "connect"] = "none"
    """none: the file alone. spawn: open the viewer. web: serve it to a browser on this machine. auto: spawn where there
    is a display, else web. connect: follow into a viewer that somebody else starts, now or later, on `port`."""
    port: Annotated[int, Field(ge=1, le=65535)] = 9876
    """Of the viewer on 127.0.0.1."""
    web_port: Annotated[int, Field(ge=1, le=65535)] = 9090
    """Of the page, where `view` is web."""
    memory_limit: Annotated[str, Field(pattern=r"^[1-9][0-9]*(MB|GB|MiB|GiB|%)$")] = "2GB"
    """Most that a viewer started here may take."""
    queue_mb: Annotated[float, Field(ge=0.1, le=1000)] = 48.0
    """What may wait for the viewer; beyond it the oldest is dropped and counted."""
