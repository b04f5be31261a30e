"""Merge recordings of one motor and drive: copies their captures and places their clocks one after the other."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from orchestrator.importing._importing import ImportReport, appearing_whole, check_readable
from orchestrator.recording import Recording, capture_path, open_recording, storage_error, write_manifest
from protocols import InputError, Segment


def merge_recordings(paths: Sequence[Path], out: Path) -> ImportReport:
    """Write the segments of recordings, in the order in which these are named, as one recording at `out`.

    A repeated id gets a number appended. The pause between two recordings is unknown: the next begins where the one
    before ended.

    Raises
    ------
    InputError
        Where there are fewer than two recordings, or motor, drive or sampling frequency differ.
    StorageError
        Where the merged recording cannot be written.
    """
    if len(paths) < 2:
        raise InputError("", "--merge", f"expected two recordings or more, got {len(paths)}")
    recordings = [open_recording(path) for path in paths]
    for recording in recordings[1:]:
        _check_alike(recordings[0], recording)
    with appearing_whole(out) as partial:
        segments = _copied(recordings, partial)
        manifest = recordings[0].manifest.model_copy(update={"segments": tuple(segments)})
        write_manifest(partial, manifest)
        check_readable(paths[0], partial)
    samples = sum(segment.samples for segment in segments)
    return ImportReport(
        recording=str(out),
        name=manifest.name,
        segments=len(segments),
        samples=samples,
        sampling_frequency_hz=manifest.drive.sampling_frequency_hz,
        rows=samples,
        dropped_rows={},
        notes=("what time passed between the recordings is not known (windings cool in it): the next begins at once",),
    )


def _check_alike(first: Recording, other: Recording) -> None:
    for part in ("motor", "drive"):
        one, another = (getattr(recording.manifest, part).model_dump() for recording in (first, other))
        for name, value in one.items():
            if another.get(name) != value:
                problem = f"{another.get(name)!r}, but {first.path} has {value!r}"
                raise InputError(str(other.path), f"{part}.{name}", problem[:200])


def _copied(recordings: Sequence[Recording], directory: Path) -> list[Segment]:
    merged: list[Segment] = []
    taken: set[str] = set()
    end_s = 0.0
    for recording in recordings:
        segments = recording.segments()
        late_s = end_s - segments[0].start_s if merged and segments else 0.0
        for segment in segments:
            name, times = segment.id, 1
            while name in taken:
                times += 1
                name = f"{segment.id}.{times}"
            taken.add(name)
            source, target = capture_path(recording.path, segment.id), capture_path(directory, name)
            try:
                target.parent.mkdir(exist_ok=True)
                shutil.copyfile(source, target)
            except OSError as error:
                raise storage_error(target, error) from None
            merged.append(segment.model_copy(update={"id": name, "start_s": segment.start_s + late_s}))
            end_s = max(end_s, merged[-1].start_s + segment.samples / recording.manifest.drive.sampling_frequency_hz)
    return merged
