"""A run or recording on disk as the messages that a stream would have got, so that its pictures can be made later.

Missing or damaged files are left out, with a note.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from orchestrator.diagnosis import load_diagnosis
from orchestrator.discovery import form_values, load_discovery
from orchestrator.estimation import estimate_of_map, has_estimates, load_estimates, load_flux_map
from orchestrator.formatting.names import plain
from orchestrator.numerics.frames import to_dq
from orchestrator.recording import Recording, open_recording
from orchestrator.runs import Journal, RunDirectory, is_run
from protocols import (
    Diagnosed,
    EstimationReport,
    FluxbenchError,
    LawLearned,
    Limits,
    MapEstimated,
    Message,
    Note,
    PointDone,
    PointStarted,
    RecordingError,
    ResistanceEstimated,
    RunEnded,
    RunStarted,
    SamplesCaptured,
    Segment,
    StageStarted,
)


def replay(directory: Path) -> Iterator[Message]:
    """The messages of a run, or of a recording that no run has made, in order of time.

    Raises
    ------
    RecordingError
        Where the directory is neither.
    """
    yield from _of_run(directory) if is_run(directory) else _of_recording(open_recording(directory))


def _of_run(directory: Path) -> Iterator[Message]:
    run = RunDirectory.open(directory)
    recording = Recording(run.path, run.manifest())
    journal = Journal(directory / "journal.jsonl").read()
    ended = max((k for k, r in enumerate(journal) if isinstance(r.message, RunEnded)), default=len(journal))
    for number, record in enumerate(journal):
        message = record.message
        if isinstance(message, PointDone):
            yield from _samples(recording, message.segment)
        if number == ended and isinstance(message, RunEnded):
            yield from _results(directory)
            message = message.model_copy(update={"estimates": _report(directory) or message.estimates})
        yield message
    if ended == len(journal):
        yield from _results(directory)


def _of_recording(recording: Recording) -> Iterator[Message]:
    manifest = recording.manifest
    segments = recording.segments()
    yield RunStarted(
        run=recording.path.name,
        name=manifest.name,
        motor=manifest.motor,
        limits=_reached_limits(recording, segments),
        drive=manifest.drive.name,
        stages=len({s.stage for s in segments}),
        points=len(segments),
        points_done=0,
        seconds=0.0,
    )
    stage = None
    stage_index = -1
    for number, segment in enumerate(segments):
        if segment.stage is not stage:
            stage, stage_index = segment.stage, stage_index + 1
            yield StageStarted(index=stage_index, stage=stage.value, points=sum(s.stage is stage for s in segments))
        yield PointStarted(
            id=segment.id,
            stage_index=stage_index,
            target_d_a=_setting(segment, "target_d_a", "current_d_a"),
            target_q_a=_setting(segment, "target_q_a", "current_q_a"),
            seconds=segment.samples / manifest.drive.sampling_frequency_hz,
        )
        capture = recording.load(segment)
        yield from _samples(recording, segment)
        angle = segment.rotor_angle_rad if capture.theta_rad is None else capture.theta_rad
        i_dq = to_dq(capture.i_ab, angle).mean(axis=0)
        yield PointDone(
            id=segment.id,
            stage_index=stage_index,
            segment=segment,
            achieved_d_a=float(i_dq[0]),
            achieved_q_a=float(i_dq[1]),
            points_done=number + 1,
            points=len(segments),
            seconds_left=0.0,
        )
    yield from _results(recording.path)


def _samples(recording: Recording, segment: Segment) -> Iterator[Message]:
    try:
        capture = recording.load(segment)
    except FluxbenchError as error:
        yield Note(level="warning", text=str(error))
        return
    yield SamplesCaptured(segment=segment.id, rotor_angle_rad=segment.rotor_angle_rad, capture=capture)


def _results(directory: Path) -> Iterator[Message]:
    """What was found out: R_s, the maps, and the latest diagnosis; a warning for each that cannot be read."""
    yield from _unreadable_report(directory)
    report = _report(directory)
    if report is not None and report.resistance is not None:
        yield ResistanceEstimated(estimate=report.resistance)
    yield from _maps(directory)
    try:
        diagnosis = load_diagnosis(directory)
    except FluxbenchError as error:
        yield Note(level="warning", text=str(error))
        return
    if diagnosis is not None:
        yield from diagnosis.steps
        yield Diagnosed(round=0, report=diagnosis.report, words=diagnosis.words)
    yield from _laws(directory)


def _laws(directory: Path) -> Iterator[Message]:
    """The laws that were found beyond the library, those with a curve; a warning where they cannot be read."""
    try:
        found = load_discovery(directory)
    except FluxbenchError as error:
        yield Note(level="warning", text=str(error))
        return
    for law in found.laws if found is not None else ():
        if not law.curve:
            continue
        x, y, y_std = (np.array([getattr(point, of) for point in law.curve]) for of in ("x", "y", "std"))
        yield LawLearned(
            sentence=law.sentence,
            formula=law.forms[0].formula,
            x_label=f"{law.symbol} [{law.quantity_unit}]",
            y_label=f"{plain(law.place)} [{law.unit}]",
            x=x,
            y=y,
            y_std=y_std,
            y_form=form_values(law.forms[0], x),
        )


def _maps(directory: Path) -> Iterator[Message]:
    """The maps in results/, the recommended one last, with the remarks on all."""
    files = sorted((directory / "results").glob("flux_map*.nc"), key=lambda f: (f.name == "flux_map.nc", f.name))
    report = _report(directory)
    for file in files:
        try:
            grid = load_flux_map(file)
        except FluxbenchError as error:
            yield Note(level="warning", text=str(error))
            continue
        yield MapEstimated(estimate=estimate_of_map(grid, report))


def _unreadable_report(directory: Path) -> Iterator[Note]:
    """A warning where there is a report that cannot be read."""
    try:
        if has_estimates(directory):
            load_estimates(directory)
    except RecordingError as error:
        yield Note(level="warning", text=f"left out: {error}")


def _report(directory: Path) -> EstimationReport | None:
    """The estimators' report with the recommended map; None where it is missing or another's."""
    try:
        return load_estimates(directory)
    except RecordingError:
        return None


def _reached_limits(recording: Recording, segments: Sequence[Segment]) -> Limits:
    """What a recording reached: it knows of no limits."""
    current = voltage = 1e-3
    for segment in segments:
        capture = recording.load(segment)
        current = max(current, float(np.hypot(*capture.i_ab[::7].T).max()))
        voltage = max(voltage, float(np.hypot(*capture.v_ab[::7].T).max()))
    return Limits(current_a=1.05 * current, voltage_v=1.05 * voltage)


def _setting(segment: Segment, *names: str) -> float | None:
    values = (segment.settings.get(name) for name in names)
    return next((float(v) for v in values if isinstance(v, int | float)), None)
