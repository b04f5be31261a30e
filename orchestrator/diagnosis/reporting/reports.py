"""What comparison and diagnosis print: the JSON contracts as pydantic models; every number is finite or null."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from protocols import Strict


def _finite(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


Number = Annotated[float | None, BeforeValidator(_finite)]
"""Finite, or null."""

Verdict = Literal["clean", "explained", "mostly_explained", "unknown_remains"]
ShapeGroup = Literal[
    "odd_phase_current",
    "even_phase_current",
    "constant",
    "anisotropic_resistance",
    "time_resistance",
    "power_voltage",
    "sweep_direction",
    "ripple_in_phase",
    "ripple_edges",
    "map_not_even",
    "reciprocity_broken",
    "map_detail",
    "periodic",
    "other",
]


class NoiseFloor(Strict):
    """What the residual would be if only the sensors' noise were left."""

    rms_v: Number


class ParameterValue(Strict):
    """A fitted parameter with its 95 % interval."""

    value: Number
    low: Number
    high: Number
    unit: str


class FoundEffect(Strict):
    """An effect that the data ask for."""

    name: str
    parameters: dict[str, ParameterValue]
    twins: tuple[str, ...]
    """Effects that do as well in its place, in this recording."""
    relative_size: Number
    """|first parameter| over its typical value (inverted where small is strong)."""
    log_evidence: Number


class JointEntry(Strict):
    """One effect in the joint fit of the whole library."""

    name: str
    relative_size: Number
    z: Number


class Rung(Strict):
    """The error after one more effect."""

    added: str | None
    chi2: Number
    """Per degree of freedom of the whitened training residual."""
    rms_v: Number
    heldout_rms_v: Number
    current_rms_a: Number


class ShapeShare(Strict):
    """How much of the leftover has one shape."""

    group: ShapeGroup
    share: Number


class Unexplained(Strict):
    """What is left."""

    fraction: Number
    """sqrt((chi2_after - 1) / (chi2_before - 1))."""
    shape: tuple[ShapeShare, ...]


class NextExperiment(Strict):
    """What to measure to tell two effects apart, as a procedure's stage."""

    stage: dict[str, Any]
    separates: tuple[str, str]
    minutes: Number


class DiagnosisReport(Strict):
    """`fluxbench diagnose --json`."""

    recording: str
    noise_floor: NoiseFloor
    verdict: Verdict
    effects: tuple[FoundEffect, ...]
    """In the order in which they were added."""
    traces: tuple[str, ...]
    joint: tuple[JointEntry, ...]
    ladder: tuple[Rung, ...]
    unexplained: Unexplained
    next_experiment: NextExperiment | None
    notes: tuple[str, ...]
    seconds: Number


class StageError(Strict):
    """The residual in one kind of stage."""

    stage: str
    rms_v: Number
    chi2: Number
    current_rms_a: Number


class WorstSegment(Strict):
    """A segment that the model fits badly, with its mean current."""

    segment: str
    i_d_a: Number
    i_q_a: Number
    rms_v: Number


class PercentPair(Strict):
    """A check's figure on each axis, in per cent of the rated flux."""

    d_percent: Number
    q_percent: Number


class CompareReport(Strict):
    """`fluxbench compare --json`."""

    recording: str
    model: str
    noise_floor: NoiseFloor
    chi2: Number
    stages: tuple[StageError, ...]
    worst: tuple[WorstSegment, ...]
    parity: PercentPair
    reciprocity_percent: Number
    crossings: PercentPair
    notes: tuple[str, ...]


class AddReport(Strict):
    """`fluxbench add --json`, and `remove`."""

    effects: tuple[FoundEffect, ...]
    ladder: tuple[Rung, ...]
    unexplained: Unexplained
    notes: tuple[str, ...]


class Words(Strict):
    """The diagnosis in words, one slot a question."""

    where_it_fails: str
    what_it_looks_like: str
    likely_cause: str
    if_added: str
    to_decide: str
