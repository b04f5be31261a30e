"""Files of a diagnosis: diagnosis.json with report and text, diagnosis.npz with the data of figures.

Arrays are float32 without pickling; arrays that do not change between steps are written once.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from orchestrator.formatting.sentences import visible
from orchestrator.recording import replace_file
from orchestrator.validation.memory import require_memory
from orchestrator.validation.plain_files import read_bytes
from protocols import (
    CurrentExcerpt,
    DiagnosisReport,
    DiagnosisStep,
    DiagnosisWords,
    EstimationReport,
    FluxLoop,
    RecordingError,
    ResistanceCourse,
    StorageError,
)

REPORT_NAME = "diagnosis.json"
STEPS_NAME = "diagnosis.npz"

Content = TypeVar("Content")

_Arrays = dict[str, NDArray[Any]]
_DAMAGE = (AttributeError, EOFError, LookupError, OSError, RecursionError, TypeError, ValueError)
_META = "steps"


@dataclass(frozen=True)
class SavedDiagnosis:
    """A diagnosis read from a directory.

    Attributes
    ----------
    report : DiagnosisReport
    words : DiagnosisWords
    steps : tuple of DiagnosisStep
        The ladder; empty where only the report was saved.
    estimates : EstimationReport or None
        Its map and R_s among the estimators' results; None where it was loaded, or has none.
    """

    report: DiagnosisReport
    words: DiagnosisWords
    steps: tuple[DiagnosisStep, ...]
    estimates: EstimationReport | None = None


def save_diagnosis(
    directory: Path, report: DiagnosisReport, words: DiagnosisWords, steps: Sequence[DiagnosisStep]
) -> None:
    """Replace ``results/diagnosis.json`` and ``results/diagnosis.npz`` in a run or recording.

    Raises
    ------
    StorageError
        If they cannot be written.
    """
    results = directory / "results"
    try:
        results.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{results}: cannot be made: {error.strerror or error}") from error
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **_packed(steps))
    replace_file(results / STEPS_NAME, buffer.getvalue())
    content = {"report": report.model_dump(mode="json"), "words": words.model_dump(mode="json")}
    replace_file(results / REPORT_NAME, (visible(json.dumps(content, indent=1, ensure_ascii=False)) + "\n").encode())


def load_diagnosis(directory: Path) -> SavedDiagnosis | None:
    """The diagnosis that `save_diagnosis` wrote into a directory; None where there is none.

    Raises
    ------
    RecordingError
        If a file is damaged, or the two belong to different diagnoses.
    """
    path, drawn = directory / "results" / REPORT_NAME, directory / "results" / STEPS_NAME
    if not path.is_file():
        return None
    report, words = _guarded(path, lambda: _read_report(path))
    steps = _guarded(drawn, lambda: _unpacked(drawn)) if drawn.is_file() else ()
    ladder = [rung.added for rung in report.ladder]
    if steps and [step.added for step in steps] != ladder:
        raise RecordingError(str(drawn), _META, f"not of the diagnosis in {REPORT_NAME}: diagnose again")
    return SavedDiagnosis(report, words, steps)


def _read_report(path: Path) -> tuple[DiagnosisReport, DiagnosisWords]:
    content = json.loads(read_bytes(path))
    if not isinstance(content, dict):
        raise ValueError("expected an object with report and words")
    return DiagnosisReport.model_validate(content.get("report")), DiagnosisWords.model_validate(content.get("words"))


def _guarded(path: Path, read: Callable[[], Content]) -> Content:
    try:
        return read()
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise RecordingError(str(path), where, str(first["msg"])) from None
    except (*_DAMAGE, zipfile.BadZipFile, zlib.error) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise RecordingError(str(path), "", f"not a diagnosis that can be read: {reason}") from None


def _packed(steps: Sequence[DiagnosisStep]) -> _Arrays:
    arrays: _Arrays = {}
    plain = []
    before: _Arrays = {}
    for k, step in enumerate(steps):
        fields, now = _split(step)
        plain.append(fields)
        arrays.update({f"{k}.{name}": array for name, array in now.items() if not _same(before.get(name), array)})
        before = now
    return {_META: np.frombuffer(json.dumps(plain).encode(), dtype=np.uint8), **arrays}


def _same(before: NDArray[Any] | None, now: NDArray[Any]) -> bool:
    return before is not None and np.array_equal(before, now)


def _split(step: DiagnosisStep) -> tuple[dict[str, Any], _Arrays]:
    """The step's JSON fields, and its arrays by dotted name."""
    arrays: _Arrays = {}
    names = sorted(set(step.stage))
    codes = {name: code for code, name in enumerate(names)}
    fields = _without_arrays(step, "", arrays)
    fields |= {"stages": names}
    arrays["stage"] = np.array([codes[s] for s in step.stage], dtype=np.uint8)
    for group, items in (("excerpts", step.excerpts), ("loops", step.loops)):
        fields[group] = [_without_arrays(item, f"{group}.{k}.", arrays) for k, item in enumerate(items)]
    if step.resistance is not None:
        fields["resistance"] = _without_arrays(step.resistance, "resistance.", arrays)
    return fields, arrays


_NESTED = ("stage", "excerpts", "loops", "resistance")


def _without_arrays(model: BaseModel, prefix: str, arrays: _Arrays) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, np.ndarray):
            arrays[prefix + name] = value.astype(np.float32)
        elif name not in _NESTED or prefix:
            plain[name] = value
    return plain


def _unpacked(path: Path) -> tuple[DiagnosisStep, ...]:
    # numpy does not close a damaged file, so that it gets the bytes.
    with np.load(io.BytesIO(read_bytes(path)), allow_pickle=False) as archive:
        require_memory(path, sum(member.file_size for member in archive.zip.infolist()), "its arrays")
        meta = json.loads(archive[_META].tobytes().decode("utf-8"))
        steps = []
        arrays: _Arrays = {}
        for k, fields in enumerate(meta):
            prefix = f"{k}."
            arrays |= {n.removeprefix(prefix): archive[n] for n in archive.files if n.startswith(prefix)}
            steps.append(_joined(fields, arrays))
    return tuple(steps)


def _joined(fields: Mapping[str, Any], arrays: _Arrays) -> DiagnosisStep:
    def with_arrays(model: type[BaseModel], plain: Mapping[str, Any], prefix: str) -> dict[str, Any]:
        of_model = {n: arrays[prefix + n] for n in model.model_fields if prefix + n in arrays}
        return {**plain, **of_model}

    parts = dict(fields)
    names = parts.pop("stages")
    loops, shown = parts.pop("loops"), parts.pop("excerpts")
    course = parts.pop("resistance", None)
    parts = with_arrays(DiagnosisStep, parts, "")
    parts["stage"] = tuple(names[code] for code in arrays["stage"])
    parts["excerpts"] = tuple(
        CurrentExcerpt.model_validate(with_arrays(CurrentExcerpt, e, f"excerpts.{k}.")) for k, e in enumerate(shown)
    )
    parts["loops"] = tuple(
        FluxLoop.model_validate(with_arrays(FluxLoop, e, f"loops.{k}.")) for k, e in enumerate(loops)
    )
    if course is not None:
        parts["resistance"] = ResistanceCourse.model_validate(with_arrays(ResistanceCourse, course, "resistance."))
    return DiagnosisStep.model_validate(parts)
