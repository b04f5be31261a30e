"""A campaign as a file: procedures by motors by what is hidden in them by seeds. Measures nothing."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from orchestrator._document import parse_document
from orchestrator._validation import first_problem
from orchestrator.api import as_overrides
from orchestrator.config import check_plan, load_procedure, make_plan
from orchestrator.engine import connected_drive
from orchestrator.fleet import Plan
from orchestrator.formatting.names import plain
from orchestrator.plain_files import read_text
from protocols import DriveChoice, InputError, Procedure, Strict
from protocols.fleet import FleetStep, HiddenEffect

Sizes = float | Annotated[tuple[float, ...], Field(min_length=1)]
Hidden = dict[str, dict[str, Sizes]]
"""Effects of the simulated plant with their parameters; where a parameter is a list, each of its values in turn."""


class CampaignPlan(Strict):
    """What is simulated, and what is done with each recording."""

    format: Literal["fluxbench-campaign"]
    version: Literal[1]
    name: str
    procedures: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of shipped ones, or YAML files beside this one."""
    motors: tuple[Path | None, ...] = (None,)
    """YAML files that are laid over each procedure; null is its own motor."""
    hidden: Annotated[tuple[Hidden, ...], Field(min_length=1)]
    """One entry a kind of plant; ``{}`` has nothing hidden."""
    seeds: Annotated[int, Field(ge=1, le=100_000)] = 1
    """So many runs of each, which differ in the sensors' noise."""
    first_seed: Annotated[int, Field(ge=0, le=2**31)] = 1
    settings: dict[str, Any] = Field(default_factory=dict)
    """Laid over each procedure, by key paths."""
    variants: Annotated[tuple[dict[str, Any], ...], Field(min_length=1)] = ({},)
    """More of these, an entry a kind of bench or motor; where a value is a list, each of its values in turn."""
    drive: dict[str, Any] = Field(default_factory=lambda: {"watchdog_s": 10.0})
    """Options of the simulated drive; there is nobody to be hurt, and a busy machine may be late."""
    plant: dict[str, Any] = Field(default_factory=dict)
    """Other options of its plant."""
    do: Annotated[tuple[FleetStep, ...], Field(min_length=1)] = ("diagnose",)
    found_with: Annotated[float, Field(gt=0, lt=1)] = 0.8
    """A size counts as found from this share of its runs on."""

    def runs(self) -> int:
        """How many there are."""
        kinds = sum(math.prod(len(_values(s)) for sizes in e.values() for s in sizes.values()) for e in self.hidden)
        benches = sum(math.prod(len(v) for v in e.values() if isinstance(v, list)) for e in self.variants)
        return len(self.procedures) * len(self.motors) * benches * kinds * self.seeds

    def analysis(self) -> Plan:
        """What is done with each recording."""
        return Plan(steps=self.do)


class Condition(Strict):
    """One run of a campaign."""

    procedure: str
    motor: str
    variant: str = ""
    """Its settings, in one line."""
    hidden: dict[str, dict[str, float]]
    seed: int

    @property
    def label(self) -> str:
        """In one line, without the seed: what its repetitions share."""
        effects = [f"{plain(name)} {_listed(sizes)}" for name, sizes in self.hidden.items()]
        variant = [self.variant] if self.variant else []
        return ", ".join([self.procedure, self.motor, *variant, *(effects or ["nothing hidden"])])

    def truths(self) -> tuple[HiddenEffect, ...]:
        """As the table has it."""
        return tuple(
            HiddenEffect(name=name, parameter=parameter, size=size)
            for name, sizes in self.hidden.items()
            for parameter, size in sizes.items()
        )


class Run(Strict):
    """A condition with the procedure that makes it."""

    condition: Condition
    procedure: Procedure

    def key(self, plan: Plan, version: str) -> str:
        """By what is run and what is asked of it; no two different ones have the same."""
        told = [self.procedure.model_dump(mode="json"), self.condition.model_dump(), plan.steps, version]
        return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:32]


def load_campaign(path: Path, most_runs: int = 1_000_000) -> CampaignPlan:
    """Read a campaign.

    Parameters
    ----------
    most_runs : int
        Of all combinations; a list too many multiplies them.

    Raises
    ------
    InputError
        File and line, key, what is wrong, the nearest valid name.
    """
    try:
        text = read_text(path)
    except UnicodeDecodeError as error:
        raise InputError(str(path), "", f"not UTF-8 at byte {error.start}") from None
    except OSError as error:
        raise InputError(str(path), "", f"cannot be read: {error.strerror or error}") from None
    document = parse_document(text, str(path))
    try:
        plan = CampaignPlan.model_validate(document.data)
    except ValidationError as error:
        problem = first_problem(error, CampaignPlan, document.data)
        raise InputError(document.place(problem.path), problem.field, problem.text) from None
    if plan.runs() > most_runs:
        raise InputError(str(path), "", f"{plan.runs()} runs are more than {most_runs}: shorten its lists")
    strange = [step for step in plan.do if step in ("import", "export")]
    if strange:
        raise InputError(document.place(("do",)), "do", f"expected estimate, compare or diagnose, got {strange[0]}")
    beside = path.parent
    return plan.model_copy(
        update={
            "procedures": tuple(str(beside / p) if (beside / p).is_file() else p for p in plan.procedures),
            "motors": tuple(None if motor is None else beside / motor for motor in plan.motors),
        }
    )


def runs_of(plan: CampaignPlan) -> Iterator[Run]:
    """Every run, the seeds in turn, so that one that is broken off is balanced.

    Raises
    ------
    InputError
        Where a procedure, a motor or what is laid over them cannot be used.
    """
    loaded = [
        (load_procedure(name, overrides=as_overrides(plan.settings | variant), motor=motor), name, motor, variant)
        for name in plan.procedures
        for motor in plan.motors
        for variant in _variants(plan.variants)
    ]
    for seed in range(plan.first_seed, plan.first_seed + plan.seeds):
        for (procedure, name, motor, variant), hidden in itertools.product(loaded, _swept(plan.hidden)):
            condition = Condition(
                procedure=Path(name).stem,
                motor=procedure.motor.name if motor is None else motor.stem,
                variant=" ".join(as_overrides(variant)),
                hidden=hidden,
                seed=seed,
            )
            yield Run(condition=condition, procedure=_with(procedure, plan, condition))


def check_runs(runs: Iterable[Run]) -> None:
    """Hold one run of each kind against its limits and its drive, before thousands of them are begun.

    Runs are of a kind where only sizes and seeds differ.

    Raises
    ------
    InputError
        Where what is hidden, or another option of the plant, is none that the drive has, or a plan exceeds its limits.
    """
    kinds: dict[tuple[object, ...], Run] = {}
    for run in runs:
        told = run.condition
        hidden = tuple((name, *sizes) for name, sizes in told.hidden.items())
        kinds.setdefault((told.procedure, told.motor, told.variant, hidden), run)
    for run in kinds.values():
        with connected_drive(run.procedure, private=None) as (_, capabilities):
            check_plan(make_plan(run.procedure, capabilities), capabilities)


def _variants(entries: tuple[dict[str, Any], ...]) -> list[dict[str, Any]]:
    columns = ([value if isinstance(value, list) else [value] for value in entry.values()] for entry in entries)
    return [
        dict(zip(entry, values, strict=True))
        for entry, choices in zip(entries, columns, strict=True)
        for values in itertools.product(*choices)
    ]


def _swept(entries: tuple[Hidden, ...]) -> list[dict[str, dict[str, float]]]:
    out = []
    for entry in entries:
        places = [(name, parameter) for name, sizes in entry.items() for parameter in sizes]
        columns = [_values(entry[name][parameter]) for name, parameter in places]
        for values in itertools.product(*columns):
            hidden: dict[str, dict[str, float]] = {name: {} for name in entry}
            for (name, parameter), value in zip(places, values, strict=True):
                hidden[name][parameter] = value
            out.append(hidden)
    return out


def _values(sizes: Sizes) -> tuple[float, ...]:
    return sizes if isinstance(sizes, tuple) else (sizes,)


def _with(procedure: Procedure, plan: CampaignPlan, condition: Condition) -> Procedure:
    options, own = procedure.drive.options, procedure.drive.options.get("plant", {})
    if not isinstance(own, dict):
        raise InputError(procedure.name, "drive.plant", "expected keys and values")
    plant = {**own, **plan.plant, "effects": condition.hidden}
    chosen = {"name": procedure.drive.name, **options, **plan.drive, "plant": plant}
    try:
        drive = DriveChoice.model_validate(chosen)
    except ValidationError as error:
        problem = first_problem(error, DriveChoice, chosen)
        raise InputError(plan.name, f"drive.{problem.field}", problem.text) from None
    return procedure.model_copy(update={"drive": drive, "seed": condition.seed})


def _listed(sizes: dict[str, float]) -> str:
    return " ".join(f"{name}={size:g}" for name, size in sizes.items())
