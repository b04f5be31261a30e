"""The device's capture memory: rows and ripple rows of the latest program."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.frames import to_phases
from plugins.drives.simulated.rig import Step
from plugins.wire import (
    RIPPLE_FLAG,
    CaptureSource,
    Channel,
    Message,
    RippleD,
    RippleGrid,
    RippleQ,
    RowFormat,
    Scales,
    demodulate,
)

Real = NDArray[np.floating[Any]]
CHANNELS = (
    Channel.I_ALPHA | Channel.I_BETA | Channel.V_ALPHA | Channel.V_BETA | Channel.V_DC
    | Channel.I_A | Channel.I_B | Channel.I_C
)  # fmt: skip


class Capture:
    """Capture of one program.

    Parameters
    ----------
    number, rows : int
        Capture number, and samples of the complete capture.
    form : RowFormat, optional
        None: no raw rows.
    memory_bytes : int, optional
        Size of the ring; None keeps everything.
    """

    def __init__(
        self,
        number: int,
        rows: int,
        form: RowFormat | None,
        memory_bytes: int | None,
        ripple: RippleMemory | None = None,
    ) -> None:
        self.number, self.rows = number, rows
        self.row_bytes = 0 if form is None else form.row_bytes
        self.ripple = ripple
        self.done = 0
        """Samples captured so far."""
        self._form = form
        self._raw = None if form is None else CaptureSource(number, rows * form.row_bytes, memory_bytes)

    def source(self, number: int) -> CaptureSource | None:
        """The source of a capture number's data."""
        if number == self.number:
            return self._raw
        if number == self.number + RIPPLE_FLAG and self.ripple is not None:
            return self.ripple.source
        return None

    def take(self, step: Step) -> list[Message]:
        """Store the samples of a step; returns live ripple rows."""
        count = min(len(step.i_ab), self.rows - self.done)
        i, v, v_dc = step.i_ab[:count], step.v_ab[:count], step.v_dc[:count]
        self.done += count
        if self._raw is not None and self._form is not None:
            self._raw.append(self._form.pack(_columns(i, v, v_dc)))
        return self.ripple.take(i, v, self.done == self.rows) if self.ripple is not None else []


def _columns(i: Real, v: Real, v_dc: Real) -> dict[Channel, Real]:
    a, b, c = to_phases(i).T
    return {
        Channel.I_ALPHA: i[:, 0],
        Channel.I_BETA: i[:, 1],
        Channel.V_ALPHA: v[:, 0],
        Channel.V_BETA: v[:, 1],
        Channel.V_DC: v_dc,
        Channel.I_A: a,
        Channel.I_B: b,
        Channel.I_C: c,
    }


class RippleMemory:
    """Ripple rows, demodulated during the capture; live rows equal those that are read afterwards.

    Parameters
    ----------
    number : int
        Capture number of the program.
    grid : RippleGrid
    samples : int
        Samples of the capture.
    angle_rad : float
        Believed d axis in the stator frame.
    base_v : (float, float)
        Frozen voltage, believed dq frame.
    """

    def __init__(self, number: int, grid: RippleGrid, samples: int, angle_rad: float, scales: Scales) -> None:
        self.rows = grid.rows(samples)
        self.source = CaptureSource(number + RIPPLE_FLAG, self.rows * grid.row_bytes)
        self.base_v = (0.0, 0.0)
        self._grid, self._scales = grid, scales
        self._starts = grid.starts(self.rows)
        self._turn = np.exp(-1j * angle_rad)
        self._i, self._v = np.zeros((0, 2)), np.zeros((0, 2))
        self._rows_done = 0

    def take(self, i_ab: Real, v_ab: Real, last: bool) -> list[Message]:
        """Add samples; returns the rows that they complete."""
        self._i = np.concatenate((self._i, self._believed(i_ab)))
        self._v = np.concatenate((self._v, self._believed(v_ab)))
        first = int(self._starts[self._rows_done])
        # A row ends where the next one starts, so the next row's first sample is needed, except for the last row.
        stop = self.rows if last else int(np.searchsorted(self._starts, first + len(self._i), side="right")) - 1
        stop = min(stop, self.rows)
        if stop <= self._rows_done:
            return []
        count = int(self._starts[stop]) - first
        tail = _RowRange(**vars(self._grid), row=self._rows_done, many=stop - self._rows_done)
        counts = demodulate(self._i[:count], self._v[:count], self.base_v, tail).counts(self._scales)
        self._i, self._v = self._i[count:], self._v[count:]
        self.source.append(counts.tobytes())
        begin, self._rows_done = self._rows_done, stop
        return list(_live(counts.tolist(), begin))

    def _believed(self, ab: Real) -> NDArray[np.float64]:
        dq = (ab[:, 0].astype(np.float64) + 1j * ab[:, 1]) * self._turn
        return np.column_stack((dq.real, dq.imag))


def _live(counts: list[list[int]], first: int) -> Iterator[Message]:
    for n, row in enumerate(counts, first):
        half = len(row) // 2
        yield RippleD(n % 65536, *row[:3])
        yield RippleQ(n % 65536, *row[half : half + 3])


@dataclass(frozen=True)
class _RowRange(RippleGrid):
    """Successive rows of a grid, with their first sample as sample 0."""

    row: int = 0
    many: int = 0

    @property
    def _first(self) -> int:
        return int(super().starts(self.row)[-1])

    def phase(self, samples: Real, delay: float = 0.0) -> NDArray[np.float64]:
        return super().phase(np.asarray(samples + self._first), delay)

    def rows(self, samples: int) -> int:
        return self.many

    def starts(self, rows: int) -> NDArray[np.int64]:
        return super().starts(self.row + rows)[self.row :] - self._first
