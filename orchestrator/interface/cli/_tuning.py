"""`fluxbench tune`: what a drive needs, from the flux map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number, quantity
from orchestrator.formatting.sentences import listed
from orchestrator.interface import api
from orchestrator.interface.cli._output import say, say_document, say_notes, say_table

if TYPE_CHECKING:
    from orchestrator.tuning import TuningReport


def tune(
    path: Path,
    out: Path | None,
    motor: Path | None,
    current_a: float | None,
    bus_v: float | None,
    speed_rpm: float | None,
    sampling_hz: float | None,
    effects: Path | None,
    as_json: bool,
) -> int:
    """Write references, gains, compensation and C code into a folder, and print the main figures."""
    limits = {"current_a": current_a, "bus_v": bus_v, "speed_rpm": speed_rpm, "sampling_hz": sampling_hz}
    report = api.tune(path, out=out, motor=motor, effects=effects or (), **limits)
    if as_json:
        say_document(report.model_dump_json(indent=2))
        return 0
    _print(report, out or (path if path.is_dir() else path.parent) / "tuning")
    return 0


def _print(report: TuningReport, folder: Path) -> None:
    limits = f"{quantity(report.current_limit_a, 'A')} peak, {quantity(report.bus_v, 'V')} bus"
    say(f"{report.motor}: {limits}, control at {number(report.sampling_hz)} Hz", "")
    rows = [
        ("largest torque", f"{quantity(report.largest_torque_nm, 'Nm')}, up to {report.base_speed_rpm:.0f}/min"),
        (
            "at the largest speed",
            f"{quantity(report.torque_at_largest_speed_nm, 'Nm')} at {report.largest_speed_rpm:.0f}/min",
        ),
        (
            "current control",
            f"{number(report.bandwidth_hz)} Hz, phase margin {report.phase_margin_deg:.0f}° at standstill",
        ),
        ("... over the map's errors", f"at least {report.least_phase_margin_deg:.0f}°"),
        ("compensated", listed([plain(name) for name in report.compensated]) or "nothing"),
        ("inverter's loss", f"up to {quantity(report.lost_v, 'V')} a leg"),
        *_sensorless_rows(report),
    ]
    say_table(("figure", "value"), rows)
    say_notes(
        [
            *(remark.text for remark in report.remarks),
            *(f"not compensated: {plain(name)}, {reason}" for name, reason in report.left_out.items()),
        ]
    )
    say(f"written into {folder}: {', '.join(report.files)}")


def _sensorless_rows(report: TuningReport) -> list[tuple[str, str]]:
    share, error = report.injection_works_percent, report.injection_error_deg
    rows = []
    if share is not None:
        worst = "" if error is None else f", position off by up to {number(error)}°"
        rows.append(("injection tracks", f"in {share:.0f} % of the plane{worst}"))
    if report.injection_left_by_map_deg is not None:
        rows.append(("... compensated by the map", f"off by up to {number(report.injection_left_by_map_deg)}°"))
    warm, cold = report.observer_speed_warm_rpm, report.observer_speed_rpm
    if warm is None or cold is None:
        rows.append(("back-EMF observer", "not within 5° at any speed"))
    else:
        rows.append(("back-EMF observer", f"within 5° from {warm:.0f}/min, with R_s followed from {cold:.0f}/min"))
    return rows
