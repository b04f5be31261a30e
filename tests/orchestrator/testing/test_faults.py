"""What a wrong plugin does to the kits: whatever it is, the fault is named in a line, and the kit comes to an end."""

from __future__ import annotations

import re
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.testing._faults import faults_as_failures
from protocols import Correction, EstimationContext, RecordingReader, Signals
from tests.orchestrator.testing import test_drive_kit as drives
from tests.orchestrator.testing import test_effect_kit as effects
from tests.orchestrator.testing import test_estimator_kit as estimators
from tests.orchestrator.testing.example_drive import ExampleDrive
from tests.orchestrator.testing.kit_runner import failures


class Raising(effects.ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        nothing: dict[str, Correction] = {}
        return nothing["gone\nand more"]


class NotANumber(effects.ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        return Correction(v_ab=signals.v_ab * np.nan)


class WrongShape(effects.ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        return Correction(v_ab=signals.v_ab[:-1] - [p.bias_a_v, 0.0])


class Mutating(effects.ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        signals.v_ab[:] -= [p.bias_a_v, 0.0]
        return Correction(v_ab=signals.v_ab)


class Hanging(effects.ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        while True:
            time.sleep(0.01)


@pytest.mark.parametrize(
    ("effect", "check", "named"),
    [
        (Raising, "input_is_not_modified", r"raised KeyError: 'gone\\nand more' \(.*test_faults.py, line \d+\)$"),
        (NotANumber, "finite_signals", "not finite at low of bias_a_v"),
        (WrongShape, "shape_of_the_signals", r"v_ab has shape \(\d+, 2\) instead of \(\d+, 2\)$"),
        (Mutating, "input_is_not_modified", r"raised ValueError: .*read-only \(.*test_faults.py, line \d+\)$"),
        (Hanging, "typical_values_show", r"not returned within 0.2 s \(.*test_faults.py, line \d+\)$"),
    ],
)
def test_a_wrong_effect_is_named_in_a_line(effect: Any, check: str, named: str, tmp_path: Path) -> None:
    kit = effects.kit_for(effect)
    type(kit).max_seconds = 0.2 if effect is Hanging else 60.0
    (message,) = failures(kit, tmp_path, only=check).values()
    require_line(message, named)


def require_line(message: str, named: str) -> None:
    first = message.splitlines()[0]
    assert re.search(named, first), message


class RaisingEstimator(estimators.ExampleEstimator):
    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Any:
        return np.zeros(3) @ np.zeros(4)


class HangingEstimator(estimators.ExampleEstimator):
    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Any:
        while True:
            time.sleep(0.01)


@pytest.mark.parametrize(
    ("estimator", "named"),
    [
        (RaisingEstimator, r"raised ValueError: .* \(.*test_faults.py, line \d+\)$"),
        (HangingEstimator, r"not returned within 0.2 s \(.*test_faults.py, line \d+\)$"),
    ],
)
def test_a_wrong_estimator_is_named_in_a_line(estimator: Any, named: str, tmp_path: Path) -> None:
    kit = estimators.kit_for(estimator)
    type(kit).max_seconds = 0.2 if estimator is HangingEstimator else 60.0
    for check in ("uncertainties_are_finite", "same_recording"):
        (message,) = failures(kit, tmp_path / check, only=check).values()
        require_line(message, named)


class NeverStops(ExampleDrive):
    def disarm(self) -> None:
        while True:
            time.sleep(0.01)


def test_a_drive_that_never_stops_is_named_in_a_line(tmp_path: Path) -> None:
    kit = drives.kit_for(NeverStops)
    type(kit).max_seconds = 0.2
    messages = failures(kit, tmp_path, only="disarm")
    assert messages
    for message in messages.values():
        require_line(message, r"not returned within 0.2 s \(.*test_faults.py, line \d+\)$")


def test_a_limit_around_a_kit_s_check_stays() -> None:
    signal.setitimer(signal.ITIMER_REAL, 200.0)
    try:
        with faults_as_failures(5.0):
            assert signal.getitimer(signal.ITIMER_REAL)[0] <= 5.0
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 100.0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
