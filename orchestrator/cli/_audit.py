"""`fluxbench audit`: somebody's flux map judged, drawn and repaired."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from orchestrator.cli._output import complain, say, say_document, say_notes
from orchestrator.config import load_motor
from orchestrator.estimation import save_flux_map
from orchestrator.flux_maps import (
    USES,
    MapAudit,
    Repair,
    UnknownLayoutError,
    audit_map,
    draw_audit,
    read_map,
    repair_map,
    suggest_mapping,
)
from orchestrator.formatting.quantities import UNKNOWN, number, percent, plural, quantity
from orchestrator.formatting.sentences import columns
from orchestrator.plain_files import read_text
from orchestrator.recording import read_model
from orchestrator.runs import open_any
from protocols import InputError, Motor


def audit(path: Path, motor_file: Path | None, repair: Path | None, picture: Path | None, as_json: bool) -> int:
    """Judge a map; where asked, write the nearest that a motor can have, and draw both."""
    if repair is not None and repair.suffix != ".nc":
        raise InputError(
            str(repair), "--repair", "expected a file that ends in .nc; `fluxbench export` makes others of it"
        )
    try:
        read = read_map(path)
    except UnknownLayoutError:
        return _suggest(path, as_json)
    motor = motor_of(path, motor_file)
    found = audit_map(read.flux_map, motor, read.torque_nm)
    repaired = None
    if repair is not None:
        repaired = repair_map(read.flux_map)
        save_flux_map(repair, repaired.flux_map, motor=motor.name if motor else "", recording=path.name)
    if picture is not None:
        draw_audit(picture, read.flux_map, found, repaired.flux_map if repaired else None)
    if as_json:
        document: dict[str, Any] = found.model_dump(mode="json")
        if repaired is not None:
            document["repair"] = _as_numbers(repaired, repair)
        say_document(json.dumps(document, indent=2))
        return 0
    _print(path, found)
    say_notes(remark.text for remark in read.remarks)
    if repaired is not None:
        _print_repair(repaired, found)
    say(*(f"written: {file}" for file in (repair, picture) if file is not None))
    return 0


def _suggest(path: Path, as_json: bool) -> int:
    """Print a mapping that reads the file; the exit code says that the map was not judged."""
    suggestion = suggest_mapping(path)
    if as_json:
        say_document(json.dumps({"mapping": suggestion.text, "doubts": suggestion.doubts}, indent=2))
    else:
        say_document(suggestion.text.rstrip())
    target = path.with_suffix(".yaml").name
    said = f"{path}: its names are no known layout; the mapping printed here reads it: save it beside the file, look at"
    complain(
        f"{said} each line (fluxbench audit {path.name} > {target}), then: fluxbench audit {target}", suggestion.doubts
    )
    return 2


def motor_of(path: Path, motor: Path | None) -> Motor | None:
    """The motor of a map, a mapping, a model or a run, or that of a file beside it; None where nothing tells it."""
    if motor is not None:
        return load_motor(motor)
    if path.suffix == ".json":
        return read_model(path).motor
    if path.suffix in (".yaml", ".yml"):
        return load_motor(path) if re.search(r"^motor:", read_text(path), re.MULTILINE) else None
    return open_any(path).manifest.motor if path.is_dir() else None


def _print(path: Path, found: MapAudit) -> None:
    d, q = found.nodes
    say(f"{path}: {plural(found.points, 'point')} on {d} x {q}, fluxes swing by {quantity(found.swing_wb, 'Wb')}", "")
    say(*columns(_rows(found)), "")
    if not found.faults:
        say("no fault found")
    for fault in found.faults:
        say(f"fault: {fault.remark.text}", f"       spoils {', '.join(USES[use] for use in fault.spoils)}")
    say_notes(remark.text for remark in found.remarks)


def _rows(found: MapAudit) -> list[tuple[str, str]]:
    per_axis = (found.parity_d_percent, found.parity_q_percent)
    parity = UNKNOWN if None in per_axis else f"d {percent(per_axis[0])}, q {percent(per_axis[1])} of the swing at most"
    gradient = (
        f"{percent(found.reciprocity_percent)} of the swing, rms; L_dq - L_qd {quantity(found.reciprocity_h, 'H')}"
    )
    torque = f"{number(found.torque_factor)} times, and {percent(found.torque_percent)} of the largest beside that"
    return [
        ("nearest gradient", gradient),
        ("parity", parity),
        ("best axis of symmetry", _degrees(found.axis_rad)),
        ("flux at zero current", UNKNOWN if found.magnet_wb is None else quantity(found.magnet_wb, "Wb", 4)),
        ("its direction", _degrees(found.magnet_rad)),
        ("least inductance", quantity(found.least_inductance_h, "H")),
        ("points that are not convex", str(len(found.non_convex))),
        ("holes", str(found.holes)),
        ("scatter of points", percent(found.roughness_percent)),
        ("file's torque over the fluxes'", UNKNOWN if found.torque_factor is None else torque),
    ]


def _degrees(angle_rad: float | None) -> str:
    return UNKNOWN if angle_rad is None else f"{number(round(angle_rad * 57.29577951308232, 3), 3)} degrees"


def _print_repair(repair: Repair, found: MapAudit) -> None:
    turned = f", turned by {_degrees(repair.turned_rad)}" if abs(repair.turned_rad) > 1e-9 else ""
    apart = (
        f"{percent(100.0 * repair.rms_wb / found.swing_wb)} of the swing away, rms, {quantity(repair.largest_wb, 'Wb')}"
    )
    say(f"repaired: the nearest convex and even energy's map is {apart} at most{turned}")


def _as_numbers(repair: Repair, path: Path | None) -> dict[str, Any]:
    return {
        "file": str(path),
        "turned_rad": repair.turned_rad,
        "rms_wb": repair.rms_wb,
        "largest_wb": repair.largest_wb,
    }
