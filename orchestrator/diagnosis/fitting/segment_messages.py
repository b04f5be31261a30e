"""What was made of a segment as a message, and back: what has not changed since an earlier frame is not said again."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from orchestrator.diagnosis.fitting.columns import ColumnProbe
from orchestrator.diagnosis.fitting.model import SegmentFrame, SegmentRows
from orchestrator.diagnosis.fitting.segment_work import Made
from orchestrator.diagnosis.fitting.shared_room import Content
from orchestrator.diagnosis.weak_form.noise import Whitener
from orchestrator.diagnosis.weak_form.segments import SegmentSignals
from orchestrator.numerics.types import Array
from protocols import Signals


def said_of(made: Made, piece: SegmentSignals, old: SegmentFrame | None, *, renewed: bool) -> Content:
    """What was made of a segment, as `heard` reads it where the same frame of before is known."""
    rows, probe = made.rows, made.probe
    return {
        "frame": _said_of_frame(made.frame, piece, old) if renewed else None,
        "rows": None if rows is None else [rows.known, rows.resistance, rows.white],
        "answers": None if probe is None else [[*key, power] for key, power in probe.answers.items()],
    }


def heard(said: Content, piece: SegmentSignals, old: SegmentFrame | None) -> Made:
    """What was made of a segment."""
    frame = old if said["frame"] is None else _heard_of_frame(said["frame"], piece, old)
    assert frame is not None
    if said["rows"] is None:
        return Made(frame)
    rows = SegmentRows(*said["rows"])
    if said["answers"] is None:
        return Made(frame, rows)
    return Made(frame, rows, ColumnProbe(rows.columns, {(k, effect): p for k, effect, p in said["answers"]}))


def _said_of_frame(frame: SegmentFrame, piece: SegmentSignals, old: SegmentFrame | None) -> Content:
    measured, base = piece.signals, frame.base
    same_noise = old is not None and frame.whitener is old.whitener
    return {
        "base": {name: array for name, array in _arrays_of(base).items() if array is not getattr(measured, name)},
        "power": base.losses and base.losses.power_w,
        "noise": None if same_noise else _said_of_noise(frame),
        "basis": None if old is not None and frame.basis is old.basis else frame.basis,
        "white_basis": None if old is not None and frame.white_basis is old.white_basis else frame.white_basis,
    }


def _said_of_noise(frame: SegmentFrame) -> Content:
    return {
        "whitener": {part.name: getattr(frame.whitener, part.name) for part in fields(Whitener)},
        "mean_inductance": frame.mean_inductance,
        "carried_by": [[*column, x] for column, x in frame.carried_by.items()],
    }


def _heard_of_frame(said: Content, piece: SegmentSignals, old: SegmentFrame | None) -> SegmentFrame:
    measured = piece.signals
    losses = measured.losses and measured.losses.model_copy(update={"power_w": said["power"]})
    noise = said["noise"]
    if noise is not None:
        known = Whitener(**noise["whitener"])
        mean, carried = noise["mean_inductance"], {(effect, name): x for effect, name, x in noise["carried_by"]}
    else:
        assert old is not None
        known, mean, carried = old.whitener, old.mean_inductance, old.carried_by
    return SegmentFrame(
        measured.model_copy(update={**said["base"], "losses": losses}),
        known,
        _or_of(said["basis"], old, "basis"),
        _or_of(said["white_basis"], old, "white_basis"),
        mean,
        carried,
    )


def _or_of(said: Array | None, old: SegmentFrame | None, name: str) -> Array:
    return said if said is not None else getattr(old, name)


def _arrays_of(signals: Signals) -> dict[str, Array]:
    return {name: array for name, array in vars(signals).items() if isinstance(array, np.ndarray)}
