"""Ask the operator for a deed and wait for the answer."""

from __future__ import annotations

from typing import Literal

from protocols import Stage, StageRun


class OperatorStage(Stage):
    """Ask the operator for a deed and wait for the answer; nothing is energised meanwhile."""

    name = "operator"
    title = "operator"

    prompt: str
    answer: Literal["yes"] | None = None
    """The answer on a simulated drive, or where whoever starts the run says that it counts. None: a person's to say."""
    brake: Literal["engage", "release"] | None = None
    """What the drive does with its brake, where it has one, once the answer is yes."""

    @property
    def leaves_brake(self) -> Literal["engage", "release"] | None:
        return self.brake

    def work(self, run: StageRun) -> None:
        run.ask(self.prompt, answered=self.answer is not None)
        if self.brake is not None:
            run.set_brake(self.brake == "engage")
