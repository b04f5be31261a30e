"""How a run stands, on one page of Markdown."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import duration
from orchestrator.formatting.results import resistance
from orchestrator.formatting.sentences import markdown_table, one_line
from protocols import (
    LockChecked,
    PointDone,
    PointStarted,
    ResistanceEstimate,
    RunEnded,
    RunStarted,
    StageStarted,
)


@dataclass
class Status:
    """The latest of everything that a person asks first."""

    started: RunStarted | None = None
    state: str = "idle"
    stage: StageStarted | None = None
    point: PointStarted | None = None
    done: PointDone | None = None
    lock: LockChecked | None = None
    resistance: ResistanceEstimate | None = None
    map_method: str | None = None
    ended: RunEnded | None = None

    def page(self) -> str:
        """The page."""
        title = "Commissioning" if self.started is None else self.started.motor.name
        return "\n\n".join([f"# {title}", markdown_table(("", ""), self._rows())])

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("state", plain(self.state))]
        if self.started is not None:
            rows += [(label, one_line(text)) for label, text in self.started.about.lines()]
        if self.stage is not None:
            rows.append(("stage", f"{self.stage.index + 1}, {self.stage.title or plain(self.stage.stage)}"))
        if self.done is not None:
            rows.append(("points", f"{self.done.points_done} of {self.done.points}"))
            if self.ended is None:
                rows.append(("left", f"{duration(self.done.seconds_left)} of the drive's time"))
        if self.lock is not None:
            known = {True: "locked", False: "NOT LOCKED", None: "not known whether it is locked"}
            rows.append(("rotor", known[self.lock.locked]))
        if self.resistance is not None:
            rows.append(("R_s", resistance(self.resistance)))
        if self.map_method is not None:
            rows.append(("flux map by", self.map_method))
        if self.ended is not None:
            rows.append(("outcome", f"{self.ended.outcome}: {self.ended.reason}"))
        return rows
