"""A sample of a recording's segments as complex vectors, with their set-points.

Vectors of the stator's plane are complex numbers here, alpha + j beta: a gain, a turn and an exchange of phases are
then all of the form i -> a i + b conj(i).

An effect of the catalogue moves a gain by some percent and a delay by half a sample; conventions are off by a third,
an axis or a whole sample. The limits of all checks lie between, nearer to the conventions: a false alarm costs more
than a missed one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from protocols import Manifest, RecordingReader, Segment, SegmentStage

Vectors = NDArray[np.complex128]

MAX_SAMPLES_PER_STAGE = 240_000
"""Samples of each kind of stage that are read."""
MAX_SAMPLES_PER_SEGMENT = 20_000
"""Samples of one segment that are read."""
MIN_SEGMENTS = 6
"""Segments of each kind of stage that are read in any case."""
MIN_SAMPLES = 100
"""Samples below which a segment is too short for any check."""
MAX_MATCH_ERROR = 0.04
"""Relative error of vectors within which readings agree with their set-points."""
MIN_MISMATCH_ERROR = 0.15
"""Relative error beyond which they disagree: no catalogued effect moves a controlled current so far."""
MIN_CURRENT_FRACTION = 0.3
"""Share of the largest current below which offsets may exceed the current."""
MIN_EDGE_FRACTION = 0.3
"""Step of a voltage, relative to the largest, that is one of an injected square's edges, or half of one."""
MAX_CONDITION_NUMBER = 1e3
"""Condition number up to which a least-squares fit separates its columns; ten samples per square wave have fifty."""


@dataclass(frozen=True)
class SegmentReadings:
    """The readings of one segment.

    Attributes
    ----------
    segment : Segment
    i, v : complex arrays, shape (n,)
        Current and commanded voltage, stator frame [A, V].
    phases : array, shape (n, 3), or None
        The phase currents' own columns [A].
    v_dc : array, shape (n,)
        Bus voltage [V].
    """

    segment: Segment
    i: Vectors
    v: Vectors
    phases: NDArray[np.floating[Any]] | None
    v_dc: NDArray[np.floating[Any]]

    @property
    def theta_rad(self) -> float:
        """The manifest's electrical rotor angle."""
        return float(self.segment.rotor_angle_rad)

    def setting(self, name: str) -> float | None:
        """A number of the segment's settings; None where there is none."""
        value = self.segment.settings.get(name)
        is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        return float(value) if is_number and value is not None else None

    @cached_property
    def mean_i(self) -> complex:
        """Mean current of the second half, where transients have settled."""
        return complex(self.i[len(self.i) // 2 :].mean())

    @cached_property
    def mean_v(self) -> complex:
        """Mean voltage of the second half."""
        return complex(self.v[len(self.v) // 2 :].mean())

    @cached_property
    def ripple_v(self) -> Vectors:
        """Voltage without its mean."""
        return np.asarray(self.v - self.v.mean())

    @property
    def set_point(self) -> complex | None:
        """The current's set-point in the stator's frame, by the manifest's angle; None where unknown."""
        prefix = "target" if self.segment.stage is SegmentStage.INJECTION else "current"
        d, q = (self.setting(f"{prefix}_{axis}_a") for axis in "dq")
        return None if d is None or q is None else complex(d, q) * np.exp(1j * self.theta_rad)


@dataclass(frozen=True)
class Survey:
    """The segments that were read, in order of time."""

    manifest: Manifest
    seen: Sequence[SegmentReadings]

    def of(self, *stages: SegmentStage) -> list[SegmentReadings]:
        return [s for s in self.seen if s.segment.stage in stages]

    @property
    def holds(self) -> list[SegmentReadings]:
        return self.of(SegmentStage.RESISTANCE)

    @property
    def injections(self) -> list[SegmentReadings]:
        return self.of(SegmentStage.INJECTION)

    @property
    def sampling_frequency_hz(self) -> float:
        return self.manifest.drive.sampling_frequency_hz

    @cached_property
    def max_current_a(self) -> float:
        """The largest mean current of a segment."""
        return max((abs(s.mean_i) for s in self.seen), default=0.0)


def survey(recording: RecordingReader, poll: Callable[[], None] = lambda: None) -> Survey:
    """Holds, sweeps, injections and steps, evenly spread over the recording, with a bounded number of samples.

    Raises
    ------
    RecordingError
        Where a capture is not what the manifest says.
    """
    chosen: list[Segment] = []
    for stage in (SegmentStage.RESISTANCE, SegmentStage.CLASSICAL, SegmentStage.INJECTION, SegmentStage.STEPS):
        segments = [s for s in recording.segments(stage) if s.samples >= MIN_SAMPLES]
        most = MAX_SAMPLES_PER_STAGE / (np.mean([s.samples for s in segments]) if segments else 1.0)
        few = max(min(len(segments), round(most)), min(len(segments), MIN_SEGMENTS))
        chosen += [segments[round(k)] for k in np.linspace(0, len(segments) - 1, few)]
    chosen.sort(key=lambda s: s.start_s)
    seen = []
    for segment in chosen:
        poll()
        capture, rows = recording.load(segment), slice(0, MAX_SAMPLES_PER_SEGMENT)
        i, v = (_complex(x[rows]) for x in (capture.i_ab, capture.v_ab))
        phases = None if capture.i_abc is None else capture.i_abc[rows]
        seen.append(SegmentReadings(segment, i, v, phases, capture.v_dc[rows]))
    return Survey(recording.manifest, seen)


def _complex(x: NDArray[np.floating[Any]]) -> Vectors:
    return np.ascontiguousarray(x, dtype=np.float64).view(np.complex128).ravel()


def parts(z: Vectors) -> Array:
    """(alpha, beta) of complex vectors, shape (n, 2)."""
    return np.ascontiguousarray(z).view(np.float64).reshape(-1, 2)
