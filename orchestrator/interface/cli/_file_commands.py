"""Commands on maps, files and plugins; each imports its implementation when it is called."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.interface.cli._options import EffectsOption, JsonOption, RunArgument
from orchestrator.interface.cli.help_text import LOOK_UP, RECORDINGS, USE

commands = typer.Typer()


@commands.command("export", rich_help_panel=USE, epilog="Example: fluxbench export runs/first")
def export_command(
    path: Annotated[Path, typer.Argument(help="A run, a recording, a map file, or a model.json.", metavar="RUN")],
    formats: Annotated[
        list[str] | None, typer.Option("--format", help="Only this format (may be repeated).", metavar="FORMAT")
    ] = None,
    motor: Annotated[
        Path | None, typer.Option(help="YAML file with the motor, for a map file.", metavar="FILE")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to; by default export/ in RUN.", metavar="FOLDER")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Export flux map, torque and saliency to other tools."""
    from orchestrator.interface.cli._exchange import export

    return export(path, formats or [], motor, out, as_json)


@commands.command("tune", rich_help_panel=USE, epilog="Example: fluxbench tune runs/first --speed-rpm 4000")
def tune_command(
    path: Annotated[Path, typer.Argument(help="A run or recording with a flux map; or a map file.", metavar="RUN")],
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to; by default tuning/ in RUN.", metavar="FOLDER")
    ] = None,
    motor: Annotated[
        Path | None, typer.Option(help="YAML file with the motor, for a map file.", metavar="FILE")
    ] = None,
    current_a: Annotated[
        float | None, typer.Option(help="Largest current, peak [A]; by default the rated one, as far as measured.")
    ] = None,
    bus_v: Annotated[float | None, typer.Option(help="DC bus voltage [V]; by default the recording's.")] = None,
    speed_rpm: Annotated[
        float | None, typer.Option(help="Largest speed, mechanical [1/min]; by default the rated one.")
    ] = None,
    sampling_hz: Annotated[
        float | None,
        typer.Option(
            help="Frequency of the current control [Hz], twice the PWM's with a double update; by default the PWM's."
        ),
    ] = None,
    pwm_hz: Annotated[
        float | None,
        typer.Option(help="PWM frequency, which the inverter's loss follows [Hz]; by default the recording's."),
    ] = None,
    magnet_percent_per_k: Annotated[
        float | None,
        typer.Option(help="Change of the magnet's flux [%/K], such as -0.11; its temperature is then used."),
    ] = None,
    effects: EffectsOption = None,
    as_json: JsonOption = False,
) -> int:
    """Tune a drive: references, gains, compensation and C code.

    Least currents over torque, speed and bus voltage. Gains with the phase margin over the map's errors. The inverter's
    and the sensors' errors that the diagnosis found. Where sensorless control works. As C99, CSV and JSON, and in the
    report.
    """
    from orchestrator.interface.cli._tuning import tune

    return tune(
        path, out, motor, current_a, bus_v, speed_rpm, sampling_hz, pwm_hz, magnet_percent_per_k, effects, as_json
    )


@commands.command("audit", rich_help_panel=USE, epilog="Example: fluxbench audit runs/first")
def audit_command(
    path: Annotated[
        Path, typer.Argument(help="A run, a map file, a model.json, or a mapping of any table.", metavar="MAP")
    ],
    motor: Annotated[
        Path | None, typer.Option(help="YAML file with the motor, for its pole pairs.", metavar="FILE")
    ] = None,
    repair: Annotated[
        Path | None, typer.Option(help="Write the nearest physically possible map to this file (.nc).", metavar="OUT")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw map and faults (.svg, .png or .pdf).", metavar="FILE")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Check whether a flux map is physically possible.

    Reciprocity, parity, the magnet's axis, convexity, holes, scatter, torque, and the uses that each fault spoils. For
    a table with unknown column names it prints a mapping that reads it, to be checked and saved.
    """
    from orchestrator.interface.cli._audit import audit

    return audit(path, motor, repair, picture, as_json)


@commands.command(
    "import", rich_help_panel=RECORDINGS, epilog="Example: fluxbench import mapping.yaml log.csv --out recordings/mine"
)
def import_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="YAML file with the columns' meaning; CSV, Parquet, MATLAB, HDF5, MF4, TDMS or COMTRADE files.",
            metavar="MAPPING FILE...",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="New folder for the recording; with --guess, the mapping file to write.", metavar="FOLDER|FILE"
        ),
    ] = None,
    guess: Annotated[bool, typer.Option("--guess", help="Write a mapping for FILE, each line with a reason.")] = False,
    merge: Annotated[bool, typer.Option("--merge", help="Merge several recordings into one.")] = False,
    motor: Annotated[
        Path | None, typer.Option(help="With --guess: YAML file with the motor (and drive).", metavar="FILE")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Import measurements of other tools as a recording.

    The mapping states name, motor, drive, time, current, voltage and segments, each with its columns and units. --guess
    writes one for a file; `fluxbench schema mapping` lists its fields, and docs/import.md explains them.
    """
    from orchestrator.interface.cli._exchange import guess_import, import_, merge_import, require_import_files

    if guess:
        return guess_import(files, out, motor, as_json)
    if merge and out is not None:
        return merge_import(files, out, as_json)
    if not merge:
        require_import_files(files, has_out=out is not None)
    if out is None:
        raise typer.BadParameter("--out is missing: the new folder for the recording")
    return import_(files[0], files[1:], out, as_json)


@commands.command("runs", rich_help_panel=RECORDINGS, epilog="Example: fluxbench runs finished")
def runs_command(
    words: Annotated[
        list[str] | None, typer.Argument(help="Only runs with all of these words.", metavar="WORD")
    ] = None,
    folder: Annotated[Path, typer.Option(help="Folder to search.", metavar="FOLDER")] = Path("runs"),
    where: Annotated[
        list[str] | None,
        typer.Option(help="Only runs with 'COLUMN=VALUE'; also != < > <= >= and ~ (contains).", metavar="CONDITION"),
    ] = None,
    columns: Annotated[
        str | None, typer.Option(help="Columns to print, separated by commas; --json names all.", metavar="NAMES")
    ] = None,
    sort: Annotated[
        str, typer.Option(help="Column to sort by; -COLUMN: the largest first.", metavar="COLUMN")
    ] = "created",
    limit: Annotated[int | None, typer.Option(min=1, help="Number of runs at most.")] = None,
    skip_damaged: Annotated[
        bool, typer.Option("--skip-damaged", help="Exit with 0, not 3, although some runs cannot be read.")
    ] = False,
    as_json: JsonOption = False,
) -> int:
    """List the runs below a folder, and filter them.

    Motor, serial number, operator, time, outcome, verdict, acceptance, tags and notes of each; with --columns R_s,
    inductances, flux and more. A run that cannot be read is named.
    """
    from orchestrator.interface.cli._runs import RunsOptions, list_runs

    names = [] if columns is None else [name.strip() for name in columns.split(",")]
    options = RunsOptions(words or [], where or [], names, sort, limit or -1, skip_damaged, as_json)
    return list_runs(folder, options)


@commands.command(
    "note", rich_help_panel=RECORDINGS, epilog="Example: fluxbench note runs/first 'new brake' --tag bench2"
)
def note_command(
    path: RunArgument,
    notes: Annotated[list[str] | None, typer.Argument(help="Notes to add.", metavar="NOTE")] = None,
    tags: Annotated[
        list[str] | None, typer.Option("--tag", help="Tag to add (may be repeated).", metavar="TAG")
    ] = None,
    untag: Annotated[list[str] | None, typer.Option(help="Tag to remove (may be repeated).", metavar="TAG")] = None,
    as_json: JsonOption = False,
) -> int:
    """Add notes and tags to a run, remove tags, and print them all.

    They are kept in labels.json of the run's folder, and replace those with which it was started.
    """
    from orchestrator.interface.cli._runs import note

    return note(path, notes or [], tags or [], untag or [], as_json)


@commands.command("new", rich_help_panel=LOOK_UP, epilog="Example: fluxbench new effect lagging_drop")
def new_command(
    kind: Annotated[str, typer.Argument(help="drive, stage, estimator, effect or stream.", metavar="KIND")],
    name: Annotated[
        str, typer.Argument(help="Name of the plugin: lower-case letters, digits, underscores.", metavar="NAME")
    ],
    out: Annotated[Path | None, typer.Option(help="New folder; by default fluxbench-NAME.", metavar="FOLDER")] = None,
    as_json: JsonOption = False,
) -> int:
    """Create a package for your own plugin.

    It passes its conformance kit from the start; change it step by step.
    """
    from orchestrator.interface.cli._new import new

    return new(kind, name, out, as_json)


@commands.command("plugins", rich_help_panel=LOOK_UP, epilog="Example: fluxbench plugins")
def plugins_command(as_json: JsonOption = False) -> int:
    """List the installed plugins, and whether each loads.

    Plugins are Python code: listing imports them, and their code has your rights.
    """
    from orchestrator.interface.cli._inspect import plugins

    return plugins(as_json)


@commands.command("procedures", rich_help_panel=LOOK_UP, epilog="Example: fluxbench procedures demo")
def procedures_command(
    name: Annotated[
        str | None, typer.Argument(help="Print this procedure, as a template for your own.", metavar="NAME")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """List the shipped procedures."""
    from orchestrator.interface.cli._inspect import procedures

    return procedures(name, as_json)


@commands.command("effects", rich_help_panel=LOOK_UP, epilog="Example: fluxbench effects")
def effects_command(
    name: Annotated[str | None, typer.Argument(help="Describe this effect alone.", metavar="[EFFECT]")] = None,
    effects: EffectsOption = None,
    as_json: JsonOption = False,
) -> int:
    """List the physical effects of the library, or describe one.

    With EFFECT: what it is, how it shows, its parameters, and what to do at the bench. With --effects, those of that
    file too.
    """
    from orchestrator.interface.cli import _inspect

    return _inspect.effects(name, effects, as_json)


@commands.command("schema", rich_help_panel=LOOK_UP, epilog="Example: fluxbench schema motor --table")
def schema_command(
    name: Annotated[
        str,
        typer.Argument(
            help="procedure, motor, recording, mapping, run, estimates; or drive, and its NAME.", metavar="NAME"
        ),
    ],
    plugin: Annotated[str | None, typer.Argument(help="Name of the drive.", metavar="[NAME]")] = None,
    as_table: Annotated[bool, typer.Option("--table", help="Print a table in Markdown instead.")] = False,
) -> int:
    """Describe a file format's fields, or a drive's options.

    As JSON Schema, for editors; with --table for people.
    """
    from orchestrator.interface.cli._inspect import schema

    return schema(name, plugin, as_table)
