"""The built-in estimators under the kit that third parties use, on the reduced recording of a foreign plant."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from orchestrator.recording import open_recording
from orchestrator.testing import EstimatorConformance
from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.energy import EnergyEstimator
from plugins.estimators.injection import InjectionEstimator
from plugins.estimators.resistance import ResistanceEstimator
from plugins.estimators.steps import StepResistanceEstimator, StepsEstimator
from protocols import EstimationContext, Estimator, RecordingReader
from tests.blind.hidden import draw_case
from tests.blind.stepping import Steps, record_steps
from tests.orchestrator.analysis.campaign import MemoryRecording

REDUCED = Path(__file__).parents[1] / "data" / "pm400-reduced"


@cache
def recording() -> RecordingReader:
    return in_memory(open_recording(REDUCED))


@cache
def context() -> EstimationContext:
    return EstimationContext((ResistanceEstimator().estimate(recording(), EstimationContext()),))


@cache
def stepped() -> RecordingReader:
    bench = draw_case("clean", 1, 7).bench
    top = bench.machine.top_a
    with TemporaryDirectory() as folder:
        path = record_steps(bench, [Steps((130.0, 108.0), (top, 0.7 * top), 0.02)] * 2, Path(folder) / "steps")
        return in_memory(open_recording(path))


def in_memory(read: RecordingReader) -> RecordingReader:
    """The same, read once."""
    return MemoryRecording(read.manifest, {s.id: read.load(s) for s in read.segments()})


class TestResistance(EstimatorConformance):
    def make_estimator(self) -> Estimator:
        return ResistanceEstimator()

    def recording(self) -> RecordingReader:
        return recording()


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


class TestSteps(EstimatorConformance):
    def make_estimator(self) -> Estimator:
        return StepsEstimator()

    def recording(self) -> RecordingReader:
        return stepped()


class TestStepResistance(TestSteps):
    def make_estimator(self) -> Estimator:
        return StepResistanceEstimator()

    def context(self) -> EstimationContext:
        return EstimationContext()
