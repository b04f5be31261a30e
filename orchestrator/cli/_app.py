"""The commands and their options; every heavy import waits until its command is called."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from orchestrator.cli._foreign import is_foreign

ENERGISING = ("run", "resume")


class _Commands(typer.core.TyperGroup):
    """The group of commands; typer itself would leave at Ctrl-C without a word.

    Where the context's object is callable, it is told whether the command energises, before that begins; a plugin's
    own command tells it when it is loaded.
    """

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        found = super().resolve_command(ctx, args)
        if callable(ctx.obj) and not is_foreign(found[0]):
            ctx.obj(found[0] in ENERGISING)
        return found

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise typer.Abort from None


app = typer.Typer(
    cls=_Commands,
    name="fluxbench",
    help="Commission a permanent-magnet synchronous motor: saturated current-flux relations, measured and checked.",
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

START = """fluxbench commissions a permanent-magnet synchronous motor. To begin with:

  fluxbench procedures            what there is to run
  fluxbench check demo            what it would do; nothing is energised
  fluxbench run demo              do it, on a simulated drive
  fluxbench diagnose runs/NAME    which effect the model lacks
  fluxbench explain runs/NAME     why the diagnosis says so
  fluxbench probe                 drives on this machine's serial ports and CAN buses

fluxbench --help lists all commands, fluxbench COMMAND --help the options of one."""


def _say_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"fluxbench {version('fluxbench')}")
        raise typer.Exit


VersionOption = Annotated[
    bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Print the version, and leave.")
]


@app.callback(invoke_without_command=True)
def start(context: typer.Context, _version: VersionOption = False) -> None:
    """Commission a permanent-magnet synchronous motor: saturated current-flux relations, measured and checked."""
    if context.invoked_subcommand is None:
        typer.echo(START)


ProcedureArgument = Annotated[str, typer.Argument(help="Name of a shipped procedure, or a YAML file.")]
RecordingArgument = Annotated[Path, typer.Argument(help="A recording or run directory.", metavar="RECORDING")]
DiagnosedArgument = Annotated[
    Path, typer.Argument(help="A run, a recording, or what `diagnose --out` wrote to.", metavar="RUN")
]
RunArgument = Annotated[Path, typer.Argument(help="A run directory.", metavar="RUN")]
DriveOption = Annotated[str | None, typer.Option(help="Use this drive instead of the procedure's.")]
MotorOption = Annotated[
    Path | None, typer.Option(help="YAML file with another motor (and limits, drive) to put in the procedure's place.")
]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="Change one setting of the procedure: key.path=value.", metavar="K=V")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print only what went wrong.")]
LogOption = Annotated[
    str, typer.Option("--log", help="How the run is told while it lasts: text, or json (one object a line).")
]
ViewOption = Annotated[bool, typer.Option("--view", help="Open the viewer, and follow the run in it.")]
StreamOption = Annotated[
    list[str] | None, typer.Option("--stream", help="Let this installed stream listen as well (may be repeated).")
]
EffectsOption = Annotated[
    Path | None, typer.Option("--effects", help="Python file with candidates of your own; its code is run.")
]
RehearsedOption = Annotated[
    str | None, typer.Option("--model", help="Rehearse on a flux map or model.json instead of the nameplate.")
]
NoiseOption = Annotated[
    float | None,
    typer.Option("--noise", min=1e-12, help="Of each phase current's reading, standard deviation [A].", metavar="A"),
]
AbsentOption = Annotated[
    str | None,
    typer.Option(
        "--unattended",
        help='"I have made the bench safe": nobody is there, and the procedure answers its questions, on a real '
        "drive too.",
        metavar="WORDS",
    ),
]
RemoteOption = Annotated[
    str | None,
    typer.Option(
        "--remote",
        help="For programs with a person at them: WORD says what that is. The run goes out as lines of JSON, answers "
        "and stops come in (docs/serve.md).",
        metavar="WORD",
    ),
]


@app.command("run")
def run_command(
    procedure: Annotated[
        str | None, typer.Argument(help="Name of a shipped procedure, or a YAML file.", show_default="demo")
    ] = None,
    drive: DriveOption = None,
    motor: MotorOption = None,
    settings: SetOption = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to make for the run; by default runs/<name>-<time>.", metavar="FOLDER")
    ] = None,
    serial: Annotated[str | None, typer.Option(help="The motor's serial number; kept with the run.")] = None,
    operator: Annotated[str | None, typer.Option(help="Who runs it; kept with the run.")] = None,
    ambient: Annotated[float | None, typer.Option(help="Temperature of the room [C]; kept with the run.")] = None,
    tags: Annotated[
        list[str] | None, typer.Option("--tag", help="A word to find the run by (may be repeated).")
    ] = None,
    notes: Annotated[list[str] | None, typer.Option("--note", help="Kept with the run (may be repeated).")] = None,
    source: Annotated[
        Path | None, typer.Option("--from", help="Go on with this run: measure what its diagnosis proposes.")
    ] = None,
    rounds: Annotated[
        int | None, typer.Option(min=1, max=10, help="With --from: most experiments that may follow.", show_default="1")
    ] = None,
    view: ViewOption = False,
    streams: StreamOption = None,
    log: LogOption = "text",
    unattended: AbsentOption = None,
    remote: RemoteOption = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> int:
    """Commission a motor end to end.

    The main job: align, check the lock, measure, estimate. Where no procedure is named: the demo.

    With --from: measure what the diagnosis of a finished run proposes, into the same recording, and diagnose again.
    """
    from orchestrator.cli._commission import Audience, run, run_further

    audience = Audience(
        unattended, quiet, as_json, _log_of(log), view, tuple(streams or ()), _remote_of(remote, unattended)
    )
    if source is None:
        if rounds is not None:
            raise typer.BadParameter("goes with --from only", param_hint="--rounds")
        about = {"serial": serial, "operator": operator, "ambient_c": ambient, "tags": tags, "notes": notes}
        return run(procedure or "demo", drive, motor, settings or [], out, audience, about)
    own = (procedure, drive, motor, settings or None, out, serial, operator, ambient, tags or None, notes or None)
    if any(given is not None for given in own):
        raise typer.BadParameter("goes on with the run's own procedure, drive and directory", param_hint="--from")
    return run_further(source, rounds or 1, audience)


@app.command("resume")
def resume_command(
    path: RunArgument,
    view: ViewOption = False,
    streams: StreamOption = None,
    log: LogOption = "text",
    unattended: AbsentOption = None,
    remote: RemoteOption = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> int:
    """Go on with an interrupted run.

    It starts at the first point that is not done, and energises only on your word.
    """
    from orchestrator.cli._commission import Audience, resume

    heard = _remote_of(remote, unattended)
    return resume(path, Audience(unattended, quiet, as_json, _log_of(log), view, tuple(streams or ()), heard))


def _remote_of(remote: str | None, unattended: str | None) -> str | None:
    if remote is not None and unattended is not None:
        raise typer.BadParameter("somebody is there: without --unattended", param_hint="--remote")
    return remote


def _log_of(log: str) -> str:
    if log not in ("text", "json"):
        raise typer.BadParameter(f"{log!r}; expected text or json", param_hint="--log")
    return log


@app.command("check")
def check_command(
    procedure: ProcedureArgument,
    drive: DriveOption = None,
    motor: MotorOption = None,
    settings: SetOption = None,
    isolability: Annotated[
        bool, typer.Option("--isolability", help="And which effects it would find and tell apart, and what to add.")
    ] = False,
    model: RehearsedOption = None,
    effects: EffectsOption = None,
    noise_a: NoiseOption = None,
    as_json: JsonOption = False,
) -> int:
    """Dry run: what a procedure would do.

    Points, duration, peak current and voltage, dissipated energy; nothing is energised.

    With --isolability: from which size on each effect would be found, and told from each other.
    """
    from orchestrator.cli._check import RehearsalOptions, check

    if not isolability and any(given is not None for given in (model, effects, noise_a)):
        raise typer.BadParameter("goes with --isolability only", param_hint="--model, --effects and --noise")
    rehearsal = RehearsalOptions(model, effects, noise_a) if isolability else None
    return check(procedure, drive, motor, settings or [], as_json, rehearsal)


@app.command("design")
def design_command(
    procedure: ProcedureArgument,
    effect: Annotated[list[str], typer.Argument(help="Names of effects.", metavar="EFFECT...")],
    out: Annotated[Path, typer.Option(help="YAML file to write.", metavar="FILE")],
    size: Annotated[
        float, typer.Option(min=0.02, max=100.0, help="At which they are to be told, over the typical one.")
    ] = 1.0,
    drive: DriveOption = None,
    motor: MotorOption = None,
    settings: SetOption = None,
    model: RehearsedOption = None,
    effects: EffectsOption = None,
    noise_a: NoiseOption = None,
    as_json: JsonOption = False,
) -> int:
    """The shortest procedure that tells effects apart.

    Motor, drive, limits and all that measures nothing are PROCEDURE's own; what measures is chosen anew, from its
    points and from a catalogue. Nothing is energised.
    """
    from orchestrator.cli._check import RehearsalOptions
    from orchestrator.cli._design import write_design

    rehearsal = RehearsalOptions(model, effects, noise_a)
    overrides = settings or []
    return write_design(
        procedure, effect, out, rehearsal, as_json, size=size, drive=drive, motor=motor, overrides=overrides
    )


@app.command("estimate")
def estimate_command(
    recording: RecordingArgument,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write results/ to, instead of the recording.", metavar="FOLDER")
    ] = None,
    estimators: Annotated[
        list[str] | None, typer.Option("--estimator", help="Only this estimator (may be repeated).")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Maps and resistance from a recording.

    Stator resistance, flux and inductance maps, and how far they agree with themselves.
    """
    from orchestrator.cli._output import announce

    announce(recording, as_json)
    from orchestrator.cli._results import estimate

    return estimate(recording, out, estimators or [], as_json)


ModelOption = Annotated[
    str | None,
    typer.Option(help="linear (the nameplate), saturated (the free energy map), a flux map file, or a model.json."),
]
OutOption = Annotated[
    Path | None,
    typer.Option(help="Folder to keep model.json and results/ in, instead of the recording.", metavar="FOLDER"),
]


@app.command("compare")
def compare_command(
    recordings: Annotated[list[Path], typer.Argument(help="One recording or run, or several.", metavar="RECORDING...")],
    model: ModelOption = None,
    effects: EffectsOption = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to take model.json from, instead of the recording.", metavar="FOLDER")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Where the model fails; or several runs side by side.

    Of one recording: its measurements against the model of model.json as it stands, where there is one, else against
    the saturated map alone; with --effects, whether each candidate in that file would help. Of several: R_s,
    inductances, flux, effects and verdicts of each, and what changed beyond noise from the first to the others;
    `report` and `view` take the same runs.
    """
    if len(recordings) > 1 and any(given is not None for given in (model, effects, out)):
        raise typer.BadParameter("go with one recording only", param_hint="--model, --effects and --out")
    from orchestrator.cli._output import announce

    for recording in recordings:
        announce(recording, as_json)
    if len(recordings) > 1:
        from orchestrator.cli._comparison import compare_runs

        return compare_runs(recordings, as_json)
    from orchestrator.cli._diagnosis import compare

    return compare(recordings[0], model, effects, out, as_json)


@app.command("diagnose")
def diagnose_command(
    recording: RecordingArgument,
    model: ModelOption = None,
    effects: EffectsOption = None,
    without: Annotated[list[str] | None, typer.Option(help="Take this effect out of the library.")] = None,
    material_flux: Annotated[
        float | None, typer.Option(min=0.0, help="An effect counts from this change of the map on, % of rated flux.")
    ] = None,
    material_voltage: Annotated[
        float | None, typer.Option(min=0.0, help="Or from this voltage on, % of the excitation's rms.")
    ] = None,
    priors: Annotated[
        Path | None, typer.Option(help="What a fleet of its kind lets expect: what `fluxbench fleet priors` wrote.")
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> int:
    """Which effect is missing.

    How sure that is, what else it could be, and what to measure next. Ctrl-C ends the search, and reports what was
    found so far; a second one ends at once.
    """
    from orchestrator.cli._output import announce

    announce(recording, as_json)
    from orchestrator.cli._diagnosis import diagnose

    return diagnose(recording, model, effects, without or [], (material_flux, material_voltage), out, as_json, priors)


@app.command("explain")
def explain_command(run: DiagnosedArgument, as_json: JsonOption = False) -> int:
    """Why the diagnosis says what it says.

    The reasons of the verdict, each number beside its limit; every move of the search; what each effect rests on.
    """
    from orchestrator.cli._explaining import explain

    return explain(run, as_json)


@app.command("add")
def add_command(
    recording: RecordingArgument,
    effect: Annotated[list[str], typer.Argument(help="Names of effects.", metavar="EFFECT...")],
    model: ModelOption = None,
    effects: EffectsOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> int:
    """Add effects to the model.

    The model is fitted anew, the ladder grows, the error falls.
    """
    from orchestrator.cli._output import announce

    announce(recording, as_json)
    from orchestrator.cli._diagnosis import add

    return add(recording, effect, model, effects, out, as_json)


@app.command("remove")
def remove_command(
    recording: RecordingArgument,
    effect: Annotated[str, typer.Argument(help="Name of the effect.")],
    effects: EffectsOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> int:
    """Take an effect out of the model."""
    from orchestrator.cli._output import announce

    announce(recording, as_json)
    from orchestrator.cli._diagnosis import remove

    return remove(recording, effect, effects, out, as_json)


@app.command("export")
def export_command(
    path: Annotated[Path, typer.Argument(help="A run, a recording, a map file, or a model.json.", metavar="RUN")],
    formats: Annotated[list[str] | None, typer.Option("--format", help="Only this format (may be repeated).")] = None,
    motor: Annotated[Path | None, typer.Option(help="YAML file with the motor, for a map file.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to; by default export/ in RUN.", metavar="FOLDER")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Flux map, torque and saliency for other tools."""
    from orchestrator.cli._exchange import export

    return export(path, formats or [], motor, out, as_json)


@app.command("audit")
def audit_command(
    path: Annotated[
        Path, typer.Argument(help="A run, a map file, a model.json, or a mapping of any table.", metavar="MAP")
    ],
    motor: Annotated[Path | None, typer.Option(help="YAML file with the motor, for its pole pairs.")] = None,
    repair: Annotated[
        Path | None, typer.Option(help="Write the nearest map that a motor can have there (.nc).", metavar="OUT")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw map and faults (.svg, .png or .pdf).")] = None,
    as_json: JsonOption = False,
) -> int:
    """A flux map judged: can a motor be like that?

    Reciprocity, parity, the magnet's axis, convexity, holes, scatter, torque; and which uses each fault spoils. For a
    table with names of its own it prints a mapping that reads it, to be saved and looked at.
    """
    from orchestrator.cli._audit import audit

    return audit(path, motor, repair, picture, as_json)


@app.command("import")
def import_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="YAML file that says what the columns are; CSV, Parquet, MATLAB, HDF5, MF4, TDMS or COMTRADE files.",
            metavar="MAPPING FILE...",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the recording to make; with --guess, the mapping file to write.", metavar="FOLDER|FILE"
        ),
    ] = None,
    guess: Annotated[bool, typer.Option("--guess", help="Write a mapping for FILE, each line with a reason.")] = False,
    merge: Annotated[bool, typer.Option("--merge", help="Make one recording of several.")] = False,
    motor: Annotated[Path | None, typer.Option(help="With --guess: YAML file with the motor.")] = None,
    as_json: JsonOption = False,
) -> int:
    """Somebody else's measurements into a recording."""
    from orchestrator.cli._exchange import guess_import, import_, merge_import

    if guess:
        return guess_import(files, out, motor, as_json)
    if merge and out is not None:
        return merge_import(files, out, as_json)
    if out is None or len(files) < 2:
        raise typer.BadParameter("expected MAPPING FILE... --out DIR, --merge RECORDING... --out DIR, or --guess FILE")
    return import_(files[0], files[1:], out, as_json)


@app.command("runs")
def runs_command(
    words: Annotated[
        list[str] | None, typer.Argument(help="Only runs with all of these words.", metavar="WORD")
    ] = None,
    folder: Annotated[Path, typer.Option(help="Where to look.")] = Path("runs"),
    as_json: JsonOption = False,
) -> int:
    """The runs below a folder, searched by words.

    What they are of (motor, serial number, operator, tags, notes), when they were made, and how they ended.
    """
    from orchestrator.cli._runs import runs

    return runs(folder, words or [], as_json)


@app.command("new")
def new_command(
    kind: Annotated[str, typer.Argument(help="drive, stage, estimator, effect or stream.")],
    name: Annotated[str, typer.Argument(help="Name of the plugin: lower-case letters, digits, underscores.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder to make; by default fluxbench-NAME.", metavar="FOLDER")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """A package for a plugin of your own.

    It passes its conformance kit as it is; from there, change it step by step.
    """
    from orchestrator.cli._new import new

    return new(kind, name, out, as_json)


@app.command("plugins")
def plugins_command(as_json: JsonOption = False) -> int:
    """What is installed, and whether it loads.

    Plugins are Python: those that are listed have been imported, and their code has the rights that you have.
    """
    from orchestrator.cli._inspect import plugins

    return plugins(as_json)


@app.command("procedures")
def procedures_command(
    name: Annotated[str | None, typer.Argument(help="Print this one, as a start for your own.")] = None,
    as_json: JsonOption = False,
) -> int:
    """The procedures that come with it."""
    from orchestrator.cli._inspect import procedures

    return procedures(name, as_json)


@app.command("effects")
def effects_command(as_json: JsonOption = False) -> int:
    """The physical effects that a diagnosis knows."""
    from orchestrator.cli._inspect import effects

    return effects(as_json)


@app.command("schema")
def schema_command(
    name: Annotated[
        str, typer.Argument(help="procedure, motor, recording, mapping, run, estimates; or drive, and its NAME.")
    ],
    plugin: Annotated[str | None, typer.Argument(help="Of the drive.", metavar="[NAME]")] = None,
    as_table: Annotated[bool, typer.Option("--table", help="A table in Markdown instead.")] = False,
) -> int:
    """JSON Schema of a file format or of a drive's options, for editors."""
    from orchestrator.cli._inspect import schema

    return schema(name, plugin, as_table)
