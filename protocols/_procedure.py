"""The procedure: what a commissioning run does, in which order, with which settings.

What a stage's settings mean is known to its plugin alone (`protocols._stages`); those left out are derived from
the nameplate and the limits when the plan is made, so that one procedure serves motors of every size.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from protocols._acceptance import Acceptance
from protocols._base import Strict
from protocols._drive import Limits
from protocols._excitations import CurrentControl
from protocols._motor import ProcedureMotor

Point = tuple[float, float]
"""(i_d, i_q) in amperes, peak."""


NoWatchdogSentence = Literal["I stand beside the drive and can cut its power"]
"""What a procedure says to use a drive without a dead man."""


class StageEntry(Strict):
    """Name of a stage plugin, and its settings."""

    model_config = ConfigDict(extra="allow", frozen=True, use_attribute_docstrings=True)

    kind: str

    @property
    def settings(self) -> dict[str, Any]:
        """Settings beside the kind, validated by the stage."""
        return dict(self.model_extra or {})


class DriveChoice(Strict):
    """Name of a drive plugin, and its options."""

    model_config = ConfigDict(extra="allow", frozen=True, use_attribute_docstrings=True)

    name: str
    """Name of an installed drive plugin, as `fluxbench plugins` lists them."""

    @property
    def options(self) -> dict[str, Any]:
        """Options beside the name, validated by the plugin's `Options`."""
        return dict(self.model_extra or {})


class About(Strict):
    """Description of a run, to find it later; not used in computations."""

    serial: str = ""
    """Serial number of the motor."""
    operator: str = ""
    ambient_c: Annotated[float, Field(ge=-80.0, le=200.0)] | None = None
    """Temperature of the room when the run began."""
    instruments: tuple[str, ...] = ()
    """Instruments beside the drive, with serial number and calibration."""
    tags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def lines(self) -> list[tuple[str, str]]:
        """Label and text of all that is given."""
        ambient = "" if self.ambient_c is None else f"{self.ambient_c:g} °C"
        labelled = [("serial", self.serial), ("operator", self.operator), ("ambient", ambient)]
        labelled += [("instruments", "; ".join(self.instruments)), ("tags", ", ".join(self.tags))]
        return [(label, text) for label, text in (*labelled, ("notes", "; ".join(self.notes))) if text]


class ThermometerChoice(Strict):
    """A thermometer beside the drive, whose readings are recorded with the currents instead of the drive's own."""

    file: Path | None = None
    """A logger's text file, which grows by a line for each reading."""
    port: str | None = None
    """Or a serial port that sends lines."""
    baud_rate: Annotated[int, Field(ge=50)] = 9600
    column: int = -1
    """Which of a line's numbers it is, from 0; -1 is the last. Dates and times of day are no numbers."""
    stale_s: Annotated[float, Field(gt=0)] = 60.0
    """A reading that is older counts as none."""

    @model_validator(mode="after")
    def _one_source(self) -> ThermometerChoice:
        if (self.file is None) == (self.port is None):
            raise ValueError("give either file or port")
        return self


class Procedure(Strict):
    """A commissioning run, whole."""

    format: Literal["fluxbench-procedure"]
    version: Literal[1]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    summary: str = ""
    motor: ProcedureMotor
    about: About = About()
    drive: DriveChoice
    limits: Limits
    seed: int = 1
    """Seeds everything random in the run (a simulated drive's noise)."""
    control: CurrentControl = CurrentControl()
    thermometer: ThermometerChoice | None = None
    interlocks: tuple[str, ...] = ()
    """Interlock inputs that the drive must have; the engine reads all inputs before arming and between points."""
    accept_no_watchdog: NoWatchdogSentence | None = None
    """A drive without a dead man is refused unless this sentence is written out."""
    accept: Acceptance | None = None
    """Limits that the motor has to keep; the run ends with exit code 4 where it does not."""
    stages: Annotated[tuple[StageEntry, ...], Field(min_length=1)]


def shipped_procedures() -> tuple[str, ...]:
    """Names of the procedures in the package, in alphabetical order."""
    folder = files("protocols") / "procedures"
    return tuple(sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml")))


def shipped_procedure(name: str) -> str:
    """YAML text of a shipped procedure; raises `KeyError` where there is none of that name."""
    if name not in shipped_procedures():
        raise KeyError(name)
    return (files("protocols") / "procedures" / f"{name}.yaml").read_text(encoding="utf-8")
