"""The report's words and tables: from what was read to rows of text. Draws nothing, knows no HTML."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from plugins.streams.report._collect import Material
from protocols import (
    AxisPercent,
    FluxMap,
    LockChecked,
    Message,
    Motor,
    Note,
    OperatorAnswered,
    OperatorAsked,
    ResistanceEstimated,
    RunEnded,
    RunStarted,
    StageStarted,
    StateChanged,
)

NOT_MEASURED = "not measured"
PAPER = AxisPercent(d_percent=1.3, q_percent=2.9)
"""Largest flux difference where current paths cross, as the paper prints it."""
MOST_EVENTS = 200
QUANTITIES = (("psi_d", "mWb"), ("psi_q", "mWb"), ("l_dd", "mH"), ("l_dq", "mH"), ("l_qq", "mH"))


@dataclass(frozen=True)
class Line:
    """One line of the summary."""

    label: str
    text: str
    mood: str = ""
    """"good", "bad" or nothing."""


@dataclass(frozen=True)
class Check:
    """One row of the table of checks."""

    name: str
    meaning: str
    d: str
    q: str
    paper: str


@dataclass(frozen=True)
class Event:
    """One row of the journal's table."""

    time: str
    kind: str
    text: str
    mood: str = ""


def motor_of(material: Material) -> Motor | None:
    """The nameplate, from the manifest or from run.json."""
    if material.manifest is not None:
        return material.manifest.motor
    return material.record.procedure.motor if material.record is not None else None


def nameplate(motor: Motor) -> str:
    """The rated values on one line, as far as they are known."""
    rated = (
        (motor.rated_power_w, "{:g} W"),
        (motor.rated_voltage_rms_v, "{:g} V rms"),
        (motor.rated_current_rms_a, "{:g} A rms"),
        (motor.rated_speed_rpm, "{:g} rpm"),
        (motor.rated_torque_nm, "{:g} Nm"),
    )
    told = [text.format(value) for value, text in rated if value is not None]
    return ", ".join([*told, f"{motor.pole_pairs} pole {'pair' if motor.pole_pairs == 1 else 'pairs'}"])


def summary(material: Material) -> Iterator[Line]:
    """The page's first dozen lines."""
    yield _outcome(material)
    yield _resistance(material)
    yield from _map_lines(material)
    yield from _check_lines(material)
    yield from _saturation_lines(material)
    if material.lock is not None:
        locked = material.lock.locked
        yield Line("Rotor", material.lock.summary, "good" if locked else "bad")
    yield _amount(material)


def checks(material: Material) -> Iterator[Check]:
    """Checks that need no truth, beside what the paper prints of its own."""
    found = material.estimates
    if found is None:
        return
    rows = (
        ("Crossings", "largest flux difference where current paths cross", found.crossings, PAPER),
        ("Parity", "largest oddness of ψ_d and evenness of ψ_q in i_q", found.parity, None),
    )
    for name, meaning, value, paper in rows:
        d, q = (_percent(getattr(value, f"{axis}_percent", None)) for axis in "dq")
        told = "none printed" if paper is None else f"d {_percent(paper.d_percent)}, q {_percent(paper.q_percent)}"
        yield Check(name, meaning, d, q, told)
    singles = (
        ("Reciprocity", "rms of ∂ψ_d/∂i_q − ∂ψ_q/∂i_d against the mean inductance", found.reciprocity_percent),
        (
            "Classical against injection",
            "rms of the flux difference over the plane",
            found.classical_against_injection_percent,
        ),
    )
    for name, meaning, percent in singles:
        yield Check(name, meaning, _percent(percent), "", "none printed")


def map_rows(found: FluxMap, motor: Motor | None) -> list[list[str]]:
    """Fluxes and inductances with 95 % uncertainties at nine working points, as text."""
    reach = min(-found.i_d[0], found.i_d[-1], -found.i_q[0], found.i_q[-1])
    rated = motor.rated_current_a if motor is not None else None
    size = float(min(reach, rated)) if rated is not None else float(reach)
    rows: list[list[str]] = []
    for i_d in (-size, 0.0, size):
        for i_q in (-size, 0.0, size):
            d, q = int(np.abs(found.i_d - i_d).argmin()), int(np.abs(found.i_q - i_q).argmin())
            point = [_fixed(float(found.i_d[d]), 2), _fixed(float(found.i_q[q]), 2)]
            row = point + [_with_error(found, name, d, q) for name, _ in QUANTITIES]
            if row not in rows:
                rows.append(row)
    return rows


def provenance(material: Material) -> Iterator[tuple[str, str]]:
    """Where the run comes from, label and text."""
    record = material.record
    if material.manifest is not None:
        manifest = material.manifest
        yield "recording", f"{manifest.name}, {manifest.created}"
        yield "drive", f"{manifest.drive.name}, {manifest.drive.sampling_frequency_hz:g} Hz sampling"
    if record is None:
        return
    yield "procedure", f"{record.name}, SHA-256 {record.procedure_sha256}"
    yield "seed", str(record.seed)
    if record.sealed:
        yield "sealed options", ", ".join(record.sealed)
    made = record.provenance
    yield "fluxbench", made.fluxbench
    if made.git is not None:
        yield "source", f"{made.git.sha}{' with changes' if made.git.dirty else ''}"
    yield "plugins", ", ".join(f"{p.name} ({p.distribution} {p.version})" for p in made.plugins) or "none"
    yield "host", f"{made.host}, {made.platform}, Python {made.python}"
    yield "packages", ", ".join(f"{name} {version}" for name, version in made.packages.items())


def events(material: Material) -> list[Event]:
    """What the journal says beside single points, the oldest first."""
    found: list[Event] = []
    for entry in material.journal:
        kind, text, mood = _event(entry.message)
        if kind:
            found.append(Event(_clock(entry.t), kind, text, mood))
    return found


def _outcome(material: Material) -> Line:
    if material.record is None:
        return Line("Run", "a recording that was not made by a run of fluxbench")
    ended = material.ended
    if ended is None:
        return Line("Run", "not ended: interrupted from outside, or still under way", "bad")
    return Line("Run", f"{ended.outcome}: {ended.reason}", "good" if ended.outcome == "finished" else "bad")


def _resistance(material: Material) -> Line:
    found = material.estimates.resistance if material.estimates is not None else None
    if found is None:
        return Line("R_s", NOT_MEASURED)
    motor = motor_of(material)
    nameplate = motor.stator_resistance_ohm if motor is not None else None
    beside = "" if nameplate is None else f"; nameplate {nameplate:.4g} Ω"
    drift = f"; {found.first_ohm:.4g} Ω at the start, {found.last_ohm:.4g} Ω at the end"
    return Line("R_s", f"{found.value_ohm:.4g} Ω (95 %: {found.low:.4g} to {found.high:.4g}){drift}{beside}")


def _map_lines(material: Material) -> Iterator[Line]:
    found = material.estimates
    if found is None or found.method is None:
        yield Line("Flux map", NOT_MEASURED)
        return
    shown = material.maps.get(found.method)
    size = "" if shown is None else f", {len(shown.i_d)} × {len(shown.i_q)} currents"
    yield Line("Flux map", f"by {found.method}{size}")
    yield Line("Usable", "yes" if found.usable else "no", "good" if found.usable else "bad")
    for number, reason in enumerate(found.reasons):
        yield Line("" if number else "Remarks", reason)


def _check_lines(material: Material) -> Iterator[Line]:
    found = material.estimates
    if found is None:
        return
    paper = f"the paper's: {_pair(PAPER)}"
    yield Line("Crossings", f"{_pair(found.crossings)} ({paper})")
    yield Line("Parity", _pair(found.parity))
    yield Line("Reciprocity", _percent(found.reciprocity_percent))
    yield Line("Classical against injection", _percent(found.classical_against_injection_percent))


def _saturation_lines(material: Material) -> Iterator[Line]:
    if not material.maps:
        return
    found = next(iter(material.maps.values()))
    motor = motor_of(material)
    for axis, name, nameplate in (
        ("d", "l_dd", motor.d_inductance_h if motor else None),
        ("q", "l_qq", motor.q_inductance_h if motor else None),
    ):
        values = np.asarray(getattr(found, name))
        if np.isfinite(values).any():
            beside = "" if nameplate is None else f"; nameplate {1e3 * nameplate:.4g} mH"
            low, high = float(np.nanmin(values)), float(np.nanmax(values))
            yield Line(f"L_{axis}{axis}", f"{1e3 * low:.4g} to {1e3 * high:.4g} mH over the plane{beside}")
    if np.isfinite(found.l_dq).any():
        yield Line("L_dq", f"up to {1e3 * float(np.nanmax(np.abs(found.l_dq))):.3g} mH in size")


def _amount(material: Material) -> Line:
    if material.manifest is None:
        return Line("Measured", NOT_MEASURED)
    segments = material.manifest.segments
    seconds = sum(s.samples for s in segments) / material.manifest.drive.sampling_frequency_hz
    return Line("Measured", f"{len(segments)} segments, {seconds:.0f} s of waveforms")


def _event(message: Message) -> tuple[str, str, str]:
    if isinstance(message, RunStarted):
        return "start", f"{message.points} points, {message.points_done} of them done before", ""
    if isinstance(message, StageStarted):
        return "stage", f"{message.stage.replace('_', ' ')}, {message.points} points", ""
    if isinstance(message, StateChanged):
        mood = "bad" if message.target in ("faulted", "aborted") else ""
        reason = f": {message.reason}" if message.reason else ""
        return "state", f"{message.target.replace('_', ' ')}{reason}", mood
    if isinstance(message, OperatorAsked):
        return "operator", message.prompt, ""
    if isinstance(message, OperatorAnswered):
        return "operator", f"{message.answer} (by {message.by})", ""
    if isinstance(message, LockChecked):
        return "lock check", message.summary, "good" if message.locked else "bad"
    if isinstance(message, ResistanceEstimated):
        return "R_s", f"{message.estimate.value_ohm:.4g} Ω", ""
    if isinstance(message, Note):
        return message.level, message.text, "bad" if message.level == "error" else ""
    if isinstance(message, RunEnded):
        return "end", f"{message.outcome}: {message.reason}", "good" if message.outcome == "finished" else "bad"
    return "", "", ""


def _with_error(found: FluxMap, name: str, d: int, q: int) -> str:
    """Value and 95 % uncertainty in thousandths of the unit, as many digits as the uncertainty bears."""
    value = 1e3 * float(getattr(found, name)[d, q])
    error = 1.96e3 * float(getattr(found, f"{name}_std")[d, q])
    if not np.isfinite(value):
        return NOT_MEASURED
    if not np.isfinite(error) or error <= 0.0:
        return f"{value:.4g}".replace("-", "−")
    digits = max(0, min(3, 1 - int(np.floor(np.log10(error)))))
    beside = f" ± {error:.{digits}f}" if round(error, digits) > 0.0 else ""
    return _fixed(value, digits) + beside


def _fixed(value: float, digits: int) -> str:
    """So many digits after the point, a true minus sign, and no minus before a zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "−")


def _percent(value: float | None) -> str:
    return NOT_MEASURED if value is None else f"{value:.2g} %"


def _pair(value: AxisPercent | None) -> str:
    if value is None:
        return NOT_MEASURED
    return f"d {_percent(value.d_percent)}, q {_percent(value.q_percent)}"


def date(text: str) -> str:
    """A time in ISO 8601 as date and time of day; as it is where it is none."""
    try:
        return datetime.fromisoformat(text).astimezone(UTC).strftime("%Y-%m-%d %H:%M UTC")
    except ValueError:
        return text


def _clock(text: str) -> str:
    try:
        return datetime.fromisoformat(text).strftime("%H:%M:%S")
    except ValueError:
        return text
