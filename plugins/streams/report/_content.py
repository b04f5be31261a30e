"""The report's words and tables: from what was read to rows of text. Draws nothing, knows no HTML."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from orchestrator.formatting.events import describe
from orchestrator.formatting.names import MAP_QUANTITIES, OUTCOME_MOODS, PAPER_CROSSINGS, map_source, symbol_of
from orchestrator.formatting.quantities import duration, fixed, number, percent, plural, quantity, with_error
from orchestrator.formatting.results import coefficient_rows, objection_words
from orchestrator.formatting.sentences import listed, typographic
from orchestrator.numerics.tables import cubic_value_at
from plugins.streams.report._collect import Material
from protocols import AxisPercent, Basis, EstimationReport, FluxMap, Motor, SegmentStage, Usability

NOT_MEASURED = "not measured"
NO_FIGURE = "no figure"
"""In the place of a check's figure."""


@dataclass(frozen=True)
class Line:
    """One line of the summary."""

    label: str
    text: str
    mood: str = ""
    """"good", "warning", "bad" or nothing."""
    items: tuple[str, ...] = ()
    """A list below the text."""


@dataclass(frozen=True)
class Bar:
    """One figure of a check: as text, as a part of its bar, and where on the bar the limit is."""

    axis: str
    text: str
    part: float
    tick: float
    is_beyond: bool = False
    """Whether the figure is larger than the limit."""


@dataclass(frozen=True)
class Check:
    """One card: a check with its figures, and their limit or what would measure them."""

    name: str
    meaning: str
    bars: tuple[Bar, ...]
    limit: str


@dataclass(frozen=True)
class Event:
    """One row of the journal's table."""

    time: str
    kind: str
    text: str
    mood: str = ""


@dataclass(frozen=True)
class Picture:
    """A picture, or in its place the reason why there is none."""

    title: str
    caption: str
    uri: str = ""
    beside: str = ""
    """A second picture of the same, after; then the first one is before."""
    enlarged: str = ""
    """The second picture on a scale of its own, where it is too small on the first one's."""


def motor_of(material: Material) -> Motor | None:
    """The nameplate, from the manifest or from run.json."""
    if material.manifest is not None:
        return material.manifest.motor
    return material.record.procedure.motor if material.record is not None else None


def nameplate(motor: Motor) -> str:
    """The rated values on one line, as far as they are known."""
    rated = (
        (motor.rated_power_w, "W", ""),
        (motor.rated_voltage_rms_v, "V", " rms"),
        (motor.rated_current_rms_a, "A", " rms"),
        (motor.rated_speed_rpm, "rpm", ""),
        (motor.rated_torque_nm, "Nm", ""),
    )
    ratings = [quantity(value, unit, 5) + kind for value, unit, kind in rated if value is not None]
    return ", ".join([*ratings, plural(motor.pole_pairs, "pole pair")])


def summary(material: Material) -> Iterator[Line]:
    """The page's first dozen lines."""
    yield _outcome(material)
    yield from _map_lines(material)
    if material.lock is not None:
        locked = material.lock.locked
        yield Line(
            "Rotor", typographic(material.lock.summary), "info" if locked is None else "good" if locked else "bad"
        )
    if material.manifest is None:
        yield Line("Measured", NOT_MEASURED)
    else:
        segments = material.manifest.segments
        seconds = sum(s.samples for s in segments) / material.manifest.drive.sampling_frequency_hz
        yield Line("Measured", f"{plural(len(segments), 'segment')}, {duration(seconds)} of waveforms")


@dataclass(frozen=True)
class Remarks:
    """What the estimators say beside their numbers: on the recommended results, and on the other maps."""

    main: list[str]
    others: list[str]


def remarks(material: Material) -> Remarks:
    """The estimators' remarks; those on the maps that are not recommended apart."""
    report = material.estimates
    if report is None:
        return Remarks([], [])
    others = {name for name in report.maps if name != report.method}
    is_other = [remark.code.partition(".")[0] in others for remark in report.remarks]
    texts = [typographic(remark.text) for remark in report.remarks]
    main, rest = ([t for t, o in zip(texts, is_other, strict=True) if o is wanted] for wanted in (False, True))
    return Remarks(main, rest) if report.usable else Remarks([*main, *rest], [])


@dataclass(frozen=True)
class Formula:
    """A map that is a formula: its coefficients as rows of name, value, standard deviation."""

    method: str
    text: str
    rows: tuple[tuple[str, ...], ...]


def formulas(material: Material) -> Iterator[Formula]:
    """The maps that are formulas."""
    for method, report in material.estimates.maps.items() if material.estimates is not None else ():
        if report.form is not None:
            text = symbol_of(report.form.formula).replace("psi", "ψ").replace("^2", "²")
            yield Formula(method, text, tuple(coefficient_rows(report.form)))


def checks(material: Material) -> Iterator[Check]:
    """Self-consistency checks, each with its limit; crossings also beside what the paper prints of its own."""
    report = material.estimates
    if report is None:
        return
    parity, reciprocity, whose = _symmetry(report)
    limits = report.criteria
    paper = f"the paper’s: {percent(PAPER_CROSSINGS.d_percent)} on d, {percent(PAPER_CROSSINGS.q_percent)} on q"
    for name, meaning, value, limit, beside in (
        (
            "Crossings",
            "Largest flux difference where current paths cross, of the rated flux.",
            report.crossings or AxisPercent(d_percent=None, q_percent=None),
            limits.crossings_percent,
            f"; {paper}",
        ),
        (
            "Parity",
            f"Largest oddness of ψ_d and evenness of ψ_q in i_q, of the rated flux.{whose}",
            parity or AxisPercent(d_percent=None, q_percent=None),
            limits.parity_percent,
            "",
        ),
        (
            "Reciprocity",
            f"rms of ∂ψ_d/∂i_q − ∂ψ_q/∂i_d, of the mean inductance.{whose}",
            reciprocity,
            limits.reciprocity_percent,
            "",
        ),
        (
            "Classical against injection",
            "rms of the flux difference over the plane, of the rated flux: two methods, each with errors of its own.",
            report.classical_against_injection_percent,
            limits.accuracy_percent,
            "",
        ),
    ):
        bars = _bars(value, limit) if isinstance(value, AxisPercent) else (_bar("", value, limit),)
        is_known = any(bar.text != NO_FIGURE for bar in bars)
        text = f"tick: the limit, {percent(limit)}{beside}" if is_known else _what_measures(material, report, name)
        yield Check(name, meaning, bars, text)


def why_no_check(material: Material) -> str:
    """Why no check at all has a figure, where that is the same for all; empty otherwise."""
    every = list(checks(material))
    reasons = {check.limit for check in every}
    is_known = any(bar.text != NO_FIGURE for check in every for bar in check.bars)
    return "" if is_known or len(reasons) != 1 else reasons.pop()


_STAGES_OF_CHECKS = {
    "Crossings": (SegmentStage.CLASSICAL,),
    "Classical against injection": (SegmentStage.CLASSICAL, SegmentStage.INJECTION),
}
"""The stages without which a check has no figure; the others need a map with i_q of both signs."""


def _what_measures(material: Material, report: EstimationReport, name: str) -> str:
    """How a check that has no figure gets one: by a command, by a stage of the procedure, or not at all."""
    if not is_estimated(material):
        return f"`fluxbench estimate {typed(material)}` computes it from this recording"
    recorded = set() if material.manifest is None else {segment.stage for segment in material.manifest.segments}
    lacking = [stage.value for stage in _STAGES_OF_CHECKS.get(name, ()) if stage not in recorded]
    if lacking:
        return f"needs {listed([f'a stage {stage}' for stage in lacking])} in the procedure: this recording has none"
    return "this recording’s maps do not allow it"


def typed(material: Material) -> str:
    """The run as a command takes it from this folder; the name of one elsewhere, as a page does not tell its place."""
    place, here = material.directory.resolve(), Path.cwd()
    return shlex.quote(str(place.relative_to(here)) if place.is_relative_to(here) else place.name)


def _symmetry(report: EstimationReport) -> tuple[AxisPercent | None, float | None, str]:
    """Parity and reciprocity, and whose: an energy's map has both by construction, so those of another are shown."""
    best, other = report.recommended, report.measured_symmetry
    if best is None or best.basis is not Basis.ENERGY:
        return report.parity, report.reciprocity_percent, ""
    if other is None:
        return report.parity, report.reciprocity_percent, " The map’s formula, an energy, obeys it exactly."
    own = report.maps[other].checks
    return (
        own.parity,
        own.reciprocity_percent,
        f" Of the map by {other}: the formula of the map in use obeys it exactly.",
    )


def _bars(value: AxisPercent, limit: float) -> tuple[Bar, ...]:
    return tuple(_bar(axis, getattr(value, f"{axis}_percent"), limit) for axis in "dq")


def _bar(axis: str, value: float | None, limit: float) -> Bar:
    full = max(1.15 * (value or 0.0), 1.25 * limit) or 1.0
    text = NO_FIGURE if value is None else percent(value)
    is_beyond = value is not None and value > limit
    return Bar(axis, text, round(100.0 * (value or 0.0) / full, 1), round(100.0 * limit / full, 1), is_beyond)


def map_rows(grid: FluxMap, motor: Motor | None) -> list[list[str]]:
    """Fluxes and inductances with 95 % uncertainties at nine working points, as text."""
    reach = min(-grid.i_d[0], grid.i_d[-1], -grid.i_q[0], grid.i_q[-1])
    rated = motor.rated_current_a if motor is not None else None
    size = float(min(reach, rated)) if rated is not None else float(reach)
    rows: list[list[str]] = []
    for i_d in (-size, 0.0, size):
        for i_q in (-size, 0.0, size):
            point = [fixed(i_d, 2), fixed(i_q, 2)]
            row = point + [_with_error(grid, name, i_d, i_q) for name in MAP_QUANTITIES]
            if i_d == i_q == 0.0 and motor is not None and motor.pm_flux_wb is not None:
                row[len(point)] = f"{number(1e3 * motor.pm_flux_wb)} (nameplate)"
            if row not in rows:
                rows.append(row)
    return rows


def magnet_note(motor: Motor | None) -> str:
    """Where the flux of a map at zero current comes from, which a locked rotor does not show."""
    if motor is None or motor.pm_flux_wb is None:
        return "Every flux is counted from zero current: no magnet flux was given, and a locked rotor does not show it"
    return (
        "ψ(0, 0) is the nameplate's magnet flux, not measured: a locked rotor does not show it. An error of it is in "
        "every ψ_d; ± is of what was measured, ψ − ψ(0, 0)"
    )


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
    versions = record.provenance
    yield "fluxbench", versions.fluxbench
    if versions.git is not None:
        yield "source", f"{versions.git.sha}{' with changes' if versions.git.dirty else ''}"
    of: dict[str, list[str]] = {f"{p.distribution} {p.version}": [] for p in versions.plugins}
    for plugin in versions.plugins:
        of[f"{plugin.distribution} {plugin.version}"].append(plugin.name)
    yield "plugins", "; ".join(f"{which}: {', '.join(names)}" for which, names in of.items()) or "none"
    yield "machine", f"{versions.platform}, Python {versions.python}"
    yield "packages", ", ".join(f"{name} {version}" for name, version in versions.packages.items())


def events(material: Material) -> list[Event]:
    """What the journal says beside single points and bare states, the oldest first; twice the same is one event."""
    found: list[Event] = []
    for entry in material.journal:
        event = describe(entry.message)
        if (
            event is not None
            and event.text
            and (not found or (event.subject, event.text) != (found[-1].kind, found[-1].text))
        ):
            found.append(Event(_clock(entry.t), event.subject, event.text, event.mood))
    return found


def _outcome(material: Material) -> Line:
    if material.record is None:
        return Line("Run", "a recording that was not made by a run of fluxbench")
    ended = material.ended
    if ended is None:
        return Line("Run", "not ended: interrupted from outside, or still under way", "bad")
    return Line("Run", f"{ended.outcome}: {ended.reason}", OUTCOME_MOODS[ended.outcome])


def why_no_map(material: Material) -> str:
    """Why there is no flux map; with the command, where it was not tried."""
    if not is_estimated(material):
        return f"not estimated yet: `fluxbench estimate {typed(material)}`"
    return "no estimator could make one; their remarks say why"


def is_estimated(material: Material) -> bool:
    """Whether the estimators have run: results of a model alone, after `add`, are none of theirs."""
    report = material.estimates
    return report is not None and (report.model is None or report.estimators is not None)


_USES = {
    Usability.USABLE: ("usable", "good"),
    Usability.NOT_USABLE: ("not to be used", "bad"),
    Usability.NOT_JUDGED: ("not judged, for a diagnosis to decide", "warning"),
}
"""Sentence on the use of a map, and its mood."""


def _map_lines(material: Material) -> Iterator[Line]:
    report = material.estimates
    if report is None or report.method is None:
        yield Line("Flux map", why_no_map(material))
        return
    use, kind = _USES[report.usability]
    if not is_estimated(material):
        yield Line("Flux map", f"{use}: that of model.json; the estimators’ are {why_no_map(material)}", kind)
        return
    shown = material.maps.get(report.method)
    size = "" if shown is None else f", {len(shown.i_d)} × {len(shown.i_q)} currents"
    yield Line("Flux map", f"{use}: {map_source(report.method)}{size}", kind)
    if not report.usable:
        for place, remark in enumerate(report.remarks[:3]):
            yield Line("" if place else "because", objection_words(report, remark))


def inductance_line(material: Material) -> Iterator[Line]:
    """The three inductances over the plane, on one line."""
    report = material.estimates.recommended if material.estimates is not None else None
    if report is None or report.inductances is None:
        return
    range_, motor = report.inductances, motor_of(material)
    ranges = []
    for symbol, low, high, nameplate in (
        ("L_dd", range_.l_dd_low_h, range_.l_dd_high_h, motor.d_inductance_h if motor else None),
        ("L_qq", range_.l_qq_low_h, range_.l_qq_high_h, motor.q_inductance_h if motor else None),
    ):
        beside = "" if nameplate is None else f" (nameplate {quantity(nameplate, 'H', 4)})"
        ranges.append(f"{symbol} {quantity(low, 'H', 4)} to {quantity(high, 'H', 4)}{beside}")
    ranges.append(f"L_dq up to {quantity(range_.l_dq_largest_h, 'H')} in size")
    yield Line("Inductances", "; ".join(ranges))


def _with_error(grid: FluxMap, name: str, i_d: float, i_q: float) -> str:
    """Value and 95 % uncertainty in thousandths of the unit; not beyond the measured node nearest to it."""
    nearest = int(np.abs(grid.i_d - i_d).argmin()), int(np.abs(grid.i_q - i_q).argmin())
    axes, table, std = (grid.i_d, grid.i_q), getattr(grid, name), getattr(grid, f"{name}_std")
    value = cubic_value_at(axes, table, i_d, i_q) if np.isfinite(table[nearest]) else None
    return NOT_MEASURED if value is None else with_error(value, 1.96 * float(std[nearest]), -3)


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
