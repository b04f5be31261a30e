"""`fluxbench export` and `fluxbench import`: maps for other tools, measurements from other tools."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from orchestrator.config import load_motor
from orchestrator.importing import ENDINGS, ImportReport, import_files, merge_recordings, read_drive
from orchestrator.importing.guessing import guess_mapping
from orchestrator.interface import api
from orchestrator.interface.cli._output import complain, say, say_document, say_notes
from protocols import InputError

YAML_ENDINGS = (".yaml", ".yml")


def export(path: Path, formats: Sequence[str], motor: Path | None, out: Path | None, as_json: bool) -> int:
    """Write the flux map of a run, recording or map file for other tools."""
    from orchestrator.flux_maps.exporting import FORMATS

    report = api.export(path, *formats, motor=motor, out=out)
    if report.caution:
        complain(report.caution)
    if as_json:
        say_document(report.model_dump_json(indent=2))
        return 0
    for file in report.files:
        say(f"{file.format}: {file.path}", f"  {FORMATS[file.format]}")
    say_notes(note for note in report.notes if note != report.caution)
    return 0


def require_import_files(files: Sequence[Path], *, has_out: bool) -> None:
    """Raise `InputError` where the mapping, which comes first, or the measurement is missing."""
    also = "" if has_out else ", and --out names the new folder"
    mappings = [path for path in files if path.suffix.lower() in YAML_ENDINGS]
    if files[0].suffix.lower() in ENDINGS:
        if mappings:
            problem = f"a measurement, not a mapping: the mapping comes first, {mappings[0]} {files[0]}{also}"
        else:
            problem = f"a measurement without its mapping: `fluxbench import --guess {files[0]}` writes one{also}"
        raise InputError(str(files[0]), "", problem)
    if len(files) < 2:
        raise InputError(str(files[0]), "", f"a mapping without a measurement: name the files after it{also}")


def import_(mapping: Path, files: Sequence[Path], out: Path, as_json: bool) -> int:
    """Turn measurements of another tool into a recording."""
    return _print_import(import_files(mapping, files, out), as_json)


def merge_import(recordings: Sequence[Path], out: Path, as_json: bool) -> int:
    """Merge several recordings into one."""
    return _print_import(merge_recordings(recordings, out), as_json)


def _print_import(report: ImportReport, as_json: bool) -> int:
    if as_json:
        say_document(report.model_dump_json(indent=2))
        return 0
    say(f"{report.recording}: {report.segments} segments, {report.samples} samples")
    if report.dropped_rows:
        why = ", ".join(f"{rows} ({why})" for why, rows in report.dropped_rows.items())
        say(f"dropped of {report.rows} rows: {why}")
    say_notes(report.notes)
    say(f"next: fluxbench diagnose {report.recording}   (or estimate, compare)")
    return 0


def guess_import(files: Sequence[Path], out: Path | None, motor: Path | None, as_json: bool) -> int:
    """Write the mapping for a measurement file, and print the lines to check."""
    if len(files) != 1:
        raise InputError("", "--guess", f"expected one measurement file, got {len(files)}")
    if files[0].is_dir():
        raise InputError(str(files[0]), "", "a folder; --guess expected one measurement file of it")
    if files[0].suffix.lower() in YAML_ENDINGS and files[0].is_file():
        problem = "a YAML file; --guess expected the measurement, and writes the mapping; --motor names a nameplate"
        raise InputError(str(files[0]), "", problem)
    target = out if out is not None else Path(files[0].with_suffix(".yaml").name)
    if target.exists():
        raise InputError(str(target), "", "exists already and is not overwritten: name another with --out")
    plate = None if motor is None else load_motor(motor).model_dump(exclude_defaults=True)
    guess = guess_mapping(files[0], plate, None if motor is None else read_drive(motor))
    try:
        target.write_text(guess.text, encoding="utf-8")
    except OSError as error:
        raise InputError(str(target), "", f"cannot be written: {error.strerror or error}") from None
    if as_json:
        say_document(json.dumps({"mapping": str(target), "doubts": guess.doubts}, indent=2))
        return 0
    say(f"{target}: check it, then: fluxbench import {target} {files[0]} --out DIR")
    say_notes(guess.doubts)
    return 0
