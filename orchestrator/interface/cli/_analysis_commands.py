"""Commands on a recording: estimate, compare, diagnose, explain, add, remove; each imports its work on call."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.interface.cli._options import (
    DiagnosedArgument,
    EffectsOption,
    JsonOption,
    ModelOption,
    OutOption,
    RecordingArgument,
)
from orchestrator.interface.cli._output import announce
from orchestrator.interface.cli.help_text import DIAGNOSE

commands = typer.Typer()


@commands.command("estimate", rich_help_panel=DIAGNOSE, epilog="Example: fluxbench estimate runs/first")
def estimate_command(
    recording: RecordingArgument,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write results/ to, instead of the recording.", metavar="FOLDER")
    ] = None,
    estimators: Annotated[
        list[str] | None,
        typer.Option("--estimator", help="Only this one (repeatable), into estimators/NAME/results/.", metavar="NAME"),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Estimate resistance and maps from a recording.

    Stator resistance, flux and inductance maps, and checks of their consistency.
    """
    announce(recording, as_json)
    from orchestrator.interface.cli._results import estimate

    return estimate(recording, out, estimators or [], as_json)


@commands.command("compare", rich_help_panel=DIAGNOSE, epilog="Example: fluxbench compare runs/first --model saturated")
def compare_command(
    recordings: Annotated[list[Path], typer.Argument(help="One recording or run, or several.", metavar="RECORDING...")],
    model: ModelOption = None,
    effects: EffectsOption = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder with model.json, instead of the recording.", metavar="FOLDER")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Compare a model with a recording, or several runs.

    One recording: its measurements against model.json, or against the saturated map where there is none; with
    --effects, whether each candidate in that file would help. Several: R_s, inductances, flux, effects and verdict
    of each, and the changes beyond noise from the first to the others; `report` and `view` take the same runs.
    """
    if len(recordings) > 1:
        from orchestrator.runs import without_private

        recordings = without_private(recordings)
    if len(recordings) > 1 and any(option is not None for option in (model, effects, out)):
        raise typer.BadParameter("require a single recording", param_hint="--model, --effects and --out")
    for recording in recordings:
        announce(recording, as_json)
    if len(recordings) > 1:
        from orchestrator.interface.cli._comparison import compare_runs

        return compare_runs(recordings, as_json)
    from orchestrator.interface.cli._diagnosis import compare

    return compare(recordings[0], model, effects, out, as_json)


@commands.command("diagnose", rich_help_panel=DIAGNOSE, epilog="Example: fluxbench diagnose runs/first")
def diagnose_command(
    recording: RecordingArgument,
    model: ModelOption = None,
    effects: EffectsOption = None,
    without: Annotated[
        list[str] | None, typer.Option(help="Exclude this effect from the library.", metavar="EFFECT")
    ] = None,
    material_flux: Annotated[
        float | None, typer.Option(min=0.0, help="Change of the map from which an effect is material, % of rated flux.")
    ] = None,
    material_voltage: Annotated[
        float | None, typer.Option(min=0.0, help="Voltage from which an effect is material, % of the excitation's rms.")
    ] = None,
    priors: Annotated[
        Path | None,
        typer.Option(help="Priors from a fleet of the same kind, a file of `fluxbench fleet priors`.", metavar="FILE"),
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> int:
    """Find the effects that the model lacks.

    With their probability, the effects that cannot be distinguished from them, and the next experiment. Ctrl-C ends
    the search and reports the result so far; a second Ctrl-C ends at once.
    """
    announce(recording, as_json)
    from orchestrator.interface.cli._diagnosis import diagnose

    return diagnose(recording, model, effects, without or [], (material_flux, material_voltage), out, as_json, priors)


@commands.command("explain", rich_help_panel=DIAGNOSE, epilog="Example: fluxbench explain runs/first")
def explain_command(
    run: DiagnosedArgument,
    steps: Annotated[bool, typer.Option("--steps", help="List every step of the search, with its gain.")] = False,
    as_json: JsonOption = False,
) -> int:
    """Explain a diagnosis.

    The reasons of the verdict, each number with its limit; how the search got there; the evidence for each effect.
    """
    from orchestrator.interface.cli._explaining import explain

    return explain(run, steps, as_json)


@commands.command("discover", rich_help_panel=DIAGNOSE, epilog="Example: fluxbench discover runs/first --write mine.py")
def discover_command(
    recording: RecordingArgument,
    write: Annotated[
        Path | None, typer.Option(help="Write the law to this file of effects.", metavar="FILE.py")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the effect; by default the file's.", metavar="NAME")] = None,
    effects: EffectsOption = None,
    without: Annotated[
        list[str] | None, typer.Option(help="Exclude this effect from the library.", metavar="EFFECT")
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> int:
    """Find the law that no effect of the library explains.

    Where something enters, what it depends on, and its shortest formula, tested on the stages that were held out. With
    --write, the law becomes an effect of your own: `add RECORDING NAME --effects FILE.py` adds it to the model.
    """
    announce(recording, as_json)
    from orchestrator.interface.cli._discovering import discover

    return discover(recording, write, name, effects, without or [], out, as_json)


@commands.command(
    "add", rich_help_panel=DIAGNOSE, epilog="Example: fluxbench add runs/first NAME, with a name of `fluxbench effects`"
)
def add_command(
    recording: RecordingArgument,
    effect: Annotated[
        list[str],
        typer.Argument(help="Names, separated by spaces or commas.", metavar="NAME..."),
    ],
    model: ModelOption = None,
    effects: EffectsOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> int:
    """Add effects to the model.

    Takes names of `fluxbench effects`. The model is fitted again, which rewrites model.json and the report, and a
    sentence says whether the held-out error falls. `fluxbench remove RECORDING NAME` takes an effect out again.
    """
    announce(recording, as_json)
    from orchestrator.interface.cli._diagnosis import add

    return add(recording, effect, model, effects, out, as_json)


@commands.command(
    "remove",
    rich_help_panel=DIAGNOSE,
    epilog="Example: fluxbench remove runs/first NAME, with a name that `add` or `diagnose` printed",
)
def remove_command(
    recording: RecordingArgument,
    effect: Annotated[str, typer.Argument(help="Name of an effect of the model.", metavar="NAME")],
    effects: EffectsOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> int:
    """Remove an effect from the model.

    The model is fitted again without it, which rewrites model.json and the report. `fluxbench add RECORDING NAME` puts
    it back.
    """
    announce(recording, as_json)
    from orchestrator.interface.cli._diagnosis import remove

    return remove(recording, effect, effects, out, as_json)
