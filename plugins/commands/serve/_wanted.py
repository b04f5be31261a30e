"""Requests of the page, as validated models and as command-line arguments."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from plugins.commands.serve._choices import motor_word, procedure_word
from protocols import Strict


def _without_nul(text: str) -> str:
    if "\0" in text:
        raise ValueError("contains a NUL character, which no command line can hold")
    return text


Line = Annotated[str, Field(max_length=2000), AfterValidator(_without_nul)]


class Wanted(Strict):
    """A request for a run: a procedure with overrides."""

    procedure: Line
    motor: Line = ""
    drive: Line = ""
    settings: tuple[Line, ...] = Field((), max_length=100)
    serial: Line = ""
    operator: Line = ""
    ambient_c: float | None = None
    tags: tuple[Line, ...] = Field((), max_length=100)
    note: Line = ""

    @property
    def subject(self) -> str:
        """Procedure, motor and drive."""
        drive = f"drive {self.drive}" if self.drive else ""
        return " · ".join(part for part in (self.procedure, self.motor or "the procedure's motor", drive) if part)

    def checking(self, folder: Path) -> list[str]:
        """Arguments of `fluxbench check`."""
        words = ["check", procedure_word(folder, self.procedure), "--json"]
        if self.motor:
            words.append(f"--motor={motor_word(folder, self.motor)}")
        if self.drive:
            words.append(f"--drive={self.drive}")
        return words + [f"--set={setting}" for setting in self.settings if setting.strip()]

    def running(self, folder: Path) -> list[str]:
        """Arguments of `fluxbench run` that the page determines."""
        _, procedure, _, *overrides = self.checking(folder)
        about = {"serial": self.serial, "operator": self.operator, "note": self.note}
        options = [f"--{name}={value}" for name, value in about.items() if value.strip()]
        options += [f"--tag={tag}" for tag in self.tags if tag.strip()]
        options += [] if self.ambient_c is None else [f"--ambient={self.ambient_c}"]
        return ["run", procedure, *overrides, *options]


class Answer(Strict):
    """A person's answer to the question with this number."""

    question: int
    answer: Literal["yes", "no"]


class RunNamed(Strict):
    """One of the folder's runs."""

    run: Line


Text = Annotated[Line, Field(min_length=1)]


class RunLabelled(Strict):
    """The tags and notes that a person gives a run."""

    run: Line
    tags: tuple[Text, ...] = Field((), max_length=100)
    notes: tuple[Text, ...] = Field((), max_length=100)


class RunsWanted(Strict):
    """Runs to be listed."""

    words: Line = ""
    sort: Line = "-created"
    skip: int = Field(0, ge=0, le=1 << 40)


class ComparedRuns(Strict):
    """Runs to be compared with the first of them."""

    runs: tuple[Line, ...] = Field(min_length=2, max_length=8)


class Trend(Strict):
    """The motor whose results are followed over its runs."""

    motor: Line
    serial: Line = ""
