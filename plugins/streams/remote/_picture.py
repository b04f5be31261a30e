"""What a page shows of a run: its messages added up to one object of texts, numbers and short lists."""

from __future__ import annotations

from collections import deque
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.formatting.events import describe
from orchestrator.formatting.names import OUTCOME_MOODS, VERDICTS, plain, slots
from orchestrator.formatting.profiles import flux_at_zero
from orchestrator.formatting.quantities import vector
from orchestrator.formatting.results import resistance
from orchestrator.formatting.sentences import shown
from orchestrator.numerics.frames import to_dq
from orchestrator.stages import installed_stages
from plugins.streams._ripple import FluxTree, fit_ripple
from plugins.streams.console import Progress, stage_title, summary_rows, time_left
from protocols import (
    Diagnosed,
    MapEstimated,
    Message,
    OperatorAnswered,
    OperatorAsked,
    PointDone,
    RealArray,
    RunEnded,
    RunStarted,
    SamplesCaptured,
    SegmentStage,
    StagesAppended,
    StateChanged,
)

WORTH_A_LINE = ("paused", "faulted", "aborted")
"""States that get a line in the log; the page shows the others."""


class Picture:
    """A run so far.

    Parameters
    ----------
    run : Path
        The run directory.
    lines, bins : int
        What is kept of the log, and of a block of waveforms.
    """

    def __init__(self, run: Path, lines: int = 200, bins: int = 240) -> None:
        self._run, self._bins = run, bins
        self._progress = Progress(run)
        self._log: deque[tuple[str, str]] = deque(maxlen=lines)
        self._facts: dict[str, Any] = {"about": [], "limit_a": None, "motor": "", "drive": ""}
        self._question_number, self._question = 0, ""
        self._resistance_ohm = 0.0
        self._latest: SamplesCaptured | None = None
        self._reached: list[list[float]] = []
        self._tree = FluxTree()
        self._flux: tuple[str, list[list[float]]] = ("", [])
        self._maps: dict[str, MapEstimated] = {}
        self._verdict: dict[str, Any] | None = None
        self._ended: RunEnded | None = None

    @cached_property
    def _measuring(self) -> frozenset[str]:
        """The states in which the drive is armed."""
        return frozenset(stage.measuring.name for stage in installed_stages() if stage.measuring is not None)

    def take(self, message: Message) -> None:
        """Take one message in."""
        self._progress.take(message)
        match message:
            case RunStarted():
                self._begin(message)
            case SamplesCaptured() if len(message.capture):
                self._latest = message
            case PointDone():
                self._finish_point(message)
            case OperatorAsked():
                self._question_number, self._question = self._question_number + 1, message.prompt
            case OperatorAnswered():
                self._question = ""
            case MapEstimated():
                self._take_map(message)
            case Diagnosed():
                self._judge(message)
            case RunEnded():
                self._end(message)
        self._tell(message)

    def drawn(self) -> dict[str, Any]:
        """All of it, as JSON takes it."""
        progress, stage, flux = self._progress, self._progress.stage, self._flux
        # The prompt as the answer has to name it, and as it may be shown.
        question = {"number": self._question_number, "prompt": self._question, "text": shown(self._question)}
        return {
            **self._facts,
            "run": self._run.name,
            "name": shown(progress.name),
            "state": progress.state,
            "state_words": plain(progress.state),
            "armed": progress.state in self._measuring,
            "stage": "" if stage is None else shown(stage_title(progress, stage)),
            "stage_points": [0, 0] if stage is None else [min(stage.done + 1, stage.points), stage.points],
            "points": [progress.points_done, progress.points],
            "left": time_left(progress) if progress.points and self._ended is None else "",
            "target": None if progress.target is None else vector(*progress.target),
            "target_a": None if progress.target is None else [*progress.target],
            "achieved": None if progress.achieved is None else vector(*progress.achieved),
            "resistance": None if progress.resistance is None else resistance(progress.resistance),
            "question": question if self._question else None,
            "reached_a": self._reached,
            "flux": {"by": flux[0], "points": flux[1]},
            "waveform": self._waveform(),
            "verdict": self._verdict,
            "outcome": self._outcome(),
            "log": [*self._log],
        }

    def _begin(self, message: RunStarted) -> None:
        self._ended = None
        self._resistance_ohm = message.motor.stator_resistance_ohm or 0.0
        self._facts = {
            "about": [[label, shown(text)] for label, text in message.about.lines()],
            "limit_a": message.limits.current_a,
            "motor": shown(message.motor.name),
            "drive": message.drive,
        }

    def _finish_point(self, message: PointDone) -> None:
        if message.segment.stage in (SegmentStage.INJECTION, SegmentStage.RESISTANCE):
            self._reached.append(_rounded([message.achieved_d_a, message.achieved_q_a]))
        latest = self._latest
        if message.segment.stage is not SegmentStage.INJECTION or latest is None:
            return
        if latest.segment != message.segment.id:
            return
        fit = fit_ripple(latest.capture, latest.rotor_angle_rad, self._resistance_ohm)
        if fit is not None:
            self._tree.add(fit.mean_a, fit.inductance_h)
            self._show_flux("ripple, provisional", *self._tree.points())

    def _end(self, message: RunEnded) -> None:
        self._ended, self._question = message, ""
        recommended = None if message.estimates is None else self._maps.get(message.estimates.method or "")
        if recommended is not None:
            self._take_map(recommended)

    def _take_map(self, message: MapEstimated) -> None:
        estimate = message.estimate
        self._maps[estimate.map.method] = message
        zero = np.array(list(flux_at_zero(estimate.map).values()))
        self._show_flux(plain(estimate.map.method), estimate.points.i_dq, estimate.points.psi_dq - zero)

    def _show_flux(self, by: str, i_dq: RealArray, psi_dq: RealArray) -> None:
        rows = np.column_stack([i_dq, 1e3 * psi_dq])
        rows = rows[np.isfinite(rows).all(axis=1)]
        self._flux = shown(by), [_rounded(row) for row in rows[:: 1 + len(rows) // 800]]

    def _judge(self, message: Diagnosed) -> None:
        verdict = VERDICTS[message.report.verdict]
        self._verdict = {
            "name": verdict.name,
            "meaning": verdict.meaning,
            "mood": verdict.mood,
            "slots": [[title, shown(text)] for title, text in slots(message.words)] if message.words else [],
        }

    def _outcome(self) -> dict[str, Any] | None:
        if self._ended is None:
            return None
        files = self._ended.estimates.files if self._ended.estimates is not None else {}
        summary = (row for row in summary_rows(self._ended, self._run) if row[0] != "run" and row[0] not in files)
        rows = [[label, shown(text)] for label, text in summary]
        return {"ending": self._ended.outcome, "mood": OUTCOME_MOODS[self._ended.outcome], "rows": rows}

    def _tell(self, message: Message) -> None:
        event = describe(message)
        if event is None or isinstance(message, OperatorAsked | StagesAppended | RunEnded):
            return
        if isinstance(message, StateChanged) and message.target not in WORTH_A_LINE:
            return
        self._log.append((event.mood, shown(event.line)))

    def _waveform(self) -> dict[str, Any] | None:
        """The latest block in the believed frame, its peaks kept: time [ms], i_d and i_q [A]."""
        if self._latest is None:
            return None
        capture = self._latest.capture
        angle = self._latest.rotor_angle_rad if capture.theta_rad is None else capture.theta_rad
        i_dq = to_dq(capture.i_ab, angle)
        per_bin = -(-len(i_dq) // self._bins)
        time_ms = 1e3 * np.arange(len(i_dq)) / capture.sampling_frequency_hz
        if per_bin < 3:
            return {"time_ms": _rounded(time_ms), "i_d_a": _rounded(i_dq[:, 0]), "i_q_a": _rounded(i_dq[:, 1])}
        starts = np.arange(0, len(i_dq), per_bin)
        low, high = (f.reduceat(i_dq, starts, axis=0) for f in (np.minimum, np.maximum))
        pairs = np.stack([low, high], axis=1).reshape(-1, 2)
        times = np.stack([time_ms[starts]] * 2, axis=1).ravel()
        return {"time_ms": _rounded(times), "i_d_a": _rounded(pairs[:, 0]), "i_q_a": _rounded(pairs[:, 1])}


def _rounded(values: RealArray | list[float]) -> list[float]:
    """As many digits as a screen shows; what is not finite is nothing."""
    return [float(f"{x:.5g}") for x in np.nan_to_num(np.asarray(values, dtype=float), posinf=0.0, neginf=0.0)]
