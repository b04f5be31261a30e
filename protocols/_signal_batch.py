"""Many segments of a recording at once, one after the other along time: an effect is evaluated on all in one call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from protocols._base import RealArray
from protocols._motor import Motor
from protocols._recording import DriveRecord
from protocols._signals import Correction, Signals, with_magnetising


@dataclass(frozen=True)
class SignalBatch:
    """Segments as `Signals` has one, their arrays laid end to end: N samples in all, time first.

    Attributes
    ----------
    segments : tuple of Signals
        As they were laid end to end: what is the same throughout a segment is read there (`came_from_ab`, `losses`).
    starts : array of int64, shape (segments + 1,)
        Samples `starts[k]` up to `starts[k + 1]` are those of segment k.
    sampling_frequency_hz, pwm_frequency_hz : array, shape (segments,)
    start_s, turned_rad : array, shape (segments,)
    i_ab, v_ab, i_m_ab : array, shape (N, 2)
    v_dc, theta_rad, resistance_ohm, heat_j : array, shape (N,)
    v_late_ab, i_quiet_ab : array, shape (N, 2), or None
        None where no segment has one; else zeros, and the current, in segments that have none.
    largest_command_abc : array, shape (N, 3), or None
        None where no segment has one; else zeros in segments that have none.
    psi_ab, psi_smooth_ab, i_smooth_ab : array, shape (N, 2), or None
    inductance_ab : array, shape (N, 3), or None
        Inductance of the present model; None without one.
    """

    segments: tuple[Signals, ...]
    starts: NDArray[np.int64]
    sampling_frequency_hz: RealArray
    pwm_frequency_hz: RealArray
    start_s: RealArray
    turned_rad: RealArray
    i_ab: RealArray
    v_ab: RealArray
    v_dc: RealArray
    theta_rad: RealArray
    resistance_ohm: RealArray
    i_m_ab: RealArray
    heat_j: RealArray
    v_late_ab: RealArray | None = None
    i_quiet_ab: RealArray | None = None
    largest_command_abc: RealArray | None = None
    psi_ab: RealArray | None = None
    inductance_ab: RealArray | None = None
    psi_smooth_ab: RealArray | None = None
    i_smooth_ab: RealArray | None = None

    @classmethod
    def of(cls, segments: Sequence[Signals]) -> SignalBatch:
        """Some segments of one recording, laid end to end; the arrays of a single one are its own."""
        lengths = [len(s.v_dc) for s in segments]
        laid = {name: _laid(segments, name) for name in _ALWAYS}
        if all(s.i_m_ab is s.i_ab for s in segments):
            laid["i_m_ab"] = laid["i_ab"]
        there = [name for name in _OPTIONAL if any(getattr(s, name) is not None for s in segments)]
        laid |= {name: _laid(segments, name) for name in there}
        return cls(
            segments=tuple(segments),
            starts=np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
            **{name: np.array([getattr(s, name) for s in segments], dtype=np.float64) for name in _FACTS},
            **laid,
        )

    @property
    def motor(self) -> Motor | None:
        """The nameplate."""
        return self.segments[0].motor

    @property
    def drive(self) -> DriveRecord | None:
        return self.segments[0].drive

    @property
    def samples(self) -> int:
        return int(self.starts[-1])

    @property
    def time_s(self) -> RealArray:
        """When each sample was, since the start of the experiment, shape (N,) [s]."""
        within = np.arange(self.samples) - self.per_sample(self.starts[:-1])
        return self.per_sample(self.start_s) + within / self.per_sample(self.sampling_frequency_hz)

    def per_sample(self, values: RealArray | NDArray[np.int64]) -> RealArray:
        """One value a segment, shape (segments,), as one a sample, shape (N,) or, where all are the same, (1,)."""
        if len(values) == 1 or (values == values[0]).all():
            return np.asarray(values[:1], dtype=np.float64)
        return np.repeat(np.asarray(values, dtype=np.float64), np.diff(self.starts))

    def slice_of(self, k: int) -> slice:
        """The samples of segment k."""
        return slice(int(self.starts[k]), int(self.starts[k + 1]))

    def segment(self, k: int) -> Signals:
        """Segment k as the batch has it, its arrays views."""
        names = [name for name in (*_ALWAYS, *_OPTIONAL) if getattr(self, name) is not None]
        return self.segments[k].replaced({name: getattr(self, name)[self.slice_of(k)] for name in names})

    def changed_along(self, arrays: Mapping[str, RealArray]) -> Mapping[str, RealArray]:
        """All that changes where some arrays do, by their names: what magnetises moves along with the current."""
        return with_magnetising(arrays, self.i_ab, self.i_m_ab, self.i_quiet_ab)

    def replaced(self, arrays: Mapping[str, RealArray]) -> SignalBatch:
        """A batch with some arrays, by name, replaced by others of the same shapes; nothing is checked."""
        other = object.__new__(SignalBatch)
        other.__dict__.update(self.__dict__, **arrays)
        return other

    def with_segments(self, segments: Sequence[Signals]) -> SignalBatch:
        """A batch with other facts of its segments, whose arrays are ignored."""
        return replace(self, segments=tuple(segments))

    def corrected(self, correction: Correction) -> SignalBatch:
        """A batch with an effect's changes."""
        changed = self.changed_along(correction.arrays)
        return self.replaced(changed) if changed else self


_FACTS = ("sampling_frequency_hz", "pwm_frequency_hz", "start_s", "turned_rad")
_ALWAYS = ("i_ab", "v_ab", "v_dc", "theta_rad", "resistance_ohm", "i_m_ab", "heat_j")
_MODEL = ("psi_ab", "inductance_ab", "psi_smooth_ab", "i_smooth_ab")
_OPTIONAL = ("v_late_ab", "i_quiet_ab", "largest_command_abc", *_MODEL)


def _laid(segments: Sequence[Signals], name: str) -> RealArray:
    """One array of all segments, laid end to end: what stands for it in a segment that has none is no other value."""
    parts = [_or_else(s, name) for s in segments]
    whole = parts[0] if len(parts) == 1 else np.concatenate(parts)
    return np.ascontiguousarray(whole, dtype=np.float64)


def _or_else(signals: Signals, name: str) -> RealArray:
    array: RealArray | None = getattr(signals, name)
    if array is not None:
        return array
    if name == "i_quiet_ab":
        return signals.i_ab
    return np.zeros((len(signals.v_dc), 3 if name == "largest_command_abc" else 2))
