"""`fluxbench tune`: what a drive needs, from the flux map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.formatting.sentences import columns, text_table
from orchestrator.interface import api
from orchestrator.interface.cli._output import say, say_document, say_notes
from orchestrator.interface.cli._refreshing import refresh_report

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
    pwm_hz: float | None,
    magnet_percent_per_k: float | None,
    effects: Path | None,
    as_json: bool,
) -> int:
    """Write references, gains, compensation and C code into a folder, and print the main figures."""
    limits = {
        "current_a": current_a,
        "bus_v": bus_v,
        "speed_rpm": speed_rpm,
        "sampling_hz": sampling_hz,
        "pwm_hz": pwm_hz,
    }
    folder = out or (path if path.is_dir() else path.parent) / "tuning"
    is_replaced = (folder / "tuning.json").is_file()
    report = api.tune(
        path, out=out, motor=motor, magnet_percent_per_k=magnet_percent_per_k, effects=effects or (), **limits
    )
    refresh_report(path, out)
    if as_json:
        say_document(report.model_dump_json(indent=2))
        return 0
    _print(report, folder)
    if is_replaced:
        say_notes(["an earlier tuning of this folder was replaced; --out keeps both"])
    return 0


def _print(report: TuningReport, folder: Path) -> None:
    from orchestrator.tuning.words import figure_rows, file_rows, headline, notes

    say(headline(report), "")
    say(text_table(("figure", "value"), figure_rows(report), numbers=False))
    say_notes(notes(report))
    say("", f"written into {folder}:", *(f"  {line}" for line in columns(file_rows(report))))
    code = next((name for name in report.files if name.endswith("_drive.c")), None)
    if code is not None:
        say(f"next: compile {code} with your firmware; the comment at the head of its .h shows a control period")
