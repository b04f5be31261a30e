"""A part of a recording as plain vectors, with what was asked for beside them. Judges nothing.

Vectors of the stator's plane are complex numbers here, alpha + j beta: a gain, a turn and an exchange of phases are
then all of the form i -> a i + b conj(i).
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
from orchestrator.recording_checks.criteria import ConventionCriteria
from protocols import Manifest, RecordingReader, Segment, SegmentStage

Vectors = NDArray[np.complex128]


@dataclass(frozen=True)
class Sighting:
    """One segment.

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
        """The angle that the operator believes in."""
        return float(self.segment.rotor_angle_rad)

    def asked(self, name: str) -> float | None:
        """A number of the settings; None where there is none."""
        value = self.segment.settings.get(name)
        is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        return float(value) if is_number and value is not None else None

    @cached_property
    def mean_i(self) -> complex:
        """Of the second half, where what was switched on has settled."""
        return complex(self.i[len(self.i) // 2 :].mean())

    @cached_property
    def mean_v(self) -> complex:
        """Of the second half."""
        return complex(self.v[len(self.v) // 2 :].mean())

    @cached_property
    def ripple_v(self) -> Vectors:
        """Voltage without its mean."""
        return np.asarray(self.v - self.v.mean())

    @property
    def set_point(self) -> complex | None:
        """The current that was asked for, in the stator's frame by the angle believed in; None where unknown."""
        names = ("target_d_a", "target_q_a") if self.is_injection else ("current_d_a", "current_q_a")
        d, q = (self.asked(name) for name in names)
        return None if d is None or q is None else complex(d, q) * np.exp(1j * self.theta_rad)

    @property
    def is_injection(self) -> bool:
        return self.segment.stage is SegmentStage.INJECTION


@dataclass(frozen=True)
class Survey:
    """The segments that were looked at, in order of time."""

    manifest: Manifest
    seen: Sequence[Sighting]
    criteria: ConventionCriteria

    def of(self, *stages: SegmentStage) -> list[Sighting]:
        return [s for s in self.seen if s.segment.stage in stages]

    @property
    def holds(self) -> list[Sighting]:
        return self.of(SegmentStage.RESISTANCE)

    @property
    def injections(self) -> list[Sighting]:
        return self.of(SegmentStage.INJECTION)

    @property
    def sampling_frequency_hz(self) -> float:
        return self.manifest.drive.sampling_frequency_hz

    @cached_property
    def reach_a(self) -> float:
        """The largest mean current of a segment."""
        return max((abs(s.mean_i) for s in self.seen), default=0.0)


def survey(recording: RecordingReader, criteria: ConventionCriteria, poll: Callable[[], None] = lambda: None) -> Survey:
    """Read holds, sweeps, injections and steps, evenly spread and of so many samples in all.

    Raises
    ------
    RecordingError
        Where a capture is not what the manifest says.
    """
    chosen: list[Segment] = []
    for stage in (SegmentStage.RESISTANCE, SegmentStage.CLASSICAL, SegmentStage.INJECTION, SegmentStage.STEPS):
        segments = [s for s in recording.segments(stage) if s.samples >= criteria.least_looked_at]
        most = criteria.looked_at_samples / (np.mean([s.samples for s in segments]) if segments else 1.0)
        few = max(min(len(segments), round(most)), min(len(segments), criteria.looked_at_segments))
        chosen += [segments[round(k)] for k in np.linspace(0, len(segments) - 1, few)]
    chosen.sort(key=lambda s: s.start_s)
    seen = []
    for segment in chosen:
        poll()
        seen.append(_sighting(recording, segment, criteria))
    return Survey(recording.manifest, seen, criteria)


def _sighting(recording: RecordingReader, segment: Segment, criteria: ConventionCriteria) -> Sighting:
    capture = recording.load(segment)
    rows = slice(0, criteria.looked_at_of_a_segment)
    i, v = (_complex(x[rows]) for x in (capture.i_ab, capture.v_ab))
    return Sighting(segment, i, v, None if capture.i_abc is None else capture.i_abc[rows], capture.v_dc[rows])


def _complex(x: NDArray[np.floating[Any]]) -> Vectors:
    return np.ascontiguousarray(x, dtype=np.float64).view(np.complex128).ravel()


def parts(z: Vectors) -> Array:
    """(alpha, beta) of complex vectors, shape (n, 2)."""
    return np.ascontiguousarray(z).view(np.float64).reshape(-1, 2)
