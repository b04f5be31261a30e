"""Chooses a diagnosis's pictures for the page, their order and their captions. Draws nothing itself."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from orchestrator.formatting.events import step_error_v
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number, quantity, vector
from orchestrator.formatting.sentences import listed
from plugins.streams.report import _diagnosis_figures as figures
from plugins.streams.report._content import Picture
from protocols import CurrentExcerpt, DiagnosisReport, DiagnosisStep

if TYPE_CHECKING:
    from orchestrator.diagnosis import SavedDiagnosis
    from orchestrator.discovery import Discovery


def diagnosis_pictures(diagnosis: SavedDiagnosis) -> Iterator[Picture]:
    """The ladder first, then what the residual looks like, then the waveforms behind it."""
    ladder, floor = diagnosis.report.ladder, diagnosis.report.noise_floor.rms_v
    if ladder and floor:
        caption = (
            "Downwards: the error after each effect. Held out: stages that were not fitted. Noise floor of the fitted "
            f"stages: {quantity(floor, 'V')}."
        )
        yield Picture("The error ladder", caption, figures.ladder_figure(ladder, floor))
    if diagnosis.report.joint:
        yield _library(diagnosis.report)
    if diagnosis.steps:
        before, after = diagnosis.steps[0], diagnosis.steps[-1]
        yield from _residuals(before, after)
        yield from _waveforms(before, after)


def bare_pictures(step: DiagnosisStep) -> Iterator[Picture]:
    """What the residual of one model looks like, and the waveforms behind it."""
    yield from _residuals(step, step)
    yield from _waveforms(step, step)


def _library(report: DiagnosisReport, most: int = 7) -> Picture:
    """The effects that the joint fit is surest of, those of the model first, the largest part of the error first."""
    shares = {effect.name: effect.share or 0.0 for effect in (*report.effects, *report.minor)}
    order = sorted(report.joint, key=lambda entry: (-shares.get(entry.name, -1.0), -abs(entry.z or 0.0)))
    caption = (
        f"All effects fitted at once. From {figures.SURE_Z:g} standard deviations on (dashed) an effect is detected. "
        "Filled: added to the model; beside these, adding another one improves the fit too little. The table of what "
        "was left out states how large such an effect may be at most."
    )
    return Picture("The whole library, fitted together", caption, figures.joint_figure(order[:most], shares))


def learned_pictures(found: Discovery | None) -> Iterator[Picture]:
    """The curve of a law that was learned, with its band; none where no law was found, or none has a curve."""
    from orchestrator.discovery import curve_picture

    image = curve_picture(found) if found is not None and found.outcome == "law" else None
    if found is None or image is None:
        return
    laws = " ".join(f"{law.sentence} y = {law.forms[0].formula}." for law in found.laws)
    caption = (
        f"{laws} Held out, in units of noise: {number(found.before)} without it, {number(found.after)} with it. The "
        "band is the flexible curve's 95 %, the dashed line the formula."
    )
    if as_well := [one for law in found.laws for one in law.as_well]:
        caption += f" As well: {'; '.join(as_well)}."
    encoded = base64.b64encode(image).decode("ascii")
    yield Picture("The law that was learned", caption, f"data:image/svg+xml;base64,{encoded}")


def _residuals(before: DiagnosisStep, after: DiagnosisStep) -> Iterator[Picture]:
    gain = "" if before is after else f" After: with {_effects(after)}, {_error(before)} rms became {_error(after)}."
    first, last = figures.plane_figures(before, after)
    yield Picture(
        "Residual on the current plane",
        f"Both on one scale: rms in each cell as colour, mean as arrow.{gain}",
        first,
        "" if before is after else last,
    )
    first, last = figures.phase_figures(before, after)
    yield Picture(
        "Residual against each phase's own current",
        "The phases over each other, with medians; what a star connection hides (the zero sequence) is put back by "
        "one curve for all three. Where they fall together on one odd curve, the inverter is at fault.",
        first,
        "" if before is after else last,
    )


def _waveforms(before: DiagnosisStep, after: DiagnosisStep) -> Iterator[Picture]:
    grey = "" if before is after else " Grey: by the first model."
    for k, loop in enumerate(after.loops):
        if loop.swept_axis != "dq":
            caption = f"{loop.segment}, one period. Below: measured less model; up and down apart: a loop.{grey}"
            uri = figures.loop_figure(before.loops[k] if grey else None, loop)
            yield Picture(f"Flux loop on {loop.swept_axis}", caption, uri)
    ripple = [e for e in after.excerpts if e.amplitude_v is not None]
    if ripple:
        alone = [e for e in before.excerpts if e.amplitude_v is not None] if grey else []
        yield Picture("Ripple, measured and predicted", _ripple(ripple) + grey, figures.ripple_figure(ripple, alone))
    for k, excerpt in enumerate(after.excerpts):
        if excerpt.amplitude_v is None:
            caption = f"{excerpt.segment}: simulated from the voltage alone, from its first sample on.{grey}"
            uri = figures.trapezoid_figure(excerpt, before.excerpts[k] if grey else None)
            yield Picture("A sweep, measured and simulated", caption, uri)
    if after.resistance is not None and len(after.resistance.time_s) > 1:
        caption = f"The R_s that fits each hold and injection point, with the rest of the model as it is.{grey}"
        uri = figures.heat_figure(after.resistance, before.resistance if grey else None)
        yield Picture("R_s against the heat", caption, uri)


def _ripple(shown: Sequence[CurrentExcerpt]) -> str:
    at = vector(shown[0].i_d_a, shown[0].i_q_a)
    amplitudes = "One amplitude was injected." if len(shown) == 1 else "Two amplitudes part where the iron has memory."
    return f"Injected along d at (i_d, i_q) = {at}, per volt injected. {amplitudes} Below: measured less model."


def _effects(step: DiagnosisStep) -> str:
    return listed([plain(name) for name in step.effects]) or "the free map"


def _error(step: DiagnosisStep) -> str:
    return quantity(step_error_v(step), "V")
