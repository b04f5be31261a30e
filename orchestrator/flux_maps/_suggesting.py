"""A mapping for a flux map's file with unknown column names, tried on the file, with a reason on each line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.flux_maps._arrays import READERS
from orchestrator.flux_maps._gridding import MapFile
from orchestrator.flux_maps._mapped import MapMapping, angle_unit, map_of
from orchestrator.flux_maps._tables import motor_evidence
from orchestrator.importing import CsvLayout, read_table
from orchestrator.importing.guessing import MapRoles, columns_of, map_unit, roles_of_map
from orchestrator.numerics.types import Array
from protocols import InputError

_MAX_CURRENT_A = 2000.0
"""Larger numbers count as milliamperes."""
_MAX_FLUX_WB = 20.0
"""Larger numbers count as milliwebers."""
_DIRECTIONS = (("q", 1.0), ("q", -1.0), ("d", 1.0), ("d", -1.0))
"""Possible zero axes of a current's angle, with the sign of its direction."""


@dataclass(frozen=True)
class MapSuggestion:
    """A mapping as text, the map that it reads, and its doubtful lines."""

    text: str
    doubts: tuple[str, ...]
    read: MapFile


@dataclass(frozen=True)
class _Contents:
    """Arrays or columns by name, and the layout of a text file."""

    arrays: dict[str, Array]
    units: Mapping[str, str]
    csv: CsvLayout
    why_csv: str


@dataclass(frozen=True)
class _Draft:
    """The keys of a mapping with a reason for each."""

    data: dict[str, Any]
    reasons: dict[str, str]
    doubts: tuple[str, ...] = ()
    read: MapFile | None = field(default=None)

    def having(self, key: str, value: object, why: str, doubt: str = "") -> _Draft:
        doubts = (*self.doubts, f"{key}: {doubt}") if doubt else self.doubts
        return replace(self, data=self.data | {key: value}, reasons=self.reasons | {key: why}, doubts=doubts)

    @property
    def text(self) -> str:
        import yaml

        def line(value: object) -> str:
            dumped = yaml.safe_dump(value, default_flow_style=True, width=10_000, allow_unicode=True, sort_keys=False)
            return str(dumped).strip().removesuffix("...").strip()

        return "\n".join(f"{key}: {line(value)}  # {self.reasons[key]}" for key, value in self.data.items()) + "\n"


def suggest_mapping(path: Path) -> MapSuggestion:
    """The mapping that reads a flux map's table, by its names and values.

    Raises
    ------
    InputError
        Where the columns' meaning is unknown, or they make no map.
    """
    names, contents = _names_of(path)
    roles = roles_of_map(names)
    if not roles.is_map:
        lacking = "flux linkages" if None in (roles.psi_d, roles.psi_q) else "currents"
        problem = f"the names do not show which columns are the {lacking}: write a mapping (docs/audit.md); it has"
        raise InputError(str(path), "", problem, names)
    chosen = [name for name in vars(roles).values() if name is not None]
    if contents.arrays:
        contents = replace(contents, arrays={name: contents.arrays[name].astype(np.float64) for name in chosen})
    else:
        contents = replace(contents, arrays=read_table(path, chosen, contents.csv))
    draft = _Draft({}, {}).having("format", "fluxbench-map", f"by the names and values in {path.name}")
    draft = draft.having("version", 1, "of the format").having("file", path.name, "beside this mapping")
    if contents.why_csv:
        layout = contents.csv.model_dump(exclude_defaults=True, mode="json")
        draft = draft.having("csv", layout, contents.why_csv) if layout else draft
    draft = _with_flux(draft, roles, contents)
    draft = _with_torque_and_angle(draft, roles, contents)
    best = max(_readable(path, _with_current(draft, roles, contents), contents), key=_likeness)
    assert best.read is not None  # candidates have been read
    text = best.text + "# motor: {name: NAME, pole_pairs: N}  # needed for a torque, or an angle of the shaft\n"
    return MapSuggestion(text, (*best.doubts, *(remark.text for remark in best.read.remarks)), best.read)


def _names_of(path: Path) -> tuple[list[str], _Contents]:
    read = READERS.get(path.suffix.lower())
    if read is None:
        columns = columns_of(path)
        layout = columns.layout
        csv, why = (CsvLayout(), "") if layout is None else (layout.csv, layout.why)
        return columns.names, _Contents({}, columns.units, csv, why)
    arrays = dict(_flattened("", read(path)))
    return list(arrays), _Contents(arrays, {}, CsvLayout(), "")


def _flattened(prefix: str, content: Mapping[str, Any]) -> list[tuple[str, Array]]:
    """Arrays of numbers by their names in a mapping: ``motor.psi_d`` is a field of a struct."""
    arrays: list[tuple[str, Array]] = []
    for key, value in content.items():
        if isinstance(value, Mapping):
            arrays += _flattened(f"{prefix}{key}.", value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.size > 1:
            arrays.append((f"{prefix}{key}", value))
    return arrays


def _with_flux(draft: _Draft, roles: MapRoles, contents: _Contents) -> _Draft:
    names = [str(roles.psi_d), str(roles.psi_q)]
    largest, given = _largest(contents, names), map_unit(names[0])
    unit = given or ("Wb" if largest <= _MAX_FLUX_WB else "mWb")
    why = "the name has the unit" if given else f"up to {largest:.3g}, as {unit}"
    section: dict[str, Any] = {"columns": {"d": names[0], "q": names[1]}, "unit": unit} | _scaling(names)
    return draft.having("flux", section, f"by the names; {why}", "" if given else f"{why}: the file names no unit")


def _with_current(draft: _Draft, roles: MapRoles, contents: _Contents) -> list[_Draft]:
    """A draft for each possible meaning of the currents."""
    polar = None in (roles.i_d, roles.i_q)
    names = [str(name) for name in ((roles.amplitude,) if polar else (roles.i_d, roles.i_q))]
    largest, given = _largest(contents, names), (contents.units.get(names[0], "").split() or [""])[0]
    unit = given if given in ("A", "mA", "uA", "kA") else "A" if largest <= _MAX_CURRENT_A else "mA"
    why = "the name has the unit" if given else f"up to {largest:.3g}, as {unit}"
    doubt = "" if given else f"{why}: the file names no unit"
    rest = {"unit": unit} | _scaling([*names, contents.units.get(names[0], "")])
    if not polar:
        section = {"columns": {"d": names[0], "q": names[1]}} | rest
        return [draft.having("current", section, f"by the names; {why}", doubt)]
    angle = str(roles.angle)
    degrees = angle_unit(contents.arrays[angle])
    drafts = []
    for zero, factor in _DIRECTIONS:
        turned: dict[str, Any] = {"unit": degrees, "zero": zero} | ({"factor": factor} if factor != 1.0 else {})
        section = {"columns": {"amplitude": names[0], "angle": angle}} | rest | {"angle": turned}
        reason = f"by the names; {why}; the angle begins where a motor's inductances are positive"
        drafts.append(draft.having("current", section, reason, doubt))
    return drafts


def _with_torque_and_angle(draft: _Draft, roles: MapRoles, contents: _Contents) -> _Draft:
    flux = contents.arrays[str(roles.psi_d)]
    if roles.torque is not None and contents.arrays[roles.torque].shape == flux.shape:
        given = map_unit(roles.torque)
        section = {"column": roles.torque, "unit": given or "Nm"}
        draft = draft.having("torque", section, "the name has the unit" if given else "by the name, as Nm")
    if roles.theta is not None and (flux.ndim == 3 or contents.arrays[roles.theta].shape == flux.shape):
        unit = contents.units.get(roles.theta, angle_unit(contents.arrays[roles.theta]))
        doubt = "electrical is assumed; for a shaft's angle add mechanical: true, and motor"
        draft = draft.having(
            "rotor_angle", {"column": roles.theta, "unit": unit}, "by the name; the mean is read", doubt
        )
    return draft


def _readable(path: Path, drafts: list[_Draft], contents: _Contents) -> list[_Draft]:
    """The drafts that read the file, each with its map; raises the first one's error where none does."""
    read: list[_Draft] = []
    first_error: InputError | None = None
    for draft in drafts:
        try:
            read.append(_with_map(path, draft, contents))
        except InputError as error:
            first_error = first_error or error
    if first_error is not None and not read:
        raise first_error
    return read


def _with_map(path: Path, draft: _Draft, contents: _Contents) -> _Draft:
    try:
        read = map_of(str(path), MapMapping.model_validate(draft.data), contents.arrays)
        axes = next((str(remark.values["axes"]) for remark in read.remarks if remark.code == "axes_by_values"), None)
        if axes is not None:
            draft = draft.having(
                "axes", axes.split(", "), "of one length: determined by inductances, which are positive"
            )
        return replace(draft, read=read)
    except InputError as error:
        if error.field != "axes":
            raise
        order = [*draft.data["current"]["columns"], *(["theta"] if "rotor_angle" in draft.data else [])]
        draft = draft.having(
            "axes", order, "a guess: it may be another order", f"{error.problem}; the first is written"
        )
        return replace(draft, read=map_of(str(path), MapMapping.model_validate(draft.data), contents.arrays))


def _likeness(draft: _Draft) -> float:
    """Similarity of a draft's map to a motor's."""
    assert draft.read is not None
    m = draft.read.flux_map
    i_d, i_q = np.meshgrid(np.asarray(m.i_d, dtype=np.float64), np.asarray(m.i_q, dtype=np.float64), indexing="ij")
    tables = [np.asarray(table, dtype=np.float64).ravel() for table in (m.psi_d, m.psi_q)]
    return motor_evidence(np.column_stack((i_d.ravel(), i_q.ravel())), np.column_stack(tables))


def _scaling(names: list[str]) -> dict[str, str]:
    return {"scaling": "rms"} if any(word in name.lower() for name in names for word in ("rms", "eff")) else {}


def _largest(contents: _Contents, names: list[str]) -> float:
    return max(float(np.nanmax(np.abs(contents.arrays[name]))) for name in names)
