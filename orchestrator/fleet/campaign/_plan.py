"""A campaign's file: procedures by motors by hidden effects by seeds."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from orchestrator.config import check_plan, load_procedure, make_plan
from orchestrator.engine import connected_drive
from orchestrator.fleet import Plan
from orchestrator.formatting.names import plain
from orchestrator.interface.api import as_overrides
from orchestrator.validation.messages import first_problem
from orchestrator.validation.strict_yaml import read_document
from protocols import DriveChoice, InputError, Procedure, Strict
from protocols.fleet import FleetStep, HiddenEffect

Sizes = float | Annotated[tuple[float, ...], Field(min_length=1)]
Hidden = dict[str, dict[str, Sizes]]
"""Effects of the simulated plant with their parameters; a list gives several values, used in turn."""


class CampaignPlan(Strict):
    """The simulations, and the steps for each recording."""

    format: Literal["fluxbench-campaign"]
    version: Literal[1]
    name: str
    procedures: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of shipped procedures, or YAML files beside this one."""
    motors: tuple[Path | None, ...] = (None,)
    """YAML files of motors for each procedure; null is its own motor."""
    hidden: Annotated[tuple[Hidden, ...], Field(min_length=1)]
    """One entry per kind of plant; ``{}`` has no hidden effect."""
    seeds: Annotated[int, Field(ge=1, le=100_000)] = 1
    """Number of runs of each, which differ in the sensors' noise."""
    first_seed: Annotated[int, Field(ge=0, le=2**31)] = 1
    settings: dict[str, Any] = Field(default_factory=dict)
    """Settings that replace the procedures', by key paths."""
    variants: Annotated[tuple[dict[str, Any], ...], Field(min_length=1)] = ({},)
    """More settings, one entry per kind of bench or motor; a list gives several values, used in turn."""
    drive: dict[str, Any] = Field(default_factory=lambda: {"watchdog_s": 10.0})
    """Options of the simulated drive; its watchdog may be long, because a busy machine may be late."""
    plant: dict[str, Any] = Field(default_factory=dict)
    """Further options of its plant."""
    do: Annotated[tuple[FleetStep, ...], Field(min_length=1)] = ("diagnose",)
    found_with: Annotated[float, Field(gt=0, lt=1)] = 0.8
    """Share of its runs from which a size counts as found."""

    def runs(self) -> int:
        """Number of runs."""
        effects = sum(math.prod(len(_values(s)) for sizes in e.values() for s in sizes.values()) for e in self.hidden)
        variants = sum(math.prod(len(v) for v in e.values() if isinstance(v, list)) for e in self.variants)
        return len(self.procedures) * len(self.motors) * variants * effects * self.seeds

    def analysis(self) -> Plan:
        """The steps for each recording."""
        return Plan(steps=self.do)


class Condition(Strict):
    """One run of a campaign."""

    procedure: str
    motor: str
    variant: str = ""
    """The variant's settings, in one line."""
    hidden: dict[str, dict[str, float]]
    seed: int

    @property
    def label(self) -> str:
        """The condition in one line without the seed, common to its repetitions."""
        effects = [f"{plain(name)} {_listed(sizes)}" for name, sizes in self.hidden.items()]
        variant = [self.variant] if self.variant else []
        return ", ".join([self.procedure, self.motor, *variant, *(effects or ["nothing hidden"])])

    def truths(self) -> tuple[HiddenEffect, ...]:
        """The hidden effects in the table's form."""
        return tuple(
            HiddenEffect(name=name, parameter=parameter, size=size)
            for name, sizes in self.hidden.items()
            for parameter, size in sizes.items()
        )


class Run(Strict):
    """A condition with its procedure."""

    condition: Condition
    procedure: Procedure

    def key(self, plan: Plan, version: str) -> str:
        """Hash of the run and its analysis; different runs have different keys."""
        content = [self.procedure.model_dump(mode="json"), self.condition.model_dump(), plan.steps, version]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def load_campaign(path: Path, max_runs: int = 1_000_000) -> CampaignPlan:
    """Read a campaign.

    Parameters
    ----------
    max_runs : int
        Limit of all combinations, because each list multiplies them.

    Raises
    ------
    InputError
        With file and line, key, the error and the nearest valid name.
    """
    document = read_document(path)
    try:
        plan = CampaignPlan.model_validate(document.data)
    except ValidationError as error:
        problem = first_problem(error, CampaignPlan, document.data)
        raise InputError(document.place(problem.path), problem.field, problem.text) from None
    if plan.runs() > max_runs:
        raise InputError(str(path), "", f"{plan.runs()} runs are more than {max_runs}: shorten its lists")
    unusable = [step for step in plan.do if step in ("import", "export")]
    if unusable:
        raise InputError(document.place(("do",)), "do", f"expected estimate, compare or diagnose, got {unusable[0]}")
    folder = path.parent
    return plan.model_copy(
        update={
            "procedures": tuple(str(folder / p) if (folder / p).is_file() else p for p in plan.procedures),
            "motors": tuple(None if motor is None else folder / motor for motor in plan.motors),
        }
    )


def runs_of(plan: CampaignPlan) -> Iterator[Run]:
    """Every run, seed by seed, so that an interrupted campaign is balanced.

    Raises
    ------
    InputError
        Where a procedure, a motor or a setting cannot be used.
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
    """Check one run of each kind against its limits and its drive, before thousands of them begin.

    Runs of one kind differ in sizes and seeds alone.

    Raises
    ------
    InputError
        Where the drive lacks a hidden effect or another option of the plant, or a plan exceeds its limits.
    """
    kinds: dict[tuple[object, ...], Run] = {}
    for run in runs:
        c = run.condition
        hidden = tuple((name, *sizes) for name, sizes in c.hidden.items())
        kinds.setdefault((c.procedure, c.motor, c.variant, hidden), run)
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
