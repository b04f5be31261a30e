"""The estimator kit passes an estimator that keeps the contract, and fails each one that breaks it in one way."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from orchestrator.testing import EstimatorConformance
from protocols import (
    Capture,
    DriveRecord,
    Estimate,
    EstimationContext,
    Estimator,
    FluxMap,
    FluxMapEstimate,
    FluxPoints,
    Manifest,
    MapChecks,
    Motor,
    NotMeasuredError,
    RecordingReader,
    Remark,
    ResistanceEstimate,
    ResistanceReading,
    Segment,
    SegmentStage,
)
from tests.orchestrator.testing.kit_runner import failures

FS = 1000.0
ANGLE_RAD = 0.3
POINTS = ((1.0, 0.0), (2.0, 0.0), (0.0, 1.5), (-1.0, 0.5))


class InMemory:
    """Direct-current holds of a 4 ohm motor, and a reading with the gates off."""

    def __init__(self) -> None:
        rng = np.random.default_rng(3)
        turn = np.array([[np.cos(ANGLE_RAD), -np.sin(ANGLE_RAD)], [np.sin(ANGLE_RAD), np.cos(ANGLE_RAD)]])
        self.captures: dict[str, Capture] = {}
        segments = []
        for k, point in enumerate([(0.0, 0.0), *POINTS]):
            stage = SegmentStage.RESISTANCE if k else SegmentStage.GATES_OFF
            segment = Segment(
                id=f"{stage.value}-{k:03d}", stage=stage, start_s=2.0 * k, samples=500, rotor_angle_rad=ANGLE_RAD
            )
            i_ab = np.tile(turn @ point, (500, 1))
            self.captures[segment.id] = Capture(
                start_s=segment.start_s,
                sampling_frequency_hz=FS,
                i_ab=i_ab + rng.normal(0.0, 4e-3, i_ab.shape),
                v_ab=4.0 * i_ab,
                v_dc=np.full(500, 540.0),
            )
            segments.append(segment)
        self.manifest = Manifest(
            format="fluxbench-recording",
            version=1,
            name="in memory",
            created="2026-01-01T00:00:00Z",
            motor=Motor(name="4 ohm", pole_pairs=2),
            drive=DriveRecord(name="none", sampling_frequency_hz=FS, dc_bus_voltage_v=540.0),
            segments=tuple(segments),
        )

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        return [s for s in self.manifest.segments if not stages or s.stage in stages]

    def load(self, segment: Segment) -> Capture:
        return self.captures[segment.id]


class ExampleEstimator:
    """R_s as the ratio of mean voltage and mean current."""

    name: ClassVar[str] = "example"
    summary: ClassVar[str] = "Ratio of voltage and current at standstill."
    requires: ClassVar[tuple[type[Estimate], ...]] = ()
    produces: ClassVar[type[Estimate]] = ResistanceEstimate
    rank: ClassVar[int] = 0

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
        segments = recording.segments(SegmentStage.RESISTANCE)
        if not segments:
            raise NotMeasuredError(recording.manifest.name, "segments", "no direct-current holds")
        return self.summed_up([self.reading(s, recording.load(s)) for s in segments])

    def reading(self, segment: Segment, capture: Capture) -> ResistanceReading:
        v, i = capture.v_ab.mean(axis=0), capture.i_ab.mean(axis=0)
        std = float(np.hypot(*capture.i_ab.std(axis=0)) / np.hypot(*i) ** 2 / np.sqrt(len(capture)))
        return ResistanceReading(start_s=segment.start_s, value_ohm=float(v @ i / (i @ i)), std_ohm=4.0 * std)

    def summed_up(self, readings: list[ResistanceReading]) -> Estimate:
        values = [r.value_ohm for r in readings]
        value, half = float(np.mean(values)), 2.0 * float(np.mean([r.std_ohm for r in readings]))
        return ResistanceEstimate(
            value_ohm=value,
            low=value - half,
            high=value + half,
            first_ohm=values[0],
            last_ohm=values[-1],
            readings=tuple(readings),
        )


def kit_for(estimator: type) -> EstimatorConformance:
    recording = InMemory()

    class Kit(EstimatorConformance):
        registered = False

        def make_estimator(self) -> Estimator:
            made: Estimator = estimator()
            return made

        def recording(self) -> RecordingReader:
            return recording

    return Kit()


def test_passes_an_estimator_that_keeps_the_contract(tmp_path: Path) -> None:
    assert failures(kit_for(ExampleEstimator), tmp_path) == {}


class ExampleMap:
    """A map of constant inductances, L = 40 mH, with an honest shape."""

    name: ClassVar[str] = "example_map"
    summary: ClassVar[str] = "Constant inductances."
    requires: ClassVar[tuple[type[Estimate], ...]] = ()
    produces: ClassVar[type[Estimate]] = FluxMapEstimate
    rank: ClassVar[int] = 0
    changed: ClassVar[dict[str, Any]] = {}

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
        if not recording.segments(SegmentStage.RESISTANCE):
            raise NotMeasuredError(recording.manifest.name, "segments", "no direct-current holds")
        axis = np.array([-1.0, 0.0, 1.0])
        i_d, i_q = np.meshgrid(axis, axis, indexing="ij")
        known = np.hypot(i_d, i_q) < 1.2
        values = {"psi_d": 0.04 * i_d, "psi_q": 0.04 * i_q, "l_dd": 0.04, "l_dq": 0.0, "l_qq": 0.04}
        grids = {name: np.where(known, value, np.nan) for name, value in values.items()}
        stds = {f"{name}_std": np.where(known, 1e-4, np.nan) for name in values}
        return FluxMapEstimate(
            map=FluxMap(method="example", **({"i_d": axis, "i_q": axis} | grids | stds | self.changed)),
            points=FluxPoints(i_dq=np.ones((1, 2)), psi_dq=np.ones((1, 2)), segment=("resistance-001",)),
            checks=MapChecks(),
        )


def test_passes_a_map_that_is_known_in_part(tmp_path: Path) -> None:
    assert failures(kit_for(ExampleMap), tmp_path) == {}


class AxisFallsMap(ExampleMap):
    changed: ClassVar[dict[str, Any]] = {"i_d": np.array([1.0, 0.0, -1.0])}


class NegativeStdMap(ExampleMap):
    changed: ClassVar[dict[str, Any]] = {"l_dq_std": np.full((3, 3), -1e-4)}


class NoStdMap(ExampleMap):
    changed: ClassVar[dict[str, Any]] = {"psi_q_std": np.full((3, 3), np.nan)}


class NothingKnownMap(ExampleMap):
    changed: ClassVar[dict[str, Any]] = {"l_qq": np.full((3, 3), np.nan)}


class SaysMapGivesResistance(ExampleEstimator):
    produces = FluxMapEstimate


class ProducesSomethingElse(ExampleEstimator):
    produces = float  # type: ignore[assignment]


class RequiresAName(ExampleEstimator):
    requires = ("classical",)  # type: ignore[assignment]


class TalksInSentences(ExampleEstimator):
    def summed_up(self, readings: list[ResistanceReading]) -> Estimate:
        remark = Remark(code="R_s drifts!", text="R_s drifts!")
        return super().summed_up(readings).model_copy(update={"remarks": (remark,)})


class NoSummary(ExampleEstimator):
    summary = " "


class NeedsArguments(ExampleEstimator):
    def __init__(self, bandwidth_hz: float | None = None) -> None:
        if bandwidth_hz is None:
            raise TypeError("bandwidth_hz is missing")


class Throws(ExampleEstimator):
    """Different each time."""

    dice = itertools.count()

    def summed_up(self, readings: list[ResistanceReading]) -> Estimate:
        more = 1.0 + 1e-9 * next(self.dice)
        return super().summed_up([r.model_copy(update={"value_ohm": r.value_ohm * more}) for r in readings])


class RemovesTheMeanInPlace(ExampleEstimator):
    def reading(self, segment: Segment, capture: Capture) -> ResistanceReading:
        found = super().reading(segment, capture)
        capture.i_ab[...] -= capture.i_ab.mean(axis=0)
        return found


class DiesOfAnEmptyRecording(ExampleEstimator):
    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
        readings = [self.reading(s, recording.load(s)) for s in recording.segments(SegmentStage.RESISTANCE)]
        return self.summed_up([readings[0], *readings[1:]])


class MakesSomethingOfNothing(ExampleEstimator):
    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
        if not recording.segments(SegmentStage.RESISTANCE):
            return self.summed_up([ResistanceReading(start_s=0.0, value_ohm=4.0, std_ohm=0.1)])
        return super().estimate(recording, context)


class IgnoresTheRotorAngle(ExampleEstimator):
    """Takes the alpha current for the whole: right only where the vector lies on alpha."""

    def reading(self, segment: Segment, capture: Capture) -> ResistanceReading:
        v, i = capture.v_ab.mean(axis=0), capture.i_ab.mean(axis=0)
        ratio = float(np.hypot(*v)) / abs(float(i[0]))
        return super().reading(segment, capture).model_copy(update={"value_ohm": ratio})


class OutsideItsInterval(ExampleEstimator):
    def summed_up(self, readings: list[ResistanceReading]) -> Estimate:
        return super().summed_up(readings).model_copy(update={"low": 4.5})


class NegativeStd(ExampleEstimator):
    def reading(self, segment: Segment, capture: Capture) -> ResistanceReading:
        return super().reading(segment, capture).model_copy(update={"std_ohm": -0.1})


class BackwardsInTime(ExampleEstimator):
    def summed_up(self, readings: list[ResistanceReading]) -> Estimate:
        return super().summed_up(readings[::-1])


MUTATIONS: list[tuple[type, str]] = [
    (SaysMapGivesResistance, "says_it_produces"),
    (ProducesSomethingElse, "says_it_produces"),
    (RequiresAName, "requirements"),
    (TalksInSentences, "remarks"),
    (NoSummary, "class_keeps_the_contract"),
    (Throws, "same_recording"),
    (RemovesTheMeanInPlace, "not_modified"),
    (DiesOfAnEmptyRecording, "not_measured"),
    (MakesSomethingOfNothing, "not_measured"),
    (IgnoresTheRotorAngle, "turning_the_stator_frame"),
    (OutsideItsInterval, "uncertainties"),
    (NegativeStd, "uncertainties"),
    (BackwardsInTime, "uncertainties"),
    (AxisFallsMap, "uncertainties"),
    (NegativeStdMap, "uncertainties"),
    (NoStdMap, "uncertainties"),
    (NothingKnownMap, "uncertainties"),
]


@pytest.mark.parametrize(("estimator", "check"), MUTATIONS, ids=[f"{e.__name__}-{c}" for e, c in MUTATIONS])
def test_fails_an_estimator_that_breaks_the_contract(tmp_path: Path, estimator: type, check: str) -> None:
    assert failures(kit_for(estimator), tmp_path, only=check), f"{estimator.__name__} passes {check}"


def test_fails_an_estimator_that_cannot_be_made_without_arguments(tmp_path: Path) -> None:
    kit = kit_for(lambda: NeedsArguments(bandwidth_hz=1.0))  # type: ignore[arg-type]
    assert failures(kit, tmp_path, only="class_keeps_the_contract")
