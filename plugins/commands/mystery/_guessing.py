"""Compares a guess with the sealed answer: correct names, and ratios of sizes."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from orchestrator.formatting.names import parameter_words
from orchestrator.formatting.quantities import unit_words
from orchestrator.formatting.sentences import listed
from orchestrator.recording import read_json, write_json
from orchestrator.registry.plugins import PluginKind, installed, load_plugin
from orchestrator.runs import RunDirectory, private_directory
from orchestrator.validation.quantities import value_in
from plugins.commands.mystery._drawing import HOW_MANY, MIN_ANGLE_RAD
from protocols import Contrast, InputError, ParameterRole, Strict

NOTHING = "nothing"
ACCEPTED_NAME = "accepted.json"
CLOSE: float = 0.1
"""Relative difference up to which a guessed size is right."""
MAX_GUESSES: int = max(HOW_MANY) + 1
"""Names in one guess: those that may be hidden, and one that the run itself may cause."""
_POWER = re.compile("·10([⁻⁰¹²³⁴-⁹]+)")
_DIGITS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_KEYS = {ord("−"): "-"}
Effects = Mapping[str, Mapping[str, float]]


class Guess(Strict):
    """A guessed effect, optionally with a size."""

    name: str
    size: float | None = None


Grade = Literal["close", "too_small", "too_large", "less_than_half", "more_than_double", "wrong_sign", "of_one_angle"]
"""How a guessed size stands to the true one; ``of_one_angle`` is not graded, as the true ones are of a whole turn."""


class GuessedSize(Strict):
    """A guessed size and how it stands to the true one, which it does not tell."""

    name: str
    parameter: str
    guessed: float
    grade: Grade
    ratio: float | None = Field(exclude=True, repr=False)
    """Guessed over true, never shown; None where that is not graded."""


class Verdict(Strict):
    """Result of a guess, without revealing other effects."""

    right: tuple[str, ...]
    as_good: tuple[str, ...]
    """Not hidden, but each fits the recording as well in the place of a hidden one; these count as right."""
    caused: tuple[str, ...]
    """In the recording, but not hidden: the run itself caused them."""
    wrong: tuple[str, ...]
    still_hidden: int
    """Hidden effects that the recording shows and the guess lacks."""
    too_small: int = 0
    """Hidden effects that the guess lacks and the recording does not show beside the others."""
    sizes: tuple[GuessedSize, ...]
    before: tuple[str, ...] = ()
    """Names that earlier guesses had right and this one lacks; they count."""
    covered: dict[str, str] = Field(default_factory=dict, exclude=True, repr=False)
    """Each hidden effect that this guess names, or names an equal of, and that name. Never shown."""

    @property
    def complete(self) -> bool:
        """Whether every name is right and none is missing."""
        return not self.wrong and not self.still_hidden


def read_guess(words: str) -> tuple[Guess, ...]:
    """Parse guesses such as `dead_time,hysteresis=0.03`, or `dead time`; `nothing` gives an empty tuple.

    Raises
    ------
    InputError
        For an unknown effect, a repeated name, a size that is neither a number nor a quantity, or more than
        `MAX_GUESSES` names.
    """
    if words.strip() == NOTHING:
        return ()
    names = [info.name for info in installed(PluginKind.EFFECTS)]
    guesses: dict[str, Guess] = {}
    if NOTHING in (part.partition("=")[0].strip() for part in words.split(",")):
        raise InputError("--guess", NOTHING, "cannot be combined: give it alone, or the names of the effects found")
    for word in filter(None, (part.strip() for part in words.split(","))):
        name, equals, size = (part.strip() for part in word.partition("="))
        name = name.replace(" ", "_")
        if name not in names:
            near = difflib.get_close_matches(name, names, 1)
            hint = f"did you mean {near[0]}?" if near else f"expected {NOTHING} or one of {', '.join(names)}"
            raise InputError("--guess", name, f"there is no effect of that name; {hint}")
        if name in guesses:
            raise InputError("--guess", name, "given twice")
        guesses[name] = Guess(name=name, size=_number(name, size) if equals else None)
    if not guesses:
        raise InputError("--guess", "", f"empty; give {NOTHING} if you found none")
    if len(guesses) > MAX_GUESSES:
        what = f"so many names are no guess: at most {max(HOW_MANY)} effects are hidden, and the run may cause one more"
        raise InputError("--guess", f"{len(guesses)} names", what)
    return tuple(guesses.values())


def sealed_effects(run: Path) -> Effects:
    """The hidden effects and their parameters, from the private directory beside a run.

    Raises
    ------
    RecordingError
        Where there is no run, or its private directory is missing.
    """
    plant: Mapping[str, Any] = RunDirectory.open(run).procedure().drive.options["plant"]
    hidden = {name: parameters for name, parameters in plant.get("effects", {}).items() if parameters is not None}
    return {name: {k: float(v) for k, v in parameters.items() if v is not None} for name, parameters in hidden.items()}


def with_usual_values(hidden: Effects) -> Effects:
    """The hidden effects with the plant's usual values of what was not drawn, as far as a model has it.

    Where the plant derives a value from the motor, it is not among them.
    """
    from plugins.drives.simulated.effects import Effects as PlantEffects

    whole = PlantEffects.model_validate(hidden).model_dump(exclude_none=True)
    return {
        name: {k: v for k, v in whole[name].items() if k in hidden[name] or (v and k in _roles(name))}
        for name in hidden
    }


def form_parameters(name: str, parameters: Iterable[str]) -> list[str]:
    """Those parameters that describe an effect's form rather than its size."""
    roles = _roles(name)
    return [one for one in parameters if roles.get(one) is ParameterRole.SHAPE]


def _roles(name: str) -> dict[str, ParameterRole]:
    return {p.name: p.role for p in load_plugin(PluginKind.EFFECTS, name)().Parameters.declared()}


def caused_effects(run: Path) -> Effects:
    """Effects that the run itself caused: the rotor's rest angle, where it is large enough."""
    from plugins.drives.simulated import misalignment

    angle = misalignment(private_directory(run.resolve()))
    if angle is None or abs(angle) < MIN_ANGLE_RAD:
        return {}
    return {"rotor_misalignment": {"angle_rad": angle}}


class Accepted(Strict):
    """The guesses at a mystery so far, a file beside its truth."""

    format: Literal["fluxbench-accepted-guesses"] = "fluxbench-accepted-guesses"
    version: Literal[1] = 1
    covered: dict[str, str] = Field(default_factory=dict)
    """By the hidden effect: the name that was accepted for it."""
    guesses: int = 0
    wrong_names: int = 0


def earlier_guesses(run: Path) -> Accepted:
    """What earlier guesses had right, and their count.

    Raises
    ------
    RecordingError
        Where the file of them is damaged.
    """
    path = private_directory(run.resolve()) / ACCEPTED_NAME
    return read_json(path, Accepted) if path.is_file() else Accepted()


def keep_guess(run: Path, verdict: Verdict) -> Accepted:
    """Count a guess, and keep what it had right, so that the next one need not repeat it; raises `StorageError`."""
    before = earlier_guesses(run)
    kept = Accepted(
        covered={**before.covered, **verdict.covered},
        guesses=before.guesses + 1,
        wrong_names=before.wrong_names + len(verdict.wrong),
    )
    write_json(private_directory(run.resolve()) / ACCEPTED_NAME, kept)
    return kept


def judge(
    guesses: Iterable[Guess],
    hidden: Effects,
    extra: Effects | None = None,
    fits_as_well: Callable[[str, str], bool] = lambda guessed, hidden: False,
    shows: Callable[[str], bool] = lambda hidden: True,
    before: Mapping[str, str] | None = None,
) -> Verdict:
    """Compare guesses with the hidden effects.

    Parameters
    ----------
    extra : mapping, optional
        Effects that the run itself caused (`caused_effects`): not wrong where they are guessed, and not missing where
        they are not.
    fits_as_well : callable
        Whether a guessed effect in a hidden one's place fits the recording as well, by their names.
    shows : callable
        Whether the recording shows a hidden effect beside the others, by its name.
    before : mapping, optional
        What earlier guesses had right (`earlier_guesses`): not missing where names are guessed.
    """
    guesses = tuple(guesses)
    true = {**hidden, **(extra or {})}
    right = tuple(guess.name for guess in guesses if guess.name in hidden)
    covered = {name: name for name in right}
    missing = [name for name in hidden if name not in right]
    as_good = []
    for guess in guesses:
        twin = next((one for one in missing if guess.name not in true and fits_as_well(guess.name, one)), None)
        if twin is not None:
            missing.remove(twin)
            as_good.append(guess.name)
            covered[twin] = guess.name
    known = {name: guessed for name, guessed in (before or {}).items() if guesses and name in missing}
    missing = [name for name in missing if name not in known]
    shown = [name for name in missing if shows(name)]
    sizes = (_size(guess, true[guess.name]) for guess in guesses if guess.name in true)
    return Verdict(
        right=right,
        as_good=tuple(as_good),
        caused=tuple(guess.name for guess in guesses if guess.name in true and guess.name not in hidden),
        wrong=tuple(guess.name for guess in guesses if guess.name not in (*true, *as_good)),
        still_hidden=len(shown),
        too_small=len(missing) - len(shown),
        sizes=tuple(size for size in sizes if size is not None),
        before=tuple(dict.fromkeys(known.values())),
        covered=covered,
    )


def _size(guess: Guess, true: Mapping[str, float]) -> GuessedSize | None:
    """Size of a guess, by the first parameter or the larger one of two phases; None where none was given."""
    if guess.size is None:
        return None
    parameter = max(_of_phases(true), key=lambda name: abs(true[name]), default=next(iter(true)))
    is_graded = bool(true[parameter]) and not _is_of_one_angle(guess.name, true)
    ratio = guess.size / true[parameter] if is_graded else None
    return GuessedSize(name=guess.name, parameter=parameter, guessed=guess.size, grade=_grade(ratio), ratio=ratio)


def _grade(ratio: float | None) -> Grade:
    if ratio is None:
        return "of_one_angle"
    if ratio <= 0.0:
        return "wrong_sign"
    if abs(ratio - 1.0) <= CLOSE:
        return "close"
    if ratio < 1.0:
        return "less_than_half" if ratio < 0.5 else "too_small"
    return "more_than_double" if ratio > 2.0 else "too_large"


def _is_of_one_angle(name: str, true: Mapping[str, float]) -> bool:
    """Whether an effect has amplitudes that only a second rotor angle would show, beside those that were hidden."""
    effect = load_plugin(PluginKind.EFFECTS, name)()
    amplitudes = [p.name for p in effect.Parameters.declared() if p.role is ParameterRole.AMPLITUDE]
    return Contrast.SECOND_ANGLE in effect.needs and any(amplitude not in true for amplitude in amplitudes)


def _of_phases(names: Iterable[str]) -> list[str]:
    """Parameters that there is one of for each phase."""
    return [name for name in names if name.startswith(("offset_", "bias_", "extra_a_", "extra_b_"))]


def _as_typed(text: str, unit: str) -> str:
    """A quantity as it is printed, such as ``−0.26 % per W``, in the characters of a keyboard: ``-0.26 %``."""
    plain = text.translate(_KEYS).removesuffix(unit_words(unit) if unit.startswith("1/") else "")
    return _POWER.sub(lambda power: f"e{power[1].translate(_DIGITS)}", plain).strip()


def _number(name: str, text: str) -> float:
    declared = load_plugin(PluginKind.EFFECTS, name)().Parameters.declared()
    first = declared[0]
    value = value_in(_as_typed(text, first.unit), first.unit)
    if not math.isfinite(value):
        sizes = [parameter_words(one) for one in _of_phases(parameter.name for parameter in declared)]
        size = f"the larger one of {listed(sizes)}" if len(sizes) > 1 else f"its {parameter_words(first.name)}"
        text = f"{text!r} is not a size; expected {size} in {first.unit}"
        raise InputError("--guess", name, f"{text}, for example {name}={first.typical:g}")
    return value
