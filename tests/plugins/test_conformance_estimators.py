"""The built-in estimators under the kit that third parties use, on the reduced recording of a foreign plant."""

from __future__ import annotations

from abc import abstractmethod
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import pytest

from orchestrator.recording import open_recording
from orchestrator.testing import EstimatorConformance
from orchestrator.testing._recordings import digest
from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.energy import EnergyEstimator
from plugins.estimators.injection import InjectionEstimator
from plugins.estimators.resistance import ResistanceEstimator
from plugins.estimators.steps import StepResistanceEstimator, StepsEstimator
from protocols import Estimate, EstimationContext, Estimator, RecordingReader
from tests.blind.hidden import draw_case
from tests.blind.stepping import Steps, record_steps
from tests.orchestrator.analysis.campaign import MemoryRecording

REDUCED = Path(__file__).parents[1] / "data" / "pm400-reduced"


class Measured(NamedTuple):
    """A recording in memory, and its digest when no estimator had it yet."""

    recording: RecordingReader
    digest: str


@cache
def reduced() -> Measured:
    return in_memory(open_recording(REDUCED))


@cache
def context() -> EstimationContext:
    return EstimationContext((ResistanceEstimator().estimate(reduced().recording, EstimationContext()),))


@cache
def stepped() -> Measured:
    bench = draw_case("clean", 1, 7).bench
    top = bench.machine.top_a
    with TemporaryDirectory() as folder:
        path = record_steps(bench, [Steps((130.0, 108.0), (top, 0.7 * top), 0.02)] * 2, Path(folder) / "steps")
        return in_memory(open_recording(path))


def in_memory(read: RecordingReader) -> Measured:
    """The same, read once."""
    recording = MemoryRecording(read.manifest, {s.id: read.load(s) for s in read.segments()})
    return Measured(recording, digest(recording))


class BuiltInConformance(EstimatorConformance):
    """The kit, on a recording that is shared; every kernel is compiled anew for read-only arrays: that is slow."""

    @abstractmethod
    def measured(self) -> Measured:
        """The recording."""

    def recording(self) -> RecordingReader:
        return self.measured().recording

    def test_recording_is_what_it_was_when_it_was_read(self, estimate: Estimate) -> None:
        assert digest(self.recording()) == self.measured().digest

    @pytest.mark.slow
    def test_recording_is_not_modified(self) -> None:
        super().test_recording_is_not_modified()


class TestResistance(BuiltInConformance):
    def make_estimator(self) -> Estimator:
        return ResistanceEstimator()

    def measured(self) -> Measured:
        return reduced()


class TestClassical(TestResistance):
    def make_estimator(self) -> Estimator:
        return ClassicalEstimator()

    def context(self) -> EstimationContext:
        return context()


class TestInjection(TestClassical):
    def make_estimator(self) -> Estimator:
        return InjectionEstimator()


class TestEnergy(TestResistance):
    def make_estimator(self) -> Estimator:
        return EnergyEstimator()


class TestSteps(BuiltInConformance):
    def make_estimator(self) -> Estimator:
        return StepsEstimator()

    def measured(self) -> Measured:
        return stepped()


class TestStepResistance(TestSteps):
    def make_estimator(self) -> Estimator:
        return StepResistanceEstimator()

    def context(self) -> EstimationContext:
        return EstimationContext()
