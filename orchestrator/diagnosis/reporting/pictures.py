"""Figure data of one step of the ladder: the residual by windows, R_s over heat, and excerpts of waveforms.

A fit is converted to a `DiagnosisStep`, thinned to the resolution of a figure.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.excerpts import excerpts, flux_loops
from orchestrator.diagnosis.reporting.ladder import noise_rms_v, rung
from orchestrator.diagnosis.selection.search_state import AcceptedModel
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.diagnosis.weak_form.windows import sum_intervals
from orchestrator.numerics.frames import to_ab, to_dq, to_phases
from orchestrator.numerics.types import Array
from protocols import DiagnosisStep, ResistanceCourse, Rung, SegmentStage

MAX_ROWS: int = 4000
"""Maximum number of rows of the residual in a step."""
MAX_DWELLS: int = 400
"""Maximum number of points of the resistance over time."""
MIN_DWELL_CURRENT: float = 0.2
"""Current of a dwell, relative to the largest, below which its R_s is too uncertain."""

_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


def diagnosis_step(index: int, step: AcceptedModel, *, known: Rung | None = None) -> DiagnosisStep:
    """Figure data of one step of the ladder, for streams, report and file.

    Parameters
    ----------
    index : int
        Index in the ladder; 0 for its first model.
    step : AcceptedModel
    known : Rung, optional
        The step's numbers where they are known already; the simulated current's error takes time.

    Notes
    -----
    Rows are windows of the weak form, without the injection's modes other than the mean, thinned to `MAX_ROWS` with
    every stage kept; they are the same at every step of one recording.
    """
    fit = step.fit
    numbers = known or rung(step)
    rows = [_Rows(fit, k) for k in range(len(fit.prepared.pieces))]
    stages = [row.piece.stage.value for row in rows for _ in range(len(row.time_s))]
    shown = kept_rows(stages, MAX_ROWS)
    residual_ab = np.concatenate([row.residual_ab_v for row in rows])[shown]
    i_ab = np.concatenate([row.i_ab for row in rows])[shown]
    return DiagnosisStep(
        index=index,
        added=step.added,
        effects=fit.model.names,
        chi2=numbers.chi2 or 0.0,
        rms_v=numbers.rms_v or 0.0,
        heldout_rms_v=numbers.heldout_rms_v,
        current_rms_a=numbers.current_rms_a,
        noise_rms_v=noise_rms_v(fit) or 0.0,
        stage=tuple(stages[k] for k in shown),
        time_s=np.concatenate([row.time_s for row in rows])[shown],
        i_dq=np.concatenate([row.i_dq for row in rows])[shown],
        residual_dq_v=np.concatenate([row.residual_dq_v for row in rows])[shown],
        noise_v=np.concatenate([row.noise_v for row in rows])[shown],
        i_abc=to_phases(i_ab),
        residual_abc_v=to_phases(residual_ab),
        pwm_frequency_hz=np.concatenate([np.full(len(r.time_s), r.piece.signals.pwm_frequency_hz) for r in rows])[
            shown
        ],
        excerpts=excerpts(fit),
        loops=flux_loops(fit),
        resistance=_resistance_course(fit, rows),
    )


def kept_rows(stages: list[str], max_rows: int) -> NDArray[np.int64]:
    """Indices of at most `max_rows` rows: small stages completely, large ones thinned evenly.

    A golden-ratio sequence selects them, which avoids aliasing with turns and periods in the rows.
    """
    counts = Counter(stages)
    share: dict[str, float] = {}
    available = max_rows
    for done, (stage, count) in enumerate(sorted(counts.items(), key=lambda c: c[1])):
        taken = min(count, available // (len(counts) - done))
        share[stage], available = taken / count, available - taken
    labels = np.array(stages)
    chosen = []
    for stage, part in share.items():
        rows = np.flatnonzero(labels == stage)
        taken = np.mod(np.arange(len(rows)) * _GOLDEN, 1.0) < part
        chosen.append(rows[taken] if part < 1.0 else rows)
    return np.sort(np.concatenate(chosen)) if chosen else np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class _Rows:
    """The windows of order zero of one segment."""

    fit: Fit
    index: int

    @property
    def piece(self) -> SegmentData:
        return self.fit.prepared.pieces[self.index]

    @property
    def angle(self) -> float:
        return float(self.piece.segment.rotor_angle_rad)

    @cached_property
    def time_s(self) -> Array:
        """Centre of each test function."""
        w, s = self.piece.windows, self.piece.signals
        return np.asarray(
            s.start_s + (np.arange(w.test_functions) + 1.0) * w.step / s.sampling_frequency_hz, dtype=np.float64
        )

    @cached_property
    def i_ab(self) -> Array:
        """Mean measured current in each test function, stator frame."""
        w, i = self.piece.windows, self.piece.signals.i_ab
        one_bin = np.zeros(len(i) - 1, dtype=np.int64)
        sums = sum_intervals(0.5 * (i[1:] + i[:-1]), w.step, w.test_functions, one_bin, 1)
        return np.asarray(sums[:, 0] / w.step, dtype=np.float64)

    @property
    def i_dq(self) -> Array:
        return to_dq(self.i_ab, self.angle)

    @cached_property
    def residual_dq_v(self) -> Array:
        return self._means(self.fit.volts[self.index])

    @property
    def residual_ab_v(self) -> Array:
        return to_ab(self.residual_dq_v, self.angle)

    @property
    def noise_v(self) -> Array:
        """rms of both axes' standard deviations."""
        scale = self.piece.signals.sampling_frequency_hz / self.piece.windows.absolute_weight
        variance = self._means(self.fit.linearisation.pieces[self.index].whitener.variance * scale**2)
        return np.asarray(np.sqrt(variance.mean(axis=1)), dtype=np.float64)

    def _means(self, rows: Array) -> Array:
        w = self.piece.windows
        return rows.reshape(w.test_functions, len(w.modes), 2)[:, 0]


def _resistance_course(fit: Fit, rows: list[_Rows]) -> ResistanceCourse | None:
    """R_s at every dwell (DC holds, injection points): the model's R, and R + e.i / i.i with residual e = v - R i."""
    largest = max((float(np.linalg.norm(row.i_ab, axis=1).max(initial=0.0)) for row in rows), default=0.0)
    dwells = []
    for row in rows:
        if row.piece.stage not in (SegmentStage.RESISTANCE, SegmentStage.INJECTION):
            continue
        current = row.i_dq.mean(axis=0)
        square = float(current @ current)
        if square < (MIN_DWELL_CURRENT * largest) ** 2 or square == 0.0:
            continue
        _, base = fit.linearisation.base_of(row.index)
        model = float(fit.corrected(row.index).resistance_ohm.mean()) * fit.model.r_s / float(base.resistance_ohm[0])
        estimate = model + float(row.residual_dq_v.mean(axis=0) @ current) / square
        dwells.append((float(row.time_s.mean()), float(base.heat_j.mean()), estimate, model))
    if not dwells:
        return None
    stride = math.ceil(len(dwells) / MAX_DWELLS)
    time_s, heat_j, measured, modelled = np.array(dwells[::stride]).T
    return ResistanceCourse(
        time_s=np.ascontiguousarray(time_s),
        heat_j=np.ascontiguousarray(heat_j),
        measured_ohm=np.ascontiguousarray(measured),
        model_ohm=np.ascontiguousarray(modelled),
    )
