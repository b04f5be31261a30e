"""Reads a `Procedure`: a shipped name or a file, a motor file laid over it, overrides."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from orchestrator.config._rated_limits import RATED_FIELDS, MotorLimits, add_rated_limits
from orchestrator.config._slips import nameplate_questions
from orchestrator.recording import has_recording
from orchestrator.registry.plugins import PluginKind, installed, load_plugin
from orchestrator.stages import parse_stages
from orchestrator.validation.messages import KeyPath, first_problem, missing_section, nearest, suggestion
from orchestrator.validation.plausibility import implausible
from orchestrator.validation.quantities import read_quantities
from orchestrator.validation.strict_yaml import Document, apply_override, parse_document, read_document
from protocols import (
    Acceptance,
    DriveChoice,
    InputError,
    Limits,
    Motor,
    Procedure,
    ProcedureError,
    ProcedureMotor,
    Stage,
    Strict,
    shipped_procedure,
    shipped_procedures,
)

BUS_OPTION = "dc_bus_voltage_v"
"""Option of a drive's plugin that states its bus voltage."""


class MotorFile(Strict):
    """A file for `--motor`: sections that replace the procedure's."""

    motor: ProcedureMotor
    limits: MotorLimits | None = None
    drive: DriveChoice | None = None
    accept: Acceptance | None = None


@dataclass(frozen=True)
class LoadedProcedure:
    """A procedure, and the file and line of each of its settings."""

    procedure: Procedure
    document: Document
    notes: tuple[str, ...] = ()
    """Conversions of quantities with a unit, and what follows from a motor file's nameplate, a sentence each."""

    @contextmanager
    def locating_errors(self) -> Iterator[None]:
        """Context in which errors of the procedure get file and line of their subject.

        A plan is scaled by the nameplate, so a question about the nameplate comes first: its answer mends the rest.
        """
        try:
            yield
        except InputError as error:
            if error.where == PluginKind.DRIVES.value:
                self._question_nameplate(error)
                raise
            prefix = {self.procedure.name: "", "drive": "drive."}.get(error.where)
            if prefix is None and not error.where.startswith("drive."):
                raise
            field = (f"{error.where}." if prefix is None else prefix) + error.field
            field = field.rstrip(".")
            posed = nameplate_questions(self.procedure.motor)
            questions = [question for question in posed if not question.startswith(f"{field}:")]
            if not questions:
                raise type(error)(self.document.place_of(field), field, error.problem) from None
            place = self.document.place_of(questions[0].split(" ")[0].rstrip(":"))
            as_written = f"As it is written, {field}: {error.problem}"
            raise type(error)(place, "", " ".join((*questions, as_written))) from None

    def _question_nameplate(self, error: InputError) -> None:
        """Raise the questions about a nameplate that a drive's plugin cannot be set up for; nothing without any."""
        if questions := list(nameplate_questions(self.procedure.motor)):
            place = self.document.place_of(questions[0].split(" ")[0].rstrip(":"))
            as_written = f"As it is written, the drive {error.field} {error.problem.partition(' (')[0]}"
            raise ProcedureError(place, "", " ".join((*questions, as_written))) from None


def load_procedure(
    source: str, *, overrides: Sequence[str] = (), drive: str | None = None, motor: Path | None = None
) -> Procedure:
    """Same as `read_procedure(...).procedure`."""
    return read_procedure(source, overrides=overrides, drive=drive, motor=motor).procedure


def read_procedure(
    source: str, *, overrides: Sequence[str] = (), drive: str | None = None, motor: Path | None = None
) -> LoadedProcedure:
    """Read a procedure and what replaces parts of it, in this order: motor, drive, overrides.

    Parameters
    ----------
    source : str
        Name of a shipped procedure, or path of a YAML file.
    overrides : sequence of str
        ``key.path=value`` each; list items by index, values written as in YAML.
    drive : str, optional
        A drive plugin's name instead of the procedure's; the options of another drive are dropped.
    motor : Path, optional
        YAML file whose sections ``motor`` and, where given, ``limits``, ``drive`` and ``accept`` replace the
        procedure's as a whole. Where the procedure's motor is an example, limits that the file leaves out follow from
        its nameplate, and a simulated drive forgets the example's plant. Where it is none, the procedure's energy and
        duration stay, and all its limits where the file has none.

    Raises
    ------
    ProcedureError
        One line: file and line, key path, what is wrong, the nearest valid name.
    """
    document = _read(source)
    example = None if motor is None else _example_limits(document)
    notes: list[str] = []
    overlay_sections: Collection[str] = ()
    if motor is not None:
        overlay = read_document(motor, ProcedureError)
        overlay_sections = overlay.data
        _lay_over(document, overlay, is_example=example is not None)
        if example is not None and "drive" not in overlay_sections:
            notes += _without_sealed_options(document)
    if drive is not None:
        _choose_drive(document, drive)
    for override in overrides:
        apply_override(document, override)
    if example is not None and "drive" not in overlay_sections:
        notes += _without_bus(document)
    notes += read_quantities(document)
    if example is not None:
        notes += add_rated_limits(document, example)
    procedure = _validated(document, {} if example is None else RATED_FIELDS)
    try:
        stages = parse_stages(procedure)
    except ProcedureError as error:
        raise ProcedureError(document.place_of(error.field), error.field, error.problem) from None
    _check_plugins(document, procedure.drive.name, stages)
    for path, problem in implausible(procedure, stages):
        raise ProcedureError(document.place(path), ".".join(map(str, path)), problem)
    return LoadedProcedure(procedure, document, tuple(notes))


def load_motor(path: str | PathLike[str]) -> Motor:
    """The ``motor`` section of a YAML file: a motor file, a procedure, or a mapping.

    Raises
    ------
    ProcedureError
        Where the section is missing or invalid.
    """
    document = read_document(Path(path), ProcedureError)
    read_quantities(document)
    raw = document.data.get("motor")
    if raw is None:
        raise ProcedureError(str(path), "motor", missing_section("motor", document.data))
    try:
        return ProcedureMotor.model_validate(raw)
    except ValidationError as error:
        problem = first_problem(error, ProcedureMotor, raw)
        raise ProcedureError(document.place(("motor", *problem.path)), f"motor.{problem.field}", problem.text) from None


def _read(source: str) -> Document:
    if source in shipped_procedures():
        return parse_document(shipped_procedure(source), f"{source}.yaml (shipped)")
    path = Path(source)
    if has_recording(path):
        problem = "is a run or recording, not a procedure; `fluxbench run --from` measures what its diagnosis proposes"
        raise ProcedureError(source, "", problem)
    if path.suffix in (".yaml", ".yml") or path.name != source or _is_file(path):
        document = read_document(path, ProcedureError)
        if "motor" in document.data and not {"format", "stages"} & document.data.keys():
            raise ProcedureError(source, "", f"a motor file instead of a procedure: give it as demo --motor {source}")
        return document
    listed, near = f"a shipped procedure ({', '.join(shipped_procedures())})", nearest(source, shipped_procedures())
    hint = "" if near is None else f"; did you mean {near!r}?"
    raise ProcedureError(source, "", f"neither a YAML file nor {listed}{hint}")


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that cannot be one, such as a very long one
        return False


def _example_limits(document: Document) -> dict[str, Any] | None:
    """The limits of a procedure whose motor is an example; None for another."""
    motor, limits = document.data.get("motor"), document.data.get("limits")
    is_example = isinstance(motor, dict) and motor.get("example") is True and isinstance(limits, dict)
    return limits if is_example else None


def _lay_over(document: Document, overlay: Document, *, is_example: bool) -> None:
    if "motor" not in overlay.data:
        is_bare = overlay.data.keys() & ProcedureMotor.model_fields.keys()
        where_it_belongs = ": the nameplate's fields belong below a line `motor:`"
        what = f"missing{where_it_belongs}" if is_bare else missing_section("motor", overlay.data)
        raise ProcedureError(overlay.name, "motor", what)
    for key, section in overlay.data.items():
        if key not in MotorFile.model_fields:
            problem = f"unknown section of a motor file; {suggestion(key, MotorFile.model_fields)}"
            raise ProcedureError(overlay.place((key,)), key, problem)
        places = {path: place for path, place in overlay.places.items() if path[0] == key}
        if key == "limits" and not is_example:
            section, places = _with_kept_limits(document, section, places)
        document.replace((key,), section, places)
    if is_example and "limits" not in overlay.data:
        document.replace(("limits",), {}, {("limits",): overlay.name})


def _without_sealed_options(document: Document) -> list[str]:
    """Drop what only a simulation knows of the example motor; says so."""
    drive = document.data.get("drive")
    if not isinstance(drive, dict) or drive.get("name") not in {info.name for info in installed(PluginKind.DRIVES)}:
        return []
    name = str(drive["name"])
    sealed = sorted(load_plugin(PluginKind.DRIVES, name).sealed_options & drive.keys())
    for option in sealed:
        del drive[option]
    return [
        f"drive.{option} is the example motor's and left out: drive {name} follows the nameplate" for option in sealed
    ]


def _without_bus(document: Document) -> list[str]:
    """That a simulated drive takes its bus from the nameplate, where a motor file states no drive."""
    drive = document.data.get("drive")
    if not isinstance(drive, dict) or drive.get("name") not in {info.name for info in installed(PluginKind.DRIVES)}:
        return []
    options = load_plugin(PluginKind.DRIVES, str(drive["name"])).Options.model_fields
    if BUS_OPTION not in options or options[BUS_OPTION].is_required() or BUS_OPTION in drive:
        return []
    return [
        f"drive.{BUS_OPTION} is not given: drive {drive['name']} takes the bus from the rated voltage (`check` prints "
        "it); state yours in a section drive"
    ]


def _with_kept_limits(document: Document, section: Any, places: dict[KeyPath, str]) -> tuple[Any, dict[KeyPath, str]]:
    """A motor file's limits; optional limits of the procedure stay in force."""
    own_limits = document.data.get("limits")
    if not isinstance(section, dict) or not isinstance(own_limits, dict):
        return section, places
    optional = {name for name, field in Limits.model_fields.items() if not field.is_required()}
    kept = [name for name in own_limits if name in optional and name not in section]
    section = section | {name: own_limits[name] for name in kept}
    return section, places | {("limits", name): document.place(("limits", name)) for name in kept}


def _choose_drive(document: Document, name: str) -> None:
    written = document.data.get("drive")
    if isinstance(written, dict) and written.get("name") == name:
        return
    where = f"--drive {name}"
    document.replace(("drive",), {"name": name}, {("drive",): where, ("drive", "name"): where})


def _validated(document: Document, rated_fields: Mapping[KeyPath, str]) -> Procedure:
    try:
        # JSON mode is strict about types ("5" and true are no numbers) and still takes lists for tuples.
        return Procedure.model_validate_json(json.dumps(document.data), strict=True)
    except ValidationError as error:
        problem = first_problem(error, Procedure, document.data)
    text = problem.text
    if problem.is_missing and problem.path in rated_fields:
        text += f": give it, or motor.{rated_fields[problem.path]}, from which it follows"
    if problem.is_missing and problem.path == ("format",):
        text += "; a procedure begins with `format: fluxbench-procedure` (`fluxbench procedures demo` prints one)"
    raise ProcedureError(document.place(problem.path), problem.field, text)


def _check_plugins(document: Document, drive: str, stages: Sequence[Stage]) -> None:
    _check_plugin(document, "drive.name", PluginKind.DRIVES, drive)
    for index, stage in enumerate(stages):
        for use in stage.uses():
            if use.name is not None:
                _check_plugin(document, f"stages.{index}.{use.field}", PluginKind(use.kind), use.name)


def _check_plugin(document: Document, field: str, kind: PluginKind, name: str) -> None:
    names = {info.name for info in installed(kind)}
    if name not in names:
        what = f"no {kind.value.removesuffix('s')} plugin {name!r} is installed; {suggestion(name, names)}"
        raise ProcedureError(document.place_of(field), field, what)
