"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ProcedureArgument = Annotated[
    str, typer.Argument(help="Name of a shipped procedure, or a YAML file.", metavar="PROCEDURE")
]
RecordingArgument = Annotated[Path, typer.Argument(help="A recording or run directory.", metavar="RECORDING")]
DiagnosedArgument = Annotated[
    Path, typer.Argument(help="A run, a recording, or the folder of `diagnose --out`.", metavar="RUN")
]
RunArgument = Annotated[Path, typer.Argument(help="A run directory.", metavar="RUN")]
DriveOption = Annotated[str | None, typer.Option(help="Use this drive instead of the procedure's.", metavar="NAME")]
MotorOption = Annotated[
    Path | None,
    typer.Option(
        help="YAML file with a motor (and limits, drive, accept) that replaces the procedure's.", metavar="FILE"
    ),
]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="Change one setting of the procedure: key.path=value.", metavar="K=V")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
LogOption = Annotated[
    str,
    typer.Option("--log", help="Format of the run's progress: text, or json (one object per line).", metavar="FORMAT"),
]
ViewOption = Annotated[bool, typer.Option("--view", help="Open the viewer and follow the run in it.")]
StreamOption = Annotated[
    list[str] | None,
    typer.Option("--stream", help="Send the run to this installed stream as well (may be repeated).", metavar="NAME"),
]
EffectsOption = Annotated[
    Path | None,
    typer.Option(
        "--effects", help="Python file with your own candidate effects; its code is executed.", metavar="FILE"
    ),
]
RehearsedOption = Annotated[
    str | None,
    typer.Option("--model", help="Rehearse on a flux map or model.json instead of the nameplate.", metavar="MODEL"),
]
NoiseOption = Annotated[
    float | None,
    typer.Option("--noise", min=1e-12, help="Standard deviation of each phase current's reading [A].", metavar="A"),
]
AbsentOption = Annotated[
    str | None,
    typer.Option(
        "--unattended",
        help="Let the procedure answer its own safety questions, on a real drive too, with nobody present. WORDS has "
        'to be "I have made the bench safe".',
        metavar="WORDS",
    ),
]
RemoteOption = Annotated[
    str | None,
    typer.Option(
        "--remote",
        help="For a program that an operator uses, named WORD: the run is printed as lines of JSON, answers and stops "
        "are read from standard input (docs/serve.md).",
        metavar="WORD",
    ),
]
JunitOption = Annotated[
    Path | None,
    typer.Option("--junit", help="Write pass or fail by the procedure's `accept` as JUnit XML.", metavar="FILE"),
]
ModelOption = Annotated[
    str | None,
    typer.Option(
        help="linear (the nameplate), saturated (the free energy map), a flux map file, or a model.json.",
        metavar="MODEL",
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option(help="Folder for model.json and results/, instead of the recording.", metavar="FOLDER"),
]
