"""Comparison and diagnosis in lines of text, alike in every view. Knows nothing of terminals."""

from __future__ import annotations

import math
from collections.abc import Iterator

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
    told = f"compared with the model {printable(report.model)}: chi2 {number(report.chi2)}"
    if report.worst:
        told += f", worst in {printable(report.worst[0].segment)} with {volts(report.worst[0].rms_v)}"
    return f"{told} rms where noise makes {volts(report.noise_floor.rms_v)}"


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
    told = message.report.verdict.replace("_", " ")
    return f"{told}, after experiment {message.round}" if message.round else told


def slot_rows(message: Diagnosed) -> Iterator[tuple[str, str]]:
    """The five slots that are filled, title and text."""
    for slot, title in SLOTS.items():
        text = getattr(message.words, slot)
        if text:
            yield title, printable(text)


def proposal_line(message: ExperimentProposed) -> str:
    """What would tell two effects apart."""
    first, second = (name.replace("_", " ") for name in message.separates)
    kind = printable(str(message.stage.get("kind")))
    goes_on = "and the run goes on with it" if message.accepted else "for another run"
    return f"next experiment: {kind}, {message.minutes:.2g} min, tells {first} from {second}; {goes_on}"


def volts(value: float | None) -> str:
    """Millivolts below one volt."""
    if value is None:
        return "-"
    return f"{1e3 * value:.3g} mV" if abs(value) < 0.9995 else f"{value:.3g} V"


def number(value: float | None) -> str:
    """Four digits, no powers of ten as far as that goes."""
    if value is None:
        return "-"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.3g}"
