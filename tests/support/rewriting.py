"""Recordings rewritten in memory, as another logger would have written them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from protocols import Capture, Manifest, RecordingReader, Segment, SegmentStage

Array = NDArray[np.floating[Any]]
Rows = Callable[[int, np.random.Generator], NDArray[np.int64]]
Field = Literal["i_ab", "v_ab"]
CLARKE = np.array([[2.0, -1.0, -1.0], [0.0, np.sqrt(3.0), -np.sqrt(3.0)]]) / 3.0
TO_PHASES = np.array([[1.0, 0.0], [-0.5, np.sqrt(0.75)], [-0.5, -np.sqrt(0.75)]])


@dataclass(frozen=True)
class Rewritten:
    """A `RecordingReader` over captures in memory, each method another one with a difference."""

    manifest: Manifest
    captures: dict[str, Capture]

    @classmethod
    def of(cls, recording: RecordingReader) -> Rewritten:
        return cls(recording.manifest, {s.id: recording.load(s) for s in recording.segments()})

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        return [s for s in self.manifest.segments if not stages or s.stage in stages]

    def load(self, segment: Segment) -> Capture:
        return self.captures[segment.id]

    def captured(self, change: Callable[[Capture], dict[str, Any]]) -> Rewritten:
        """Other waveforms, of as many rows as they then have."""
        captures = {name: c.model_copy(update=change(c)) for name, c in self.captures.items()}
        segments = (s.model_copy(update={"samples": len(captures[s.id]), "sha256": None}) for s in self.segments())
        return Rewritten(self.manifest.model_copy(update={"segments": tuple(segments)}), captures)

    def mapped(self, field: Field, matrix: Array) -> Rewritten:
        """(alpha, beta) times a matrix."""
        return self.captured(lambda c: {field: (getattr(c, field) @ matrix.T).astype(np.float32)})

    def phases(self, field: Field, matrix: Array, sensors: str = "abc") -> Rewritten:
        """The phases times a matrix; of two sensors, the third phase is minus what they read."""
        return self.mapped(field, CLARKE @ _completed(sensors) @ matrix @ TO_PHASES)

    def driven(self, **change: Any) -> Rewritten:
        """Another drive in the manifest, in its captures too."""
        drive = self.manifest.drive.model_copy(update=change)
        rate = {"sampling_frequency_hz": drive.sampling_frequency_hz}
        captures = {name: c.model_copy(update=rate) for name, c in self.captures.items()}
        return Rewritten(self.manifest.model_copy(update={"drive": drive}), captures)

    def plated(self, **change: Any) -> Rewritten:
        """Another nameplate."""
        motor = self.manifest.motor.model_copy(update=change)
        return Rewritten(self.manifest.model_copy(update={"motor": motor}), self.captures)

    def with_segments(self, change: Callable[[Segment], dict[str, Any]]) -> Rewritten:
        """Other segments in the manifest."""
        segments = tuple(s.model_copy(update=change(s)) for s in self.manifest.segments)
        return Rewritten(self.manifest.model_copy(update={"segments": segments}), self.captures)

    def without_settings(self, *names: str) -> Rewritten:
        return self.with_segments(lambda s: {"settings": {k: v for k, v in s.settings.items() if k not in names}})

    def late(self, rows: int) -> Rewritten:
        """The voltage's column so many rows further down."""
        return self.captured(lambda c: {"v_ab": c.v_ab[np.clip(np.arange(len(c)) - rows, 0, len(c) - 1)]})

    def rows(self, which: Rows) -> Rewritten:
        """Other rows: those that `which` gives of so many."""
        rng = np.random.default_rng(1)

        def change(c: Capture) -> dict[str, Any]:
            rows = which(len(c), rng)
            return {name: getattr(c, name)[rows] for name in ("i_ab", "v_ab", "v_dc")}

        return self.captured(change)


def _completed(sensors: str) -> Array:
    """Readings of all phases from those of some."""
    there = np.array([float(name in sensors) for name in "abc"])
    return np.diag(there) - np.outer(1.0 - there, there)


def exchanged(first: str, second: str) -> Array:
    """The permutation of two phases."""
    order = ["abc".index(x) for x in "abc".translate(str.maketrans(first + second, second + first))]
    return np.eye(3)[order]


def gain(phase: str, factor: float) -> Array:
    """One phase times a factor."""
    return np.diag([factor if name == phase else 1.0 for name in "abc"])
