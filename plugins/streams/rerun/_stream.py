"""The rerun stream: hands messages to the pictures, and what they draw to the file and to whoever looks on."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import rerun as rr
import rerun.blueprint as rrb
from pydantic import BaseModel, Field

from orchestrator.formatting.sentences import shown
from orchestrator.operating_system.processes import LastingProcess
from plugins.streams.rerun import _blueprints as blueprints
from plugins.streams.rerun import _diagnosis as diagnosis
from plugins.streams.rerun._commissioning import Commissioning
from plugins.streams.rerun._detail import DETAIL
from plugins.streams.rerun._live import LiveFeed
from plugins.streams.rerun._tape import FILE_NAME, Tape, blueprint, entry
from plugins.streams.rerun._viewer import best_view, page_url, start, viewer_words
from protocols import (
    DiagnosisStep,
    Message,
    PluginError,
    PointDone,
    PointStarted,
    RunStarted,
    SamplesCaptured,
    StateChanged,
    StreamSetup,
    Strict,
)


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


class RerunStream:
    """Draws a run into ``view.rrd`` and, on request, into a viewer that follows."""

    name: ClassVar[str] = "rerun"
    Options: ClassVar[type[BaseModel]] = RerunOptions
    wants_samples: ClassVar[bool] = True

    def __init__(
        self,
        setup: StreamSetup,
        *,
        name: str = "",
        ripple_every_s: float = 0.25,
        wall_s: Callable[[], float] = time.monotonic,
    ) -> None:
        options = setup.options if isinstance(setup.options, RerunOptions) else RerunOptions()
        self._server: LastingProcess | None = None
        self._live: LiveFeed | None = None
        self._tape = Tape(setup.run / FILE_NAME, name=name)
        if options.view != "none":
            self._live = LiveFeed(self._tape.recording_id, options.port, 1e6 * options.queue_mb)
            self._tape.listener = self._live.put
        self._notes: list[str] = []
        self._open_viewer(options)
        self._wall = wall_s
        self._commissioning = Commissioning(ripple_every_s, wall_s)
        self._diagnosis = diagnosis.Diagnosis()
        self._layout = ""
        self._measured = self._states = False
        self._contents: diagnosis.Contents | None = None
        self._sent_at = 0.0
        self._tape.put([*self._commissioning.furniture(), *diagnosis.furniture()])
        self._lay_out(blueprints.COMMISSIONING, blueprints.commissioning)

    @property
    def dropped(self) -> int:
        """Entries that the live viewer never got; the file has them all."""
        return 0 if self._live is None else self._live.dropped

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth saying at the end."""
        missed = f"the live viewer missed {self.dropped} entries; {FILE_NAME} has them all"
        return (*self._notes, *([missed] if self.dropped else []))

    def receive(self, message: Message) -> None:
        """Draw one message."""
        self._tape.put(self._commissioning.take(message))
        if isinstance(message, PointDone) or self._is_time():
            self._hand_on_waveforms()
        if isinstance(message, SamplesCaptured):
            return
        now_s = self._commissioning.when.experiment_s or 0.0
        self._tape.put(self._diagnosis.take(message, now_s))
        self._states |= isinstance(message, StateChanged)
        self._measured |= isinstance(message, PointStarted) or (
            isinstance(message, RunStarted) and message.points_done > 0
        )
        if isinstance(message, DiagnosisStep):
            self._contents = contents = diagnosis.Contents.of(message)
            self._lay_out(blueprints.DIAGNOSIS, lambda: blueprints.diagnosis(contents, measured=self._measured))
        elif isinstance(message, RunStarted | PointStarted):
            self._lay_out(blueprints.COMMISSIONING, blueprints.commissioning)

    def close(self) -> None:
        """Bring everything into the file, and what can be brought in time to the viewer."""
        self._hand_on_waveforms()
        self._tape.put(self._commissioning.limit_lines())
        if self._live is not None:
            self._live.close()
        self._tape.listener = None
        for note in self.notes:
            self._tape.put([entry("log", self._commissioning.when, rr.TextLog(shown(note), level="WARN"))])
        # The whole run from its beginning to its end; who looks on keeps the layout as it is.
        end_s = self._commissioning.when.experiment_s
        span = self._commissioning.resistance_span_ohm
        if self._layout == blueprints.COMMISSIONING:
            whole = blueprints.commissioning(end_s, states=self._states, resistance_ohm=span)
            self._tape.keep(blueprint(self._layout, whole))
        elif self._contents is not None and self._measured:
            contents = replace(self._contents, laws=self._diagnosis.laws)
            whole = blueprints.diagnosis(contents, measured=True, end_s=end_s, states=self._states, resistance_ohm=span)
            self._tape.keep(blueprint(self._layout, whole))
        self._tape.close()
        if self._server is not None:
            self._server.stop()
            self._server = None

    def _open_viewer(self, options: RerunOptions) -> None:
        view = best_view() if options.view == "auto" else options.view
        try:
            if view == "spawn":
                start(viewer_words(options.port, options.memory_limit))
            elif view == "web":
                self._server = start(viewer_words(options.port, options.memory_limit, web_port=options.web_port))
                # Nobody can follow what nobody knows the address of.
                print(f"fluxbench: follow the run at {page_url(options.port, options.web_port)}", file=sys.stderr)
        except (OSError, PluginError) as error:  # nobody looks on then; the file is written all the same
            self._notes.append(f"no viewer was opened: {error}")

    def _is_time(self) -> bool:
        return self._commissioning.waveform_rows >= DETAIL.block_rows or self._wall() - self._sent_at >= DETAIL.block_s

    def _hand_on_waveforms(self) -> None:
        self._tape.put(self._commissioning.waveforms())
        self._sent_at = self._wall()

    def _lay_out(self, job: str, make: Callable[[], rrb.Blueprint]) -> None:
        if self._layout != job:
            self._layout = job
            self._tape.put([blueprint(job, make())])
