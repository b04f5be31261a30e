"""The page itself: words, tables and pictures into one HTML file that needs nothing beside it."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orchestrator.extras import require
from orchestrator.flux_maps.exporting import Trajectory, mtpa, mtpv
from orchestrator.formatting.drawing import BASIS_LINES
from orchestrator.formatting.explaining import accuracy_sentences, search_legend, search_rows
from orchestrator.formatting.names import MAP_QUANTITIES, VERDICTS, map_source, plain, slots
from orchestrator.formatting.quantities import percent, quantity
from orchestrator.formatting.sentences import cut, listed, typographic, visible
from orchestrator.recording import replace_file
from plugins.streams.report import _content as content
from plugins.streams.report import _diagnosis_content as findings
from plugins.streams.report import _figures as figures
from plugins.streams.report import _sensorless_content as sensorless
from plugins.streams.report._collect import Material, collect
from plugins.streams.report._content import Picture
from plugins.streams.report._diagnosis_pictures import diagnosis_pictures, learned_pictures, step_pictures
from plugins.streams.report._drive_content import drive_section
from plugins.streams.report._motor_content import (
    RESISTANCE_HEAD,
    TORQUE_HEAD,
    motor_lines,
    resistance_rows,
    torque_rows,
)
from plugins.streams.report._next_steps import next_steps
from protocols import Basis, FluxbenchError, FluxMap, Motor, RealArray, ResistanceEstimate

if TYPE_CHECKING:
    from markupsafe import Markup

FILE_NAME = "report.html"
INDUCTANCES = {
    "l_dd": "L_dd = ∂ψ_d/∂i_d",
    "l_qq": "L_qq = ∂ψ_q/∂i_q",
    "l_dq": "L_dq = ∂ψ_d/∂i_q = ∂ψ_q/∂i_d",
}


def write_report(directory: Path, out: Path | None = None, *, draws: bool = True, compares: bool = False) -> Path:
    """Make the report of a run directory, or of any recording that has been estimated.

    Parameters
    ----------
    directory : Path
        Read only: run.json, journal.jsonl, recording.json, captures/ and results/, as far as they are there.
    out : Path, optional
        The file to write; ``report.html`` in the directory where it is left out.
    draws : bool
        With its pictures, which take some seconds; else the page says how to have them.
    compares : bool
        Where there is no diagnosis: fit the bare model, and show where it fails. That names no effect.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    RecordingError
        Where the directory holds neither a run nor a recording.
    StorageError
        Where the file cannot be written.
    """
    page = render(collect(directory, reads_paths=draws, compares=draws and compares), draws=draws)
    target = out if out is not None else directory / FILE_NAME
    replace_file(target, page.encode("utf-8"))
    return target


def render(material: Material, *, draws: bool = True, most_events: int = 200) -> str:
    """The page as text, with so many rows of the journal."""
    motor = content.motor_of(material)
    main = next(iter(material.maps.values()), None)
    events = content.events(material)
    created = material.manifest.created if material.manifest is not None else ""
    stopped = f"Not drawn: the run was stopped. `fluxbench report {material.directory}` draws what was measured."
    return filled(
        "template.html",
        title=motor.name if motor is not None else material.directory.name,
        nameplate=content.nameplate(motor) if motor is not None else "",
        name=material.directory.resolve().name,
        created=content.date(created or (material.record.created if material.record is not None else "")),
        about=material.record.procedure.about.lines() if material.record is not None else [],
        typed=content.typed(material),
        now=next_steps(material),
        motor=list(motor_lines(material)),
        resistance_head=RESISTANCE_HEAD,
        resistances=resistance_rows(material),
        torque_head=TORQUE_HEAD,
        torque_rows=torque_rows(main, motor) if main is not None and motor is not None else [],
        summary=list(content.summary(material)),
        diagnosis=_diagnosis(material, draws=draws),
        bare=_bare(material),
        checks=list(content.checks(material)),
        why_no_check=content.why_no_check(material),
        why_no_map=content.why_no_map(material),
        finished=material.ended is not None and material.ended.outcome == "finished",
        remarks=content.remarks(material),
        sensorless={"head": sensorless.HEAD, "rows": sensorless.rows(material), "note": sensorless.note(material)},
        drive=drive_section(material, draws=draws),
        formulas=list(content.formulas(material)),
        pictures=list(_pictures(material, main)) if draws else [Picture("Pictures", stopped)],
        quantities=list(MAP_QUANTITIES.values()),
        magnet_note=content.magnet_note(motor),
        map_method=map_source(main.method).capitalize() if main is not None else "",
        map_rows=content.map_rows(main, motor) if main is not None else [],
        provenance=list(content.provenance(material)),
        events=events[:most_events],
        more_events=max(0, len(events) - most_events),
        problems=material.problems,
        files=_files(material),
    )


def filled(template: str, **values: Any) -> str:
    """A page of this folder with its values in it, in the style of all."""
    require("report", "a report")
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, finalize=_shown
    )
    environment.filters["with_code"] = _with_code
    text, style = ((files(__package__) / name).read_text(encoding="utf-8") for name in (template, "style.css"))
    return environment.from_string(text).render(style=Markup(style), **values)


def _with_code(text: str) -> Markup:
    """Text whose parts in backticks are set as code."""
    from markupsafe import Markup, escape

    parts = [escape(part) for part in visible(cut(text)).split("`")]
    if len(parts) % 2 == 0:  # a backtick without its other one
        return escape(visible(cut(text)))
    return Markup("").join(Markup("<code>{}</code>").format(part) if k % 2 else part for k, part in enumerate(parts))


def _shown(value: object) -> object:
    """What the template puts into the page: text from outside is cut, and nothing of it is obeyed."""
    return visible(cut(value)) if type(value) is str else value  # not markup, which is the page's own


def _diagnosis(material: Material, *, draws: bool) -> dict[str, Any] | None:
    """The diagnosis' part of the page; None where there was none."""
    diagnosis = material.diagnosis
    if diagnosis is None:
        return None
    report = diagnosis.report
    return {
        "verdict": VERDICTS[report.verdict],
        "heading": findings.heading(report.verdict),
        "reasons": [findings.squared(reason.sentence) for reason in report.reasons],
        # What is left to decide stands at the top of the page, as what to do now.
        "slots": [(title.capitalize(), text) for title, text in slots(diagnosis.words) if title != "to decide"],
        "accuracy": " ".join(accuracy_sentences(report)),
        "search": [tuple(map(findings.squared, row)) for row in search_rows(report.search)],
        "search_legend": [findings.squared(line) for line in search_legend(report.search)],
        "present": "" if material.present is None else findings.step_errors(material.present),
        "pictures": (
            [*diagnosis_pictures(diagnosis, material.present), *learned_pictures(material.discovery)] if draws else []
        ),
        "ladder": findings.ladder_rows(diagnosis, material.discovery, material.model_changes),
        "effects": findings.effect_rows(diagnosis),
        "alike": findings.alike_rows(diagnosis),
        "leftover": [(plain(s.group), percent(100.0 * (s.share or 0.0))) for s in report.unexplained.shape],
        "leftover_text": findings.leftover_text(diagnosis),
        "experiment": findings.experiment(diagnosis),
        "remarks": [typographic(remark.text) for remark in report.remarks],
    }


def _bare(material: Material) -> dict[str, Any] | None:
    """Where the bare model fails, and `model.json` after it, in numbers and pictures; None where not computed."""
    if material.bare is None:
        return None
    return {
        # The floor depends on the model a little: two of them would be one too many.
        "errors": findings.step_errors(material.bare, with_noise=material.present is None),
        "present": "" if material.present is None else findings.step_errors(material.present),
        "modelled": listed([plain(name) for name in material.modelled]),
        "pictures": list(step_pictures(material.bare, material.present or material.bare)),
        "effects": findings.signature_rows(),
    }


def _pictures(material: Material, main: FluxMap | None) -> Iterator[Picture]:
    yield _paths_picture(material)
    if not material.maps and not content.is_estimated(material):
        if material.readings:
            yield _resistance_picture(material)
        title = f"{'F' if material.readings else 'R_s, f'}luxes and inductances"
        yield Picture(title, f"Not drawn: {content.why_no_map(material)}.")
    else:
        yield from _estimated_pictures(material, main)
    if len(material.paths.temperature_c) > 1:
        text = "Mean of each segment of direct current, as recorded."
        yield Picture("Temperature over the run", text, figures.temperature_figure(material.paths.temperature_c))


def _estimated_pictures(material: Material, main: FluxMap | None) -> Iterator[Picture]:
    """R_s, fluxes and inductances; each says for itself why it is not drawn."""
    is_estimated = content.is_estimated(material)
    if is_estimated or material.readings:
        yield _resistance_picture(material)
    for axis, other in (("d", "q"), ("q", "d")):
        title = f"ψ_{axis} over i_{axis}, i_{other} held"
        known = {m: grid for m, grid in material.maps.items() if np.isfinite(grid.psi_d).any()}
        if not known:
            yield Picture(title, f"Not drawn: {content.why_no_map(material)}.")
        else:
            means = material.paths.injection
            held = means[:, "dq".index(other)] if len(means) else None
            caption = _methods_in_words(known) + _reach(means, known, axis)
            yield Picture(title, caption, figures.flux_figure(known, axis, held))
    if is_estimated:
        yield _difference_picture(material)
    for name, title in INDUCTANCES.items():
        if main is None or not np.isfinite(getattr(main, name)).any():
            why = (
                content.why_no_map(material) if main is None else f"the map {map_source(main.method)} does not have it"
            )
            yield Picture(title, f"Not drawn: {why}.")
        else:
            text = f"In mH, {map_source(main.method)}. White is outside what was measured."
            yield Picture(title, text, figures.inductance_figure(main, name))
    if main is not None and np.isfinite(main.psi_d).any():
        yield from _plane_pictures(main, content.motor_of(material))


def _plane_pictures(main: FluxMap, motor: Motor | None) -> Iterator[Picture]:
    """What follows from the map, over the current plane."""
    has_magnet = motor is not None and motor.pm_flux_wb is not None
    if motor is not None and has_magnet:
        best: list[Trajectory | None] = []
        for trajectory in (mtpa, mtpv):
            try:
                best.append(trajectory(main, motor.pole_pairs))
            except FluxbenchError:  # no point with i_q > 0, or one line of points alone
                best.append(None)
        lines = zip(best, ("per ampere (MTPA)", "per volt (MTPV)"), strict=True)
        drawn = [words for line, words in lines if line is not None and line.interior.any()]
        text = f"In Nm, with the largest torque {listed(drawn)}, as far as measured." if drawn else "In Nm."
        text = f"{text} The magnet's flux in it is the nameplate's."
        yield Picture("Torque", text, figures.torque_figure(main, motor.pole_pairs, best[0], best[1]))
    for axis in ("d", "q"):
        at_rest = " ψ(0, 0) is the nameplate's magnet flux." if axis == "d" and has_magnet else ""
        yield Picture(f"ψ_{axis} over the current plane", f"In mWb.{at_rest}", figures.flux_plane_figure(main, axis))
    if np.isfinite(main.l_dd * main.l_qq * main.l_dq).any():
        text = "Electrical degrees from the d axis to that of least inductance: what a tracking by injection is off by."
        yield Picture("Saliency angle", text, figures.saliency_figure(main))


def _paths_picture(material: Material) -> Picture:
    title, paths = "Currents that were reached", material.paths
    counts = {
        "injection points": len(paths.injection),
        "classical trajectories": len(paths.classical),
        "captures of voltage steps": len(paths.steps),
        "points of a rotor that turns": len(paths.spin),
    }
    parts = [f"{count} {what}" for what, count in counts.items() if count]
    if not parts:
        return Picture(title, "Not drawn: neither sweeps, steps nor points of injection are in the recording.")
    return Picture(title, f"{' and '.join(parts)}, as measured.", figures.paths_figure(paths))


def _resistance_picture(material: Material) -> Picture:
    title, readings = "R_s over the run", material.readings
    estimate = material.estimates.resistance if material.estimates is not None else None
    if not readings:
        return Picture(title, "Not drawn: there are no single readings over time.")
    values = [r.value_ohm for r in readings]
    interval = (min(values), max(values)) if estimate is None else (estimate.low, estimate.high)
    motor = content.motor_of(material)
    nameplate_ohm = motor.stator_resistance_ohm if motor is not None else None
    name = "$R_s$ at 0 s, 95 %" if estimate is not None and estimate.is_of_model else "estimate, 95 %"
    uri = figures.resistance_figure(readings, interval, nameplate_ohm, name)
    return Picture(title, f"{len(readings)} readings while the current was constant. {_band(estimate)}", uri)


def _band(estimate: ResistanceEstimate | None) -> str:
    """What the band of the picture of R_s is."""
    if estimate is None:
        return "Band: from the lowest reading to the highest."
    if estimate.is_of_model:
        return (
            "Band: the model's R_s at 0 s, before any current warms the winding, with its 95 %. The readings need not "
            "lie in it: they rise with the heat, and contain whatever else the model corrects."
        )
    return "Band: R_s over the whole run, with its 95 %."


def _difference_picture(material: Material) -> Picture:
    title = "Classical minus injection"
    classical, injection = (_first_by(basis, material.maps) for basis in (Basis.INTEGRATION, Basis.INJECTION))
    if classical is None or injection is None:
        methods = ("sweeps", classical), ("injection", injection)
        missing = listed([name for name, grid in methods if grid is None])
        return Picture(title, f"Not drawn: it needs the maps by both methods; there is none by {missing}.")
    caption = "Along the axes, each counted from zero current."
    return Picture(title, caption, figures.difference_figure(classical, injection))


def _first_by(basis: Basis, maps: dict[str, FluxMap]) -> FluxMap | None:
    return next((grid for grid in maps.values() if grid.basis is basis), None)


def _methods_in_words(maps: dict[str, FluxMap]) -> str:
    if _first_by(Basis.INTEGRATION, maps) is not None and _first_by(Basis.INJECTION, maps) is not None:
        others = [name for name, grid in maps.items() if grid.basis not in BASIS_LINES]
        dotted = f" Dotted: {', '.join(others)}." if others else ""
        return f"Dashed: classical, solid: injection, with its 95 % band.{dotted} Counted from zero current."
    return f"By {', '.join(maps)} alone. Counted from zero current."


def _reach(means: RealArray, maps: dict[str, FluxMap], axis: str) -> str:
    """How far the mean currents go along an axis, and the ripple beyond them, which the maps reach."""
    if not len(means):
        return ""
    column = "dq".index(axis)
    known = [
        np.asarray(getattr(grid, f"i_{axis}"))[np.isfinite(grid.psi_d).any(axis=1 - column)] for grid in maps.values()
    ]
    largest, ripple = (float(np.abs(currents).max()) for currents in (means[:, column], np.concatenate(known)))
    if ripple < 1.05 * largest:
        return ""
    held, reached = quantity(largest, "A", 2), quantity(ripple, "A", 2)
    return f" i_{axis} was held at up to {held}; with the ripple it reached {reached}."


def _files(material: Material) -> list[str]:
    """What lies in results/, by its path in the directory."""
    folder = material.directory / "results"
    return sorted(f"results/{f.name}" for f in folder.iterdir() if f.is_file()) if folder.is_dir() else []
