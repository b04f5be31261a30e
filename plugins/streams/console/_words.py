"""Numbers and names of a run in words, alike in every view. Knows nothing of terminals."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TextIO

from plugins.streams.console._progress import Point, Progress, StageProgress
from protocols import AxisPercent, EstimationReport, ResistanceEstimate, RunEnded

NAMES = {
    "gates_off": "sensors, gates off",
    "alignment": "alignment",
    "lock_check": "lock check",
    "resistance": "stator resistance",
    "classical": "classical sweep",
    "injection": "signal injection",
    "estimate": "estimation",
    "diagnose": "diagnosis",
    "operator": "operator",
}


ASCII = str.maketrans({"Ω": "ohm", "−": "-", "×": "x", "━": "=", "→": "->", "±": "+-"})


LONGEST_REMARK = 220
_MINUS = re.compile(r"(?<![\w.\-−)/])-(?=\.?\d)")


def can_draw(output: TextIO) -> bool:
    """Whether the output's encoding holds what the live display is drawn with."""
    try:
        "Ω−×✓━⠋".encode(output.encoding or "utf-8")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def typeset(text: str) -> str:
    """A sentence with ± and with true minus signs before its numbers."""
    return _MINUS.sub("−", text.replace("+-", "±"))


def shortened(text: str) -> str:
    """At most `LONGEST_REMARK` letters, cut between words; the whole of it is in the report."""
    if len(text) <= LONGEST_REMARK:
        return text
    return text[:LONGEST_REMARK].rsplit(" ", 1)[0].rstrip(" ,;:=±") + " ... (the whole is in the report)"


def printable(text: str) -> str:
    """One line without control characters: names come from outside, and go to a terminal."""
    return "".join(c if c.isprintable() else " " for c in text)


def duration(seconds: float) -> str:
    """Seconds as a person reads them: 7 s, 3:07, 1:02:09."""
    if seconds < 1.0:
        return "under 1 s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    hours, rest = divmod(whole, 3600)
    minutes, left = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{left:02d}" if hours else f"{minutes}:{left:02d}"


def time_left(progress: Progress) -> str:
    """What is left on the drive's clock, and on the wall where the two differ."""
    if progress.points and progress.points_done >= progress.points:
        return "all points measured"
    on_drive, on_wall = progress.left_s, progress.wall_left_s
    if on_wall is None:
        return f"{duration(on_drive)} left on the drive's clock"
    if abs(on_wall - on_drive) <= 0.2 * on_drive:
        return f"{duration(on_wall)} left"
    return f"{duration(on_wall)} left ({duration(on_drive)} on the drive's clock)"


def stage_title(progress: Progress, stage: StageProgress) -> str:
    """Which stage, of how many."""
    of = f" of {progress.stages}" if progress.stages else ""
    return f"stage {stage.index + 1}{of}, {NAMES.get(stage.name, stage.name.replace('_', ' '))}"


def state_name(state: str) -> str:
    return state.replace("_", " ")


def vector(point: Point) -> str:
    """(i_d, i_q) in amperes."""
    d, q = (round(value, 3) + 0.0 for value in point)  # + 0.0: a zero has no minus
    return f"({d:+.3f}, {q:+.3f}) A".replace("-", "−")


def resistance(estimate: ResistanceEstimate) -> str:
    """R_s with its 95 % interval."""
    return f"{estimate.value_ohm:.4g} Ω (95 %: {estimate.low:.4g} to {estimate.high:.4g})"


def plural(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def summary_rows(message: RunEnded) -> Iterator[tuple[str, str]]:
    """The end of a run as label and text, the most wanted first."""
    yield "outcome", f"{message.outcome}: {message.reason}" if message.reason else message.outcome
    if message.estimates is not None:
        yield from _estimate_rows(message.estimates)
    yield "run", message.run


def _estimate_rows(found: EstimationReport) -> Iterator[tuple[str, str]]:
    """What was estimated, what is said of it, and where it is kept."""
    if found.resistance is not None:
        r = found.resistance
        yield "R_s", f"{r.value_ohm:.4g} Ω (95 %: {r.low:.4g} to {r.high:.4g})"
    if found.method is not None:
        yield "map by", found.method
    yield "map usable", "yes" if found.usable else "no"
    by = BY_CONSTRUCTION if found.method in ENERGIES else ""
    for label, checked in (("crossings", found.crossings), ("parity", found.parity)):
        if checked is not None:
            yield label, _axes(checked) + (by if label == "parity" else "")
    if found.reciprocity_percent is not None:
        yield "reciprocity", f"{found.reciprocity_percent:.2g} %{by}"
    if found.classical_against_injection_percent is not None:
        yield "classical against injection", f"{found.classical_against_injection_percent:.2g} %"
    for number, remark in enumerate(found.remarks):
        yield "" if number else "remarks", shortened(typeset(remark.text))
    yield from sorted(found.files.items(), key=lambda file: (file[0] == "estimates", file[0]))


def _axes(value: AxisPercent) -> str:
    figures = (("d", value.d_percent), ("q", value.q_percent))
    return ", ".join(f"{axis} {figure:.2g} %" for axis, figure in figures if figure is not None) or "not measured"


ENERGIES = ("energy", "polynomial")
BY_CONSTRUCTION = " (by construction)"
