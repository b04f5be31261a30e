"""Commands at the bench: run, resume, check and design; each imports its implementation when it is called."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.interface.cli._options import (
    AbsentOption,
    DriveOption,
    EffectsOption,
    JsonOption,
    JunitOption,
    LogOption,
    MotorOption,
    NoiseOption,
    ProcedureArgument,
    QuietOption,
    RehearsedOption,
    RemoteOption,
    RunArgument,
    SetOption,
    StreamOption,
    ViewOption,
)
from orchestrator.interface.cli.help_text import MEASURE

commands = typer.Typer()


def _announce(name: str, *, log: str, remote: str | None, quiet: bool, as_json: bool) -> None:
    """Print what is being loaded; nothing for `--quiet` or another program, aside where the output is JSON."""
    from orchestrator.interface.cli._output import announce_loading

    if remote is None and not quiet:
        announce_loading(name, aside=as_json or log == "json")


@commands.command(
    "run", rich_help_panel=MEASURE, epilog="Example: fluxbench run demo --out runs/first --set limits.current_a=4.8"
)
def run_command(
    procedure: Annotated[
        str | None,
        typer.Argument(help="Name of a shipped procedure, or a YAML file.", show_default="demo", metavar="PROCEDURE"),
    ] = None,
    drive: DriveOption = None,
    motor: MotorOption = None,
    settings: SetOption = None,
    out: Annotated[
        Path | None, typer.Option(help="New folder for the run; by default runs/<name>-<time>.", metavar="FOLDER")
    ] = None,
    serial: Annotated[
        str | None, typer.Option(help="The motor's serial number; stored with the run.", metavar="NUMBER")
    ] = None,
    operator: Annotated[
        str | None, typer.Option(help="The operator's name; stored with the run.", metavar="NAME")
    ] = None,
    ambient: Annotated[float | None, typer.Option(help="Ambient temperature [C]; stored with the run.")] = None,
    tags: Annotated[
        list[str] | None, typer.Option("--tag", help="Search tag of the run (may be repeated).", metavar="TAG")
    ] = None,
    notes: Annotated[
        list[str] | None, typer.Option("--note", help="A note, stored with the run (may be repeated).", metavar="TEXT")
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option(
            "--from", help="Continue this run: measure the experiment that its diagnosis proposes.", metavar="RUN"
        ),
    ] = None,
    rounds: Annotated[
        int | None, typer.Option(min=1, max=10, help="With --from: maximum number of experiments.", show_default="1")
    ] = None,
    effects: EffectsOption = None,
    queue: Annotated[
        bool, typer.Option("--queue", help="Run motor after motor; ask for each one's serial number.")
    ] = False,
    junit: JunitOption = None,
    view: ViewOption = False,
    streams: StreamOption = None,
    log: LogOption = "text",
    unattended: AbsentOption = None,
    remote: RemoteOption = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> int:
    """Commission a motor end to end.

    Align, check the rotor lock, measure, estimate. The default procedure is the demo.

    Limits in the procedure's section `accept` decide whether the motor passes; exit code 4 where it does not.

    With --from: measure the experiment that the diagnosis of a finished run proposes, into the same recording, and
    diagnose again. Own effects of the last diagnosis take part, from the file that the model records, or --effects.
    """
    _check_options(log, remote, unattended, junit)
    if source is None or (source / "run.json").is_file():  # of a foreign recording a stage is printed, and no more
        _announce(str(source or procedure or "demo"), log=log, remote=remote, quiet=quiet, as_json=as_json)
    from orchestrator.interface.cli._commission import Audience, run, run_further, run_queue

    audience = Audience(unattended, quiet, as_json, log, view, tuple(streams or ()), remote, junit)
    if queue and any(option not in (None, False) for option in (source, out, serial, remote, as_json)):
        raise typer.BadParameter("excludes --from, --out, --serial, --remote and --json", param_hint="--queue")
    if source is None:
        if rounds is not None:
            raise typer.BadParameter("requires --from", param_hint="--rounds")
        if effects is not None:
            raise typer.BadParameter("requires --from: a new run is diagnosed by `diagnose`", param_hint="--effects")
        about = {"serial": serial, "operator": operator, "ambient_c": ambient, "tags": tags, "notes": notes}
        if queue:
            return run_queue(procedure or "demo", drive, motor, settings or [], audience, about)
        return run(procedure or "demo", drive, motor, settings or [], out, audience, about)
    own = (procedure, drive, motor, settings or None, out, serial, operator, ambient, tags or None, notes or None)
    if any(option is not None for option in own):
        raise typer.BadParameter(
            "continues a run as it is: leave out PROCEDURE, --drive, --motor, --set, --out, --serial, --operator, "
            "--ambient, --tag and --note",
            param_hint="--from",
        )
    return run_further(source, rounds or 1, audience, effects)


@commands.command("resume", rich_help_panel=MEASURE, epilog="Example: fluxbench resume runs/first")
def resume_command(
    path: RunArgument,
    junit: JunitOption = None,
    view: ViewOption = False,
    streams: StreamOption = None,
    log: LogOption = "text",
    unattended: AbsentOption = None,
    remote: RemoteOption = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> int:
    """Continue an interrupted run.

    It starts at the first unmeasured point, and energises only after your confirmation.
    """
    _check_options(log, remote, unattended, junit)
    _announce(str(path), log=log, remote=remote, quiet=quiet, as_json=as_json)
    from orchestrator.interface.cli._commission import Audience, resume

    return resume(path, Audience(unattended, quiet, as_json, log, view, tuple(streams or ()), remote, junit))


def _check_options(log: str, remote: str | None, unattended: str | None, junit: Path | None) -> None:
    if log not in ("text", "json"):
        raise typer.BadParameter(f"{log!r}; expected text or json", param_hint="--log")
    if remote is not None and unattended is not None:
        raise typer.BadParameter("excludes --unattended: an operator is present", param_hint="--remote")
    if junit is not None:
        from orchestrator.runs import require_file_place

        require_file_place(junit, "--junit")


@commands.command("check", rich_help_panel=MEASURE, epilog="Example: fluxbench check demo --motor motor.yaml")
def check_command(
    procedure: ProcedureArgument,
    drive: DriveOption = None,
    motor: MotorOption = None,
    settings: SetOption = None,
    isolability: Annotated[
        bool,
        typer.Option("--isolability", help="Report the effects that it would detect and separate, and stages to add."),
    ] = False,
    model: RehearsedOption = None,
    effects: EffectsOption = None,
    noise_a: NoiseOption = None,
    as_json: JsonOption = False,
) -> int:
    """Dry run of a procedure.

    Points, duration, peak current and voltage, dissipated energy; nothing is energised.

    With --isolability: the sizes from which each effect would be detected, and separated from each other.
    """
    from orchestrator.interface.cli._check import RehearsalOptions, check

    if not isolability and any(option is not None for option in (model, effects, noise_a)):
        raise typer.BadParameter("require --isolability", param_hint="--model, --effects and --noise")
    rehearsal = RehearsalOptions(model, effects, noise_a) if isolability else None
    return check(procedure, drive, motor, settings or [], as_json, rehearsal)


@commands.command(
    "design", rich_help_panel=MEASURE, epilog="Example: fluxbench design demo hysteresis --out shortest.yaml"
)
def design_command(
    procedure: ProcedureArgument,
    effect: Annotated[list[str], typer.Argument(help="Names of effects.", metavar="EFFECT...")],
    out: Annotated[Path, typer.Option(help="YAML file to write.", metavar="FILE")],
    size: Annotated[
        float, typer.Option(min=0.02, max=100.0, help="Size to detect and separate, over the typical one.")
    ] = 1.0,
    drive: DriveOption = None,
    motor: MotorOption = None,
    settings: SetOption = None,
    model: RehearsedOption = None,
    effects: EffectsOption = None,
    noise_a: NoiseOption = None,
    as_json: JsonOption = False,
) -> int:
    """Design the shortest procedure that separates effects.

    Motor, drive, limits and stages without measurement are PROCEDURE's own; its measuring stages are replaced by
    points of its own and of a catalogue. Nothing is energised.
    """
    from orchestrator.interface.cli._check import RehearsalOptions
    from orchestrator.interface.cli._design import write_design

    rehearsal = RehearsalOptions(model, effects, noise_a)
    overrides = settings or []
    return write_design(
        procedure, effect, out, rehearsal, as_json, size=size, drive=drive, motor=motor, overrides=overrides
    )
