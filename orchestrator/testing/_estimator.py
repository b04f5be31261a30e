"""The estimator's conformance kit. Whether an estimate is right is a question for the plugin's own tests."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
import pytest

from orchestrator.registry.plugins import PLUGIN_NAME
from orchestrator.testing._faults import faults_as_failures
from orchestrator.testing._kit import Kit, bounded
from orchestrator.testing._recordings import Disguised, Empty, digest, read_only, turned
from protocols import (
    Estimate,
    EstimationContext,
    Estimator,
    FluxMapEstimate,
    NotMeasuredError,
    RealArray,
    RecordingReader,
    ResistanceEstimate,
)

FRAME_TURN_RAD = math.pi / 3.0
"""Sixty degrees permute the phases and their signs: a model of the bridge in phase currents stays the same."""
MAP_VALUES = ("psi_d", "psi_q", "l_dd", "l_dq", "l_qq")


class EstimatorConformance(Kit, ABC):
    """Checks that an estimator plugin keeps the contract of `protocols.Estimator`.

    Subclass it in a test file, in a class whose name begins with ``Test``, and give two methods:

    - ``make_estimator()`` returns the estimator;
    - ``recording()`` returns a recording that holds all it needs (a small one: it is read some ten times).

    Where it needs another estimator's result, override ``context()``.
    """

    frame_tolerance: ClassVar[float] = 1e-3
    """Change of a value when the stator frame is turned, relative to the largest of its kind; at most 0.01."""

    @abstractmethod
    def make_estimator(self) -> Estimator:
        """A new estimator."""

    @abstractmethod
    def recording(self) -> RecordingReader:
        """A recording with all that the estimator needs."""

    def context(self) -> EstimationContext:
        """Results of earlier estimators of the same pass."""
        return EstimationContext()

    def _estimate(self, recording: RecordingReader) -> Estimate:
        with faults_as_failures(self.max_seconds):  # a fixture calls it too, before any check
            return self.make_estimator().estimate(recording, self.context())

    @pytest.fixture(scope="class")
    @classmethod
    def estimate(cls) -> Estimate:
        """One estimate of the recording as it is, for all checks that only look at it."""
        kit = cls()
        return kit._estimate(kit.recording())

    def test_entry_point_leads_to_the_estimator(self) -> None:
        self.require_entry_point("fluxbench.estimators", type(self.make_estimator()))

    def test_class_keeps_the_contract(self) -> None:
        estimator = self.make_estimator()
        assert isinstance(estimator, Estimator), "methods or attributes of protocols.Estimator are missing"
        assert estimator.summary.strip(), "summary is empty"
        assert isinstance(type(estimator)(), type(estimator)), "the class must be made without arguments"

    def test_returns_what_it_says_it_produces(self, estimate: Estimate) -> None:
        produces = self.make_estimator().produces
        assert _is_estimate(produces), f"produces is {produces!r}; expected ResistanceEstimate or FluxMapEstimate"
        assert isinstance(estimate, produces), f"produces {produces.__name__}, but returned {type(estimate).__name__}"

    def test_requirements_are_kinds_of_estimate(self) -> None:
        estimator = self.make_estimator()
        for kind in estimator.requires:
            assert _is_estimate(kind), f"requires {kind!r}; expected ResistanceEstimate, FluxMapEstimate or a sub-class"

    def test_remarks_have_codes_of_their_own(self, estimate: Estimate) -> None:
        for remark in estimate.remarks:
            assert PLUGIN_NAME.match(remark.code), f"the code {remark.code!r} is not in snake_case: {remark.text}"

    def test_same_recording_gives_the_same_estimate(self, estimate: Estimate) -> None:
        first, second = _numbers(estimate), _numbers(self._estimate(self.recording()))
        assert first.keys() == second.keys(), "a second pass over the same recording has other fields"
        for name in first:
            assert np.array_equal(first[name], second[name], equal_nan=True), f"{name} differs in a second pass"

    def test_recording_is_not_modified(self) -> None:
        recording = self.recording()
        before = digest(recording)
        self._estimate(Disguised(recording, read_only))
        assert digest(recording) == before, "the recording is not what it was before the estimate"

    def test_recording_without_its_stages_is_not_measured(self) -> None:
        with pytest.raises(NotMeasuredError) as refusal:
            self._estimate(Empty(self.recording().manifest))
        assert "\n" not in str(refusal.value).strip(), "the error is not one line"

    def test_uncertainties_are_finite_and_not_negative(self, estimate: Estimate) -> None:
        if isinstance(estimate, ResistanceEstimate):
            _require_honest_resistance(estimate)
        else:
            _require_honest_map(estimate)

    def test_turning_the_stator_frame_changes_nothing(self, estimate: Estimate) -> None:
        straight = _numbers(estimate)
        askew = _numbers(self._estimate(turned(self.recording(), FRAME_TURN_RAD)))
        assert straight.keys() == askew.keys()
        for name in straight:
            allowed = bounded("frame_tolerance", self.frame_tolerance, 0.01) * (50.0 if "std" in name else 1.0)
            _require_close(name, straight[name], askew[name], allowed)


def _is_estimate(kind: object) -> bool:
    return isinstance(kind, type) and issubclass(kind, ResistanceEstimate | FluxMapEstimate)


def _numbers(estimate: Estimate) -> dict[str, RealArray]:
    """All numbers of an estimate under their names."""
    if isinstance(estimate, ResistanceEstimate):
        readings = {
            "start_s of the readings": np.array([r.start_s for r in estimate.readings]),
            "value_ohm of the readings": np.array([r.value_ohm for r in estimate.readings]),
            "std_ohm of the readings": np.array([r.std_ohm for r in estimate.readings]),
        }
        values = {name: np.array([getattr(estimate, name)]) for name in ("value_ohm", "first_ohm", "last_ohm")}
        widths = np.array([estimate.value_ohm - estimate.low, estimate.high - estimate.value_ohm])
        return {**values, **readings, "interval about value_ohm (std)": widths}
    grids = {name: np.asarray(getattr(estimate.map, name)) for name in ("i_d", "i_q", *MAP_VALUES)}
    stds = {f"{name}_std": np.asarray(getattr(estimate.map, f"{name}_std")) for name in MAP_VALUES}
    return {**grids, **stds, "points i_dq": estimate.points.i_dq, "points psi_dq": estimate.points.psi_dq}


def _require_close(name: str, a: RealArray, b: RealArray, allowed: float) -> None:
    assert a.shape == b.shape, f"{name} has shape {b.shape} instead of {a.shape} in the turned frame"
    both = np.isfinite(a) & np.isfinite(b)
    assert both.sum() >= 0.95 * max(np.isfinite(a).sum(), np.isfinite(b).sum()), f"{name} is known elsewhere"
    if not both.any():
        return
    apart = float(np.abs(a[both] - b[both]).max())
    scale = float(np.abs(a[both]).max())
    assert apart <= allowed * scale, f"{name} changes by {apart:.3g} of {scale:.3g} when the stator frame is turned"


def _require_honest_resistance(estimate: ResistanceEstimate) -> None:
    interval = f"{estimate.low} .. {estimate.value_ohm} .. {estimate.high}"
    assert all(map(math.isfinite, (estimate.low, estimate.value_ohm, estimate.high))), f"not finite: {interval}"
    assert estimate.low <= estimate.value_ohm <= estimate.high, f"the value is outside its interval: {interval}"
    assert estimate.readings, "no readings"
    for reading in estimate.readings:
        assert math.isfinite(reading.std_ohm), f"std_ohm = {reading.std_ohm}"
        assert reading.std_ohm >= 0.0, f"std_ohm = {reading.std_ohm}"
    starts = [reading.start_s for reading in estimate.readings]
    assert starts == sorted(starts), "readings are not in order of time"


def _require_honest_map(estimate: FluxMapEstimate) -> None:
    grid = estimate.map
    for axis in ("i_d", "i_q"):
        assert (np.diff(getattr(grid, axis)) > 0).all(), f"{axis} does not increase"
    for name in MAP_VALUES:
        value, std = getattr(grid, name), getattr(grid, f"{name}_std")
        known = np.isfinite(value)
        assert known.any(), f"{name} is NaN everywhere"
        assert np.isfinite(std[known]).all(), f"{name}_std is not finite where {name} is"
        assert (std[known] >= 0.0).all(), f"{name}_std is negative"
    assert np.isfinite(estimate.points.i_dq).all(), "a point's current is not finite"
    assert np.isfinite(estimate.points.psi_dq).all(), "a point's flux is not finite"
