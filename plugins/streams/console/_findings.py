"""Comparison and diagnosis in lines of text, alike in every view. Knows nothing of terminals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from plugins.streams.console._words import printable
from protocols import Compared, Diagnosed, DiagnosisStep, ExperimentProposed

SLOTS = {
    "where_it_fails": "where it fails",
    "what_it_looks_like": "what it looks like",
    "likely_cause": "likely cause",
    "if_added": "if added",
    "to_decide": "to decide",
}
VERDICT_MARKS = {"clean": "good", "explained": "good", "mostly_explained": "warning", "unknown_remains": "bad"}
BAR = 24
"""Cells of a ladder's bar: from the noise to a thousand times as much."""
DECADES = 3.0


def comparison_line(message: Compared) -> str:
    """The bare model held against the recording."""
    report = message.report
    told = f"compared with the model {_text(report.get('model'))}: chi2 {number(report.get('chi2'))}"
    worst = report.get("worst")
    if isinstance(worst, list | tuple) and worst and isinstance(worst[0], Mapping):
        told += f", worst in {_text(worst[0].get('segment'))} with {volts(worst[0].get('rms_v'))}"
    floor = report.get("noise_floor")
    noise = floor.get("rms_v") if isinstance(floor, Mapping) else None
    return f"{told} rms where noise makes {volts(noise)}"


def step_name(step: DiagnosisStep) -> str:
    """What the rung added."""
    if step.added is not None:
        return f"+ {step.added.replace('_', ' ')}"
    return "the model alone" if step.index == 0 else "refitted"


def step_figures(step: DiagnosisStep) -> str:
    """chi2, rms and held-out rms of a rung."""
    told = f"chi2 {number(step.chi2):>7}  {volts(step.rms_v):>8}"
    return told if step.heldout_rms_v is None else f"{told}  held out {volts(step.heldout_rms_v):>8}"


def step_bar(step: DiagnosisStep) -> str:
    """The held-out error above the noise, three decades long."""
    error = step.rms_v if step.heldout_rms_v is None else step.heldout_rms_v
    if step.noise_rms_v <= 0.0 or error <= step.noise_rms_v:
        return ""
    return "━" * max(1, min(BAR, round(BAR / DECADES * math.log10(error / step.noise_rms_v))))


def verdict(message: Diagnosed) -> str:
    """The verdict as words."""
    told = _text(message.report.get("verdict")).replace("_", " ")
    return f"{told}, after experiment {message.round}" if message.round else told


def slot_rows(message: Diagnosed) -> Iterator[tuple[str, str]]:
    """The five slots that are filled, title and text."""
    for slot, title in SLOTS.items():
        text = message.words.get(slot)
        if text:
            yield title, printable(text)


def proposal_line(message: ExperimentProposed) -> str:
    """What would tell two effects apart."""
    first, second = (name.replace("_", " ") for name in message.separates)
    kind = _text(message.stage.get("kind"))
    goes_on = "and the run goes on with it" if message.accepted else "for another run"
    return f"next experiment: {kind}, {message.minutes:.2g} min, tells {first} from {second}; {goes_on}"


def volts(value: Any) -> str:
    """Millivolts below one volt."""
    if not isinstance(value, int | float):
        return "-"
    return f"{1e3 * value:.3g} mV" if abs(value) < 0.9995 else f"{value:.3g} V"


def number(value: Any) -> str:
    """Four digits, no powers of ten as far as that goes."""
    if not isinstance(value, int | float):
        return "-"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.3g}"


def _text(value: Any) -> str:
    return printable(str(value)) if value is not None else "-"
