"""The built-in estimators under the kit that third parties use, on the reduced recording of a foreign plant."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from orchestrator.recording import open_recording
from orchestrator.testing import EstimatorConformance
from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.energy import EnergyEstimator
from plugins.estimators.injection import InjectionEstimator
from plugins.estimators.resistance import ResistanceEstimator
from protocols import EstimationContext, Estimator, RecordingReader

REDUCED = Path(__file__).parents[1] / "data" / "pm400-reduced"


@cache
def recording() -> RecordingReader:
    return open_recording(REDUCED)


@cache
def context() -> EstimationContext:
    return EstimationContext((ResistanceEstimator().estimate(recording(), EstimationContext()),))


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
