"""`fluxbench audit`: a flux map checked, drawn and repaired."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

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
from orchestrator.interface.cli._output import complain, say, say_document, say_notes
from orchestrator.recording import read_model
from orchestrator.runs import open_any
from orchestrator.validation.plain_files import read_text
from protocols import InputError, Motor


def audit(path: Path, motor_file: Path | None, repair: Path | None, picture: Path | None, as_json: bool) -> int:
    """Check a map; if requested, write the nearest physically possible map and draw both."""
    if repair is not None and repair.suffix != ".nc":
        raise InputError(
            str(repair), "--repair", "expected a file that ends in .nc; `fluxbench export` converts it to other formats"
        )
    try:
        read = read_map(path)
    except UnknownLayoutError:
        return _suggest(path, as_json)
    motor = motor_of(path, motor_file)
    result = audit_map(read.flux_map, motor, read.torque_nm)
    repaired = None
    if repair is not None:
        repaired = repair_map(read.flux_map)
        save_flux_map(repair, repaired.flux_map, motor=motor.name if motor else "", recording=path.name)
    if picture is not None:
        draw_audit(picture, read.flux_map, result, repaired.flux_map if repaired else None)
    if as_json:
        document: dict[str, Any] = result.model_dump(mode="json")
        if repaired is not None:
            numbers = {name: getattr(repaired, name) for name in ("turned_rad", "rms_wb", "largest_wb")}
            document["repair"] = {"file": str(repair), **numbers}
        say_document(json.dumps(document, indent=2))
        return 0
    _print(path, result)
    say_notes(remark.text for remark in read.remarks)
    if repaired is not None:
        _print_repair(repaired, result)
    say(*(f"written: {file}" for file in (repair, picture) if file is not None))
    return 0


def _suggest(path: Path, as_json: bool) -> int:
    """Print a mapping that reads the file; the exit code shows that the map was not checked."""
    suggestion = suggest_mapping(path)
    if as_json:
        say_document(json.dumps({"mapping": suggestion.text, "doubts": suggestion.doubts}, indent=2))
    else:
        say_document(suggestion.text.rstrip())
    target = path.with_suffix(".yaml").name
    problem = f"{path}: unknown layout; the mapping printed here reads it: save it beside the file and check each line"
    complain(f"{problem} (fluxbench audit {path.name} > {target}), then: fluxbench audit {target}", suggestion.doubts)
    return 2


def motor_of(path: Path, motor: Path | None) -> Motor | None:
    """The motor of a map, a mapping, a model or a run, or of a file beside it; None where unknown."""
    if motor is not None:
        return load_motor(motor)
    if path.suffix == ".json":
        return read_model(path).motor
    if path.suffix in (".yaml", ".yml"):
        return load_motor(path) if re.search(r"^motor:", read_text(path), re.MULTILINE) else None
    return open_any(path).manifest.motor if path.is_dir() else None


def _print(path: Path, result: MapAudit) -> None:
    d, q = result.nodes
    say(
        f"{path}: {plural(result.points, 'point')} on {d} x {q}, range of the flux {quantity(result.swing_wb, 'Wb')}",
        "",
    )
    say(*columns(_rows(result)), "")
    if not result.faults:
        say("no fault found")
    for fault in result.faults:
        say(f"fault: {fault.remark.text}", f"       spoils {', '.join(USES[use] for use in fault.spoils)}")
    say_notes(remark.text for remark in result.remarks)


def _rows(result: MapAudit) -> list[tuple[str, str]]:
    nodes = math.prod(result.nodes)
    unmeasured = f"{nodes - result.points} of {nodes}, {result.holes} of them holes inside"
    per_axis = (result.parity_d_percent, result.parity_q_percent)
    parity = UNKNOWN if None in per_axis else f"d {percent(per_axis[0])}, q {percent(per_axis[1])} of the range at most"
    gradient = (
        f"{percent(result.reciprocity_percent)} of the range, rms; L_dq - L_qd {quantity(result.reciprocity_h, 'H')}"
    )
    torque = f"{number(result.torque_factor)} times, residual {percent(result.torque_percent)} of the largest torque"
    return [
        ("nearest gradient", gradient),
        ("parity", parity),
        ("best axis of symmetry", _degrees(result.axis_rad)),
        ("flux at zero current", UNKNOWN if result.magnet_wb is None else quantity(result.magnet_wb, "Wb", 4)),
        ("its direction", _degrees(result.magnet_rad)),
        ("smallest inductance", quantity(result.least_inductance_h, "H")),
        ("points that are not convex", str(len(result.non_convex))),
        ("grid points that were not measured", unmeasured),
        ("scatter of points", percent(result.roughness_percent)),
        ("torque of the file over that of the fluxes", UNKNOWN if result.torque_factor is None else torque),
    ]


def _degrees(angle_rad: float | None) -> str:
    return UNKNOWN if angle_rad is None else f"{number(round(math.degrees(angle_rad), 3), 3)} degrees"


def _print_repair(repair: Repair, result: MapAudit) -> None:
    turned = f", turned by {_degrees(repair.turned_rad)}" if abs(repair.turned_rad) > 1e-9 else ""
    rms, largest = percent(100.0 * repair.rms_wb / result.swing_wb), quantity(repair.largest_wb, "Wb")
    say(f"repaired: nearest map of a convex and even energy, {rms} of the range away, rms, {largest} at most{turned}")
