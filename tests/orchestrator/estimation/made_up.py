"""Estimators that are made up: what they hand out is known, and none has a built-in one's name."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from orchestrator.estimation import model_check
from protocols import (
    AxisPercent,
    Basis,
    DriveRecord,
    Estimate,
    EstimationContext,
    FluxMap,
    FluxMapEstimate,
    FluxPoints,
    IncrementalInductances,
    Manifest,
    MapChecks,
    MapCriteria,
    Motor,
    NotMeasuredError,
    RecordingReader,
    Remark,
    ResistanceEstimate,
    ResistanceReading,
    UsabilityCheck,
)
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.orchestrator.analysis.test_checks import exact_map

RECORDING = MemoryRecording(
    Manifest(
        format="fluxbench-recording",
        version=1,
        name="made up",
        created="2026-01-01",
        motor=Motor(name="m", pole_pairs=2, rated_current_rms_a=1.66),
        drive=DriveRecord(name="d", sampling_frequency_hz=1e4, dc_bus_voltage_v=540.0),
        segments=(),
    ),
    {},
)
R_S = ResistanceEstimate(
    value_ohm=4.0,
    low=3.9,
    high=4.1,
    first_ohm=4.0,
    last_ohm=4.2,
    readings=(
        ResistanceReading(start_s=1.0, value_ohm=4.0, std_ohm=0.01),
        ResistanceReading(start_s=9.0, value_ohm=4.2, std_ohm=0.01),
    ),
)


def explained(recording: RecordingReader, flux_map: FluxMap, criteria: MapCriteria) -> UsabilityCheck:
    """The check of a map whose recording a model explains."""
    return model_check(0.1, 0.1, criteria, verdict="clean", effects="")


SOUND = MapChecks(
    crossings=AxisPercent(d_percent=0.2, q_percent=0.3),
    parity=AxisPercent(d_percent=0.1, q_percent=0.1),
    reciprocity_percent=0.5,
)


class Resistance:
    """Hands out `R_S`."""

    name: ClassVar[str] = "resistance"
    summary: ClassVar[str] = "made up"
    requires: ClassVar[tuple[type[Estimate], ...]] = ()
    produces: ClassVar[type[Estimate]] = ResistanceEstimate
    rank: ClassVar[int] = 0

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
        return R_S


class Mapper:
    """Hands out the exact map, its flux scaled by a factor, with these checks."""

    name: ClassVar[str] = ""
    summary: ClassVar[str] = "made up"
    requires: ClassVar[tuple[type[Estimate], ...]] = (ResistanceEstimate,)
    produces: ClassVar[type[Estimate]] = FluxMapEstimate
    rank: ClassVar[int] = 0
    basis: ClassVar[Basis | None] = None

    def __init__(
        self,
        name: str = "",
        checks: MapChecks | None = None,
        missing: bool = False,
        factor: float = 1.0,
        incremental: tuple[IncrementalInductances, ...] = (),
    ) -> None:
        self.name = name or type(self).name  # type: ignore[misc]
        self.checks, self.missing, self.factor = checks or SOUND, missing, factor
        self.incremental = incremental
        self.saw: EstimationContext | None = None

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
        self.saw = context
        if self.missing:
            raise NotMeasuredError("made up", "segments", f"no {self.name} here")
        points = FluxPoints(i_dq=np.zeros((1, 2)), psi_dq=np.zeros((1, 2)), segment=("a",))
        exact = exact_map(self.name)
        scaled = {"psi_d": 0.3 + self.factor * (exact.psi_d - 0.3), "psi_q": self.factor * exact.psi_q}
        made = exact.model_copy(update={**scaled, "basis": self.basis})
        stated = (Remark(code="noted", text="a note"),)
        fields = {"checks": self.checks, "remarks": stated, "incremental": self.incremental}
        return type(self).produces(map=made, points=points, **fields)


class Swept(FluxMapEstimate):
    """A map by integration, as a kind of its own."""


class Injected(FluxMapEstimate):
    """A map by injection, as a kind of its own."""


class Sweeps(Mapper):
    name: ClassVar[str] = "sweeps"
    produces: ClassVar[type[Estimate]] = Swept
    rank: ClassVar[int] = 10
    basis: ClassVar[Basis | None] = Basis.INTEGRATION


class Ripples(Mapper):
    name: ClassVar[str] = "ripples"
    requires: ClassVar[tuple[type[Estimate], ...]] = (Swept,)
    produces: ClassVar[type[Estimate]] = Injected
    rank: ClassVar[int] = 20
    basis: ClassVar[Basis | None] = Basis.INJECTION


class OneEnergy(Mapper):
    name: ClassVar[str] = "one_energy"
    requires: ClassVar[tuple[type[Estimate], ...]] = (Swept, Injected)
    rank: ClassVar[int] = 30
    basis: ClassVar[Basis | None] = Basis.ENERGY
