"""`fluxbench mystery N`: a motor with hidden effects: measure, guess, reveal."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from orchestrator.formatting.names import parameter_words
from orchestrator.formatting.quantities import in_degrees, plural, quantity
from orchestrator.formatting.sentences import listed, shown, visible
from plugins.command_line import AsJson, Quiet, entry_point
from protocols import InputError

if TYPE_CHECKING:
    from orchestrator.diagnosis import KnownEffects
    from plugins.commands.mystery._guessing import Accepted, Effects, Grade, GuessedSize, Verdict
    from protocols import Procedure

HELP_GROUP = "Try and prove"
"""Its place in the list of commands."""


FORM_MEANING = (
    "* of the simulated motor's own formula. The library's formulas are written independently: of another curve the "
    "best value is another, and may lie outside the diagnosis' interval."
)
GRADES: Mapping[Grade, str] = {
    "close": "is right within 10 %",
    "too_small": "is too small, by less than half",
    "too_large": "is too large, by less than twice",
    "less_than_half": "is less than half of the true one",
    "more_than_double": "is more than twice the true one",
    "wrong_sign": "is of the wrong sign",
    "of_one_angle": "belongs to this angle alone, and is not graded",
}
"""Sentence on a guessed size; none tells the true one."""
TOO_SMALL = "hidden, but too small, or too similar to the others, for this recording; no name is missing for it"
BY_ALIGNMENT = "the run itself caused it, as its alignment left the rotor at an angle"
PERCENT: float = 100.0
"""Per cent of one."""
SAME_SIZE: float = 0.01
"""Relative difference of a hidden size and of the one that came of it, from which both are printed."""
WHOLE = "expected a whole number from 0 on"


def mystery(
    number: Annotated[int, typer.Argument(help="Number of the mystery; the same number gives the same motor.")],
    guess: Annotated[
        str | None,
        typer.Option(
            help="Names of effects, optionally NAME=800mV or NAME=30%, separated by commas; or: nothing. A number "
            "without a unit is in SI. What an earlier guess had right counts.",
            metavar="EFFECTS",
        ),
    ] = None,
    reveal: Annotated[bool, typer.Option("--reveal", help="Print the hidden effects.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="The run directory; by default runs/mystery-N.", metavar="FOLDER")
    ] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> int:
    """A motor with hidden effects nobody chose by hand: measure it, find them, guess, reveal."""
    from orchestrator.runs import is_run
    from plugins.commands.mystery._guessing import (
        caused_effects,
        earlier_guesses,
        judge,
        keep_guess,
        read_guess,
        sealed_effects,
    )

    if number < 0:
        raise InputError("NUMBER", str(number), WHOLE)
    if out is not None and not out.name:
        raise InputError("--out", "", "expected a separate folder")
    path = out if out is not None else Path("runs") / f"mystery-{number}"
    if is_run(path):
        _refuse_another(number, path)
    if guess is None and not reveal:
        return _measure(number, path, quiet, as_json)
    if not is_run(path):
        here = "not measured here" if out is None else "no mystery is there"
        where = ", below the folder in which you are; go to where you measured it, or" if out is None else ";"
        again = f"`fluxbench mystery {number}{'' if out is None else f' --out {path}'}` measures it"
        raise InputError(str(path), "", f"{here}{where} {again}")
    _refuse_unfinished(path)
    verdict = guesses_so_far = None
    if guess is not None:
        sealed, caused = sealed_effects(path), caused_effects(path)
        guesses, known = read_guess(guess), _known(path, {**sealed, **caused})
        verdict = judge(
            guesses,
            sealed,
            caused,
            lambda guessed, name: known.fits_as_well(name, guessed),
            known.shows,
            earlier_guesses(path).covered,
        )
        guesses_so_far = keep_guess(path, verdict)
    hidden = sealed_effects(path) if reveal else None
    if as_json:
        _print_json(path, verdict, guesses_so_far, hidden)
        return 0
    if verdict is not None and guesses_so_far is not None:
        _print_verdict(verdict)
        _print_line(_count(guesses_so_far))
    if hidden is not None:
        _print_hidden(hidden)
        for name, parameters in caused_effects(path).items():
            sizes = _sizes_in_words(name, parameters)
            if name not in hidden:
                _print_line(f"{name}: not hidden; {BY_ALIGNMENT}: {sizes}")
            elif any(
                abs(value - hidden[name].get(key, 0.0)) > SAME_SIZE * abs(value) for key, value in parameters.items()
            ):
                _print_line(f"{name}: with what the run itself caused, the recording has {sizes}")
    return 0


def command(arguments: Sequence[str]) -> int:
    """Entry point of the command."""
    negative = next((word for word in arguments if re.fullmatch(r"-\d+", word)), None)
    if negative is not None:  # otherwise it would be parsed as an option
        raise InputError("NUMBER", negative, WHOLE)
    return entry_point(mystery, "Example: fluxbench mystery 4")(arguments)


def _measure(number: int, path: Path, quiet: bool, as_json: bool) -> int:
    from orchestrator.runs import is_run

    if is_run(path):
        _refuse_unfinished(path)
    else:
        error = _run(number, path, quiet or as_json)
        if error is not None:
            print(shown(f"`fluxbench resume {path}` continues at the first unmeasured point"), file=sys.stderr)
            raise error
    if as_json:
        _print_json(path)
    elif not quiet:
        _print_line(f"{path} is a motor with something hidden in it, or nothing. How far the model without it is off:")
        _print_line(f"  fluxbench compare {path}")
        _print_line(f"The same in pictures, which name nothing, in {path / 'report.html'}:")
        _print_line(f"  fluxbench report {path}")
        _print_inseparable(path)
        _print_line("Guess, by the names that `fluxbench effects` lists:")
        usual = path == Path("runs") / f"mystery-{number}"
        _print_line(f"  fluxbench mystery {number} --guess NAME,NAME" + ("" if usual else f" --out {path}"))
        _print_line("Each guess is counted. A size may follow a name (NAME=800mV, NAME=30%, or a number in SI).")
        _print_line("See whether the error falls with your guess in the model; the report then shows before and after:")
        _print_line(f"  fluxbench add {path} NAME")
        _print_line("What the diagnosis finds, which gives most of it away; --reveal prints what is hidden:")
        _print_line(f"  fluxbench diagnose {path}")
    return 0


def _print_inseparable(path: Path) -> None:
    """What the recording lacks, and the effects that act alike without it, whatever is hidden."""
    from orchestrator.diagnosis import inseparable_groups
    from orchestrator.interface.api import chosen_effects
    from orchestrator.recording import open_recording

    groups = inseparable_groups(open_recording(path), chosen_effects())
    if groups:
        _print_line("What this recording lacks, and which effects act alike without it, whatever is hidden:")
    for lacking, names in groups.items():
        _print_line(f"  no {lacking.removeprefix('a ').removeprefix('the ')}: {listed(list(names))}")


def _refuse_another(number: int, path: Path) -> None:
    """Raise `InputError` where the run's name, motor or seed is not that of this mystery."""
    from orchestrator.runs import RunDirectory

    measured, expected = RunDirectory.open(path).record.procedure, procedure_of(number)
    if (measured.name, measured.seed, measured.motor) != (expected.name, expected.seed, expected.motor):
        raise InputError(str(path), "", f"this run is not mystery {number}: it has another motor or seed")


def _refuse_unfinished(path: Path) -> None:
    """Raise `InputError` where the run is not complete."""
    from orchestrator.runs import RunDirectory

    ended = RunDirectory.open(path).ended()
    if ended is None or ended.outcome != "finished":
        raise InputError(str(path), "", f"not measured to its end: run `fluxbench resume {path}` first")


def procedure_of(number: int) -> Procedure:
    """The procedure for a mystery's motor; only its sealed plant depends on the hidden effects."""
    from orchestrator.config import load_procedure
    from plugins.commands.mystery._drawing import draw
    from protocols import DriveChoice, ProcedureMotor

    bench = draw(number)
    return load_procedure(str(Path(__file__).with_name("campaign.yaml"))).model_copy(
        update={
            "motor": ProcedureMotor.model_validate(bench.motor),
            "limits": bench.limits,
            "drive": DriveChoice.model_validate({"name": "simulated", "plant": bench.plant}),
            "seed": bench.seed,
        }
    )


def _run(number: int, path: Path, quiet: bool) -> BaseException | None:
    """Run the drawn motor into a new directory; returns the error that ended it, if any."""
    from orchestrator.engine import AbsentOperator, RunServices, handling_signals, start_run

    with handling_signals() as interrupts:
        streams = {"console": {"mode": "quiet" if quiet else "auto"}, "report": {}, "rerun": {"view": "none"}}
        return start_run(procedure_of(number), path, RunServices(AbsentOperator(), interrupts, streams)).outcome.error


def _print_verdict(verdict: Verdict) -> None:
    sizes = {size.name: size for size in verdict.sizes}
    for name in verdict.right:
        size = sizes.get(name)
        suffix = f"; {_graded(size)}" if size else "; no size was given"
        _print_line(f"{name}: right{suffix}")
    for name in verdict.as_good:
        _print_line(f"{name}: as good: it fits this recording as well as what is hidden")
    for name in verdict.caused:
        suffix = f"; {_graded(sizes[name])}" if name in sizes else ""
        _print_line(f"{name}: present, but not one of the hidden: {BY_ALIGNMENT}{suffix}")
    for name in verdict.wrong:
        _print_line(f"{name}: not in this motor")
    for name in verdict.before:
        _print_line(f"{name}: right in an earlier guess")
    if len(verdict.wrong) > 1:
        count = len(verdict.right + verdict.as_good + verdict.caused + verdict.wrong)
        _print_line(f"{len(verdict.wrong)} of {count} names are wrong.")
    if verdict.too_small:
        _print_line(f"{verdict.too_small} more {'is' if verdict.too_small == 1 else 'are'} {TOO_SMALL}.")
    if verdict.complete:
        _print_line(_complete(verdict))
    elif verdict.still_hidden:
        is_part = bool(verdict.right or verdict.as_good or verdict.before or verdict.too_small)
        more = " more" if is_part else ""
        hidden = f"{verdict.still_hidden}{more} {'is' if verdict.still_hidden == 1 else 'are'} hidden."
        _print_line(hidden if is_part or verdict.wrong or verdict.caused else f"nothing: wrong; {hidden}")


def _count(so_far: Accepted) -> str:
    """How many guesses it took until now, and what was wrong in them."""
    wrong = plural(so_far.wrong_names, "wrong name") if so_far.wrong_names else "no wrong name"
    return f"Guess {so_far.guesses}; {wrong} so far."


def _complete(verdict: Verdict) -> str:
    is_shown = "that this recording shows" if verdict.too_small else "there is"
    if verdict.right or verdict.as_good or verdict.before:
        return f"That is all {is_shown}."
    return f"Right: {'this recording shows nothing more' if verdict.too_small else 'nothing is hidden in this motor'}."


def _graded(size: GuessedSize) -> str:
    return f"{_in_words(size.name, size.parameter, size.guessed)} {GRADES[size.grade]}{_in_percent(size)}"


def _in_percent(size: GuessedSize) -> str:
    """How to write per cent, where a size is about as wrong as one whose sign of it was left out; else empty."""
    ratio, unit = size.ratio or 0.0, _unit(size.name, size.parameter)
    if not PERCENT / 2.0 < ratio < 2.0 * PERCENT or not unit.startswith("1"):
        return ""
    return f"; a number alone is in SI, here {unit}: for per cent write {size.name}={size.guessed:g}%"


def _sizes_in_words(effect: str, parameters: Mapping[str, float]) -> str:
    return ", ".join(_in_words(effect, key, value) for key, value in parameters.items())


def _in_words(effect: str, parameter: str, value: float) -> str:
    """A parameter as the report prints it: ``bias a 52.1 mV``."""
    unit = _unit(effect, parameter)
    return f"{parameter_words(parameter)} {quantity(value, unit)}{in_degrees(value, unit)}"


def _unit(effect: str, parameter: str) -> str:
    from orchestrator.registry.plugins import PluginKind, load_plugin

    declared = load_plugin(PluginKind.EFFECTS, effect)().Parameters.declared()
    return next((one.unit for one in declared if one.name == parameter), "1")


def _known(path: Path, true: Effects) -> KnownEffects:
    """What the recording tells of the effects that are in it; nothing is computed yet."""
    from orchestrator.diagnosis import KnownEffects
    from orchestrator.interface.api import chosen_effects
    from orchestrator.recording import open_recording

    return KnownEffects(open_recording(path), true, chosen_effects())


def _print_hidden(hidden: Effects) -> None:
    from plugins.commands.mystery._guessing import form_parameters, with_usual_values

    if not hidden:
        _print_line("Nothing was hidden.")
    is_of_form = False
    for name, parameters in with_usual_values(hidden).items():
        of_form = form_parameters(name, parameters)
        is_of_form |= bool(of_form)
        words = [_in_words(name, key, value) + ("*" if key in of_form else "") for key, value in parameters.items()]
        _print_line(f"{name}: {', '.join(words)}")
    if is_of_form:
        _print_line(FORM_MEANING)


def _print_json(
    path: Path, verdict: Verdict | None = None, guesses: Accepted | None = None, hidden: Effects | None = None
) -> None:
    import json

    content: dict[str, Any] = {"run": str(path)}
    if verdict is not None:
        counted = {} if guesses is None else {"guesses": guesses.guesses, "wrong_names": guesses.wrong_names}
        content["guess"] = {**verdict.model_dump(mode="json"), "complete": verdict.complete, **counted}
    if hidden is not None:
        content["hidden"] = hidden
    print(visible(json.dumps(content, indent=2)))


def _print_line(line: str) -> None:
    print(shown(line))
