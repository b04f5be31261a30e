"""Reads what a run directory or a recording holds; what is missing or damaged is noted, never guessed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from orchestrator.estimation import load_estimates, load_flux_map
from orchestrator.numerics.frames import to_dq
from orchestrator.recording import Recording, has_model, open_recording, read_model
from orchestrator.runs import Journal, JournalRecord, RunDirectory, RunRecord
from protocols import (
    DiagnosisStep,
    EstimationReport,
    FluxbenchError,
    FluxMap,
    LockChecked,
    Manifest,
    Note,
    PointDone,
    RealArray,
    RecordingError,
    ResistanceEstimated,
    ResistanceReading,
    RunEnded,
    Segment,
    SegmentStage,
)

if TYPE_CHECKING:
    from orchestrator.diagnosis import SavedDiagnosis
    from orchestrator.discovery import Discovery
    from orchestrator.tuning import TuningReport

T = TypeVar("T")


@dataclass(frozen=True)
class Paths:
    """Currents (i_d, i_q) that were reached, in the believed frame."""

    classical: tuple[RealArray, ...] = ()
    """One trajectory a segment, shape (n, 2)."""
    injection: RealArray = field(default_factory=lambda: np.empty((0, 2)))
    """One mean current a segment, shape (n, 2)."""
    steps: tuple[RealArray, ...] = ()
    """Of voltage steps: the currents of one segment each, shape (n, 2)."""
    spin: RealArray = field(default_factory=lambda: np.empty((0, 2)))
    """Mean currents in the frame of a rotor that turns, one a segment, shape (n, 2)."""
    temperature_c: RealArray = field(default_factory=lambda: np.empty((0, 2)))
    """Time [s] and mean temperature of each segment of direct current that has one, shape (n, 2)."""


@dataclass(frozen=True)
class Material:
    """All that the page is made of."""

    directory: Path
    manifest: Manifest | None
    record: RunRecord | None
    journal: tuple[JournalRecord, ...]
    estimates: EstimationReport | None
    maps: dict[str, FluxMap]
    """By method, the recommended one first."""
    paths: Paths
    diagnosis: SavedDiagnosis | None
    problems: tuple[str, ...]
    """What could not be read, one line each."""
    model_changes: tuple[str, ...] = ()
    """Effects that were added to `model.json` since the diagnosis, or removed."""
    discovery: Discovery | None = None
    """What a search for a law found beyond the library."""
    tuning: TuningReport | None = None
    """What `fluxbench tune` made of the map."""
    modelled: tuple[str, ...] = ()
    """The effects of `model.json`."""
    bare: DiagnosisStep | None = None
    """Where the bare model fails, before any diagnosis; None where it was not compared."""
    present: DiagnosisStep | None = None
    """Where `model.json` fails, if its effects are not the diagnosis'; None where it was not compared."""

    @property
    def ended(self) -> RunEnded | None:
        """How the run ended last; None while it has not."""
        for entry in reversed(self.journal):
            if isinstance(entry.message, RunEnded):
                return entry.message
            if entry.message.kind == "run_started":
                return None
        return None

    @property
    def readings(self) -> tuple[ResistanceReading, ...]:
        """R_s over time, from the estimates or else from the journal; empty where neither has it."""
        resistance = self.estimates.resistance if self.estimates is not None else None
        kept = resistance.readings if resistance is not None else ()
        estimates = [e.message.estimate.readings for e in self.journal if isinstance(e.message, ResistanceEstimated)]
        return kept or (estimates[-1] if estimates else ())

    @property
    def lock(self) -> LockChecked | None:
        """The latest verdict on the rotor's lock."""
        checks = [e.message for e in self.journal if isinstance(e.message, LockChecked)]
        return checks[-1] if checks else None


def is_worth_a_report(directory: Path) -> bool:
    """Whether the directory holds anything that a report could be made of."""
    names = ("run.json", "recording.json", "results/estimates.json", "results/diagnosis.json")
    return any((directory / name).is_file() for name in names)


def collect(directory: Path, *, reads_paths: bool = True, compares: bool = False) -> Material:
    """Read everything (`reads_paths`: waveforms too); raises `RecordingError` where it is neither run nor recording.

    With `compares`, the bare model is fitted to a recording that was not diagnosed, and a model that was changed by
    hand is evaluated.
    """
    if not is_worth_a_report(directory):
        nothing = "neither run.json nor recording.json is there: give the folder of a run or of a recording"
        raise RecordingError(str(directory), "", nothing)
    # Its kernels take a second to import, and the stream is loaded when a run begins.
    from orchestrator.diagnosis import bare_model_step, load_diagnosis, model_changes, model_step
    from orchestrator.interface.api import chosen_effects

    problems: list[str] = []

    def attempt(read: Callable[[], T], *, wanted: bool) -> T | None:
        if not wanted:
            return None
        try:
            return read()
        except (FluxbenchError, OSError) as error:
            problems.append(str(error))
            return None

    record = attempt(lambda: RunDirectory.open(directory).record, wanted=(directory / "run.json").is_file())
    recording = attempt(lambda: open_recording(directory), wanted=(directory / "recording.json").is_file())
    journal = attempt(lambda: Journal(directory / "journal.jsonl").read(), wanted=True) or []
    estimates_file = directory / "results" / "estimates.json"
    estimates = attempt(lambda: load_estimates(directory), wanted=estimates_file.is_file())
    maps: dict[str, FluxMap] = {}
    for file in sorted((directory / "results").glob("flux_map*.nc"), key=lambda f: (f.name != "flux_map.nc", f.name)):
        flux_map = attempt(partial(load_flux_map, file), wanted=True)
        if flux_map is not None:
            maps.setdefault(flux_map.method or file.stem, flux_map)
    achieved = {
        e.message.id: (e.message.achieved_d_a, e.message.achieved_q_a)
        for e in journal
        if isinstance(e.message, PointDone)
    }
    paths = None
    if recording is not None:
        paths = attempt(lambda: _paths(recording, achieved, problems), wanted=reads_paths)
    manifest = None if recording is None else recording.manifest
    diagnosis = attempt(lambda: load_diagnosis(directory), wanted=True)
    bare = None
    if recording is not None:
        bare = attempt(lambda: bare_model_step(recording), wanted=compares and diagnosis is None)
    model = attempt(lambda: read_model(directory), wanted=has_model(directory))
    modelled = tuple(effect.name for effect in model.effects) if model is not None else ()
    changes = model_changes(diagnosis.report, model) if diagnosis is not None and model is not None else ()
    present = None
    if recording is not None and model is not None:
        is_changed = bool(changes if diagnosis is not None else modelled)
        present = attempt(lambda: model_step(recording, model, chosen_effects()), wanted=compares and is_changed)
    discovery = attempt(lambda: _discovery(directory), wanted=(directory / "results" / "discovery.json").is_file())
    tuning = attempt(lambda: _tuning(directory), wanted=(directory / "tuning" / "tuning.json").is_file())
    problems += _notes_after_the_end(journal)
    shown = paths or Paths()
    return Material(
        directory, manifest, record, tuple(journal), estimates, maps, shown, diagnosis, tuple(problems), changes,
        discovery, tuning, modelled, bare, present,
    )  # fmt: skip


def _discovery(directory: Path) -> Discovery | None:
    from orchestrator.discovery import load_discovery

    return load_discovery(directory)


def _tuning(directory: Path) -> TuningReport | None:
    from orchestrator.tuning import load_tuning

    return load_tuning(directory / "tuning")


def _notes_after_the_end(journal: Sequence[JournalRecord]) -> list[str]:
    """What a run says when it is over: which of its by-products could not be written."""
    notes: list[str] | None = None
    for entry in journal:
        if isinstance(entry.message, RunEnded):
            notes = []
        elif not isinstance(entry.message, Note):
            notes = None
        elif notes is not None:
            notes.append(f"when the run had ended: {entry.message.text}")
    return notes or []


def _paths(
    recording: Recording,
    achieved: dict[str, tuple[float, float]],
    problems: list[str],
    budget: int = 6_000_000,
    path_points: int = 200,
) -> Paths:
    """Trajectories of sweeps and steps, mean currents of injection and spin; reads at most `budget` rows."""
    trajectories: dict[SegmentStage, list[RealArray]] = {SegmentStage.CLASSICAL: [], SegmentStage.STEPS: []}
    means: dict[SegmentStage, list[tuple[float, float]]] = {SegmentStage.INJECTION: [], SegmentStage.SPIN: []}
    left_out = 0
    for segment in recording.segments(*trajectories, *means):
        if segment.stage is SegmentStage.INJECTION and segment.id in achieved:
            means[segment.stage].append(achieved[segment.id])
            continue
        budget -= segment.samples
        if budget < 0:
            left_out += 1
            continue
        i_dq = _current(recording, segment)
        if segment.stage is SegmentStage.STEPS:
            # Some swings whole: of all of them every so many-th point is a tangle.
            trajectories[segment.stage].append(i_dq[: 3 * path_points])
        elif segment.stage is SegmentStage.CLASSICAL:
            trajectories[segment.stage].append(i_dq[:: max(1, len(i_dq) // path_points)])
        else:
            means[segment.stage].append((float(i_dq[:, 0].mean()), float(i_dq[:, 1].mean())))
    if left_out:
        problems.append(f"the current paths are drawn without {left_out} segments, to keep the reading short")
    points = {stage: np.array(values, dtype=np.float64).reshape(-1, 2) for stage, values in means.items()}
    return Paths(
        classical=tuple(trajectories[SegmentStage.CLASSICAL]),
        injection=points[SegmentStage.INJECTION],
        temperature_c=_temperatures(recording, budget),
        steps=tuple(trajectories[SegmentStage.STEPS]),
        spin=points[SegmentStage.SPIN],
    )


def _temperatures(recording: Recording, budget: int) -> RealArray:
    """Of the segments of direct current, which come again and again in a run."""
    means: list[tuple[float, float]] = []
    for segment in recording.segments(SegmentStage.RESISTANCE):
        budget -= segment.samples
        if budget < 0:
            break
        temperature = recording.load(segment).temperature_c
        if temperature is None:
            continue
        means.append((segment.start_s, float(np.mean(temperature))))
    return np.array(means, dtype=np.float64).reshape(-1, 2)


def _current(recording: Recording, segment: Segment) -> RealArray:
    """Current (d, q) of a segment's last period (the first may begin elsewhere), or of all where it has none."""
    capture = recording.load(segment)
    period = segment.settings.get("period_s")
    rows = len(capture)
    if segment.stage is SegmentStage.CLASSICAL and isinstance(period, int | float) and period > 0:
        rows = min(rows, round(period * capture.sampling_frequency_hz))
    theta = capture.theta_rad if segment.stage is SegmentStage.SPIN else None
    return to_dq(capture.i_ab[-rows:], segment.rotor_angle_rad if theta is None else theta[-rows:])
