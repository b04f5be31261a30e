"""Chooses a diagnosis's pictures for the page, their order and their captions. Draws nothing itself."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from orchestrator.formatting.events import step_error_v
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number, quantity, vector
from orchestrator.formatting.sentences import listed
from plugins.streams.report import _diagnosis_figures as figures
from plugins.streams.report._content import Picture
from plugins.streams.report._motor_content import SAME_RESISTANCE_RATIO
from protocols import CurrentExcerpt, DiagnosisReport, DiagnosisStep, FluxLoop

if TYPE_CHECKING:
    from orchestrator.diagnosis import SavedDiagnosis
    from orchestrator.discovery import Discovery


SIGN = "Residual: the recording's voltage less the model's, v − (R_s i + dψ/dt)."
"""The sign of every picture of a residual; differences of currents and fluxes are measured less model, too."""


def diagnosis_pictures(diagnosis: SavedDiagnosis, present: DiagnosisStep | None = None) -> Iterator[Picture]:
    """The ladder first, then what the residual looks like, then the waveforms behind it.

    With `present`, the step of a model that was changed since, the pictures after are of that one.
    """
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
        yield from step_pictures(diagnosis.steps[0], present or diagnosis.steps[-1])


def step_pictures(before: DiagnosisStep, after: DiagnosisStep) -> Iterator[Picture]:
    """What the residual of a model looks like, or of two, and the waveforms behind it."""
    yield from _residuals(before, after)
    yield from _waveforms(before, after)


def _library(report: DiagnosisReport, most: int = 7) -> Picture:
    """The effects that the joint fit is surest of, those of the model first, the largest part of the error first."""
    shares = {effect.name: effect.share or 0.0 for effect in (*report.effects, *report.minor)}
    order = sorted(report.joint, key=lambda entry: (-shares.get(entry.name, -1.0), -abs(entry.z or 0.0)))
    whole = f"The {len(order)} effects of the library that this recording can tell apart, fitted at once"
    drawn = f"; drawn are those added and then the surest, {most} in all" if len(order) > most else ""
    caption = (
        f"{whole}{drawn}. From {figures.SURE_Z:g} standard deviations on (dashed) an effect is detected. Filled: added "
        "to the model. What is detected and was not added improves the fit too little; how large it may be at most "
        "(95 %, beside what was added) stands at its bar."
    )
    return Picture("The library, fitted together", caption, figures.joint_figure(order[:most], shares))


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


TAKEN_UP = (
    "Enlarged: the effects that were added adapt to what is still missing. After a step in all phases, a slope that "
    "differs from phase to phase leaves steps of both signs."
)
"""What a residual beside fitted effects shows."""


def _residuals(before: DiagnosisStep, after: DiagnosisStep) -> Iterator[Picture]:
    gain = (
        ""
        if before is after
        else f" After: with {_effects(after)}, {_error(before)} rms became {_error(after)}{_of(after)}."
    )
    panels = figures.plane_figures(before, after)
    yield Picture(
        "Residual on the current plane",
        f"{SIGN} rms in each cell as colour, mean as arrow.{gain}",
        panels.before,
        panels.after,
        panels.enlarged,
    )
    panels = figures.phase_figures(before, after)
    texts = [
        SIGN,
        "The three phases over each other, with their medians.",
        "Where few points lie, as near zero, the medians zigzag by chance.",
        _put_back(before, after),
        _pwm(after),
        _hidden_in_resistance(before, after),
        "" if before is after or not panels.enlarged else TAKEN_UP,
    ]
    yield Picture(
        "Residual against each phase's own current",
        " ".join(filter(None, texts)),
        panels.before,
        panels.after,
        panels.enlarged,
    )


def _put_back(before: DiagnosisStep, after: DiagnosisStep) -> str:
    """What was done about the zero sequence, and what one common curve means."""
    steps = {"before": before} if before is after else {"before": before, "after": after}
    is_one_curve = {name: figures.hidden_sequence(step) is not None for name, step in steps.items()}
    meaning = (
        "The phases fall together on one odd curve for example where the inverter is at fault, or where R_s rises with "
        "the winding's heat. Their slopes differ for example by unequal resistances or current sensors. Whole phases "
        "lie apart for example by a constant voltage or a sensor's offset."
    )
    hidden = "A star connection hides the voltage that all three have in common"
    if not any(is_one_curve.values()):
        return f"{hidden}; it is not drawn. {meaning}"
    which = next(name for name, is_one in is_one_curve.items() if is_one)
    where = "" if len(set(is_one_curve.values())) == 1 else f" in the picture {which}"
    return f"{hidden}; it is put back{where}, by the one curve that explains most of the residual. {meaning}"


def _pwm(step: DiagnosisStep) -> str:
    """The PWM frequencies of the recording, in words."""
    if step.pwm_frequency_hz is None or not len(step.pwm_frequency_hz):
        return ""
    every = np.unique(step.pwm_frequency_hz)
    if len(every) == 1:
        return f"PWM frequency: {quantity(float(every[0]), 'Hz')}."
    usual = every[np.argmax([np.count_nonzero(step.pwm_frequency_hz == one) for one in every])]
    others = listed([quantity(float(one), "Hz") for one in every if one != usual])
    return f"PWM at {quantity(float(usual), 'Hz')}, black marks at {others}: what is lost at each edge grows with it."


def _hidden_in_resistance(before: DiagnosisStep, after: DiagnosisStep) -> str:
    """What R_s, which is fitted too, takes of a residual along the current."""
    fitted = [_resistance_ohm(step) for step in (before, after)]
    if fitted[0] is None or fitted[1] is None:
        return ""
    if before is after:
        return "R_s is fitted too and takes up what is proportional to the current: a step is left as a sawtooth."
    if abs(fitted[0] / fitted[1] - 1.0) < SAME_RESISTANCE_RATIO:
        return ""
    before_ohm, after_ohm = (quantity(one, "ohm", 4) for one in fitted)
    return (
        f"R_s where the winding is coldest is {before_ohm} before and {after_ohm} after, as it takes up what is "
        "proportional to the current: a step is left as a sawtooth."
    )


def _resistance_ohm(step: DiagnosisStep) -> float | None:
    """The model's R_s where the winding is coldest."""
    course = step.resistance
    return None if course is None or not len(course.heat_j) else float(course.model_ohm[np.argmin(course.heat_j)])


def _waveforms(before: DiagnosisStep, after: DiagnosisStep) -> Iterator[Picture]:
    is_one = before is after
    for k, loop in enumerate(after.loops):
        if loop.swept_axis != "dq":
            first = before.loops[k]
            panels = figures.loop_figures(None if is_one else first, loop)
            errors = [f"{number(figures.loop_error(one), 2)} mWb" for one in (first, loop)]
            caption = f"{loop.segment}, one period. {_below('model', errors, is_one)} {_open_loop(loop)}"
            yield Picture(f"Flux loop on {loop.swept_axis}", caption, panels.before, panels.after)
    for k, loop in enumerate(after.loops):
        if loop.swept_axis == "q":
            panels = figures.evenness_figures(None if is_one else before.loops[k], loop)
            yield Picture(
                "Evenness in i_q",
                _evenness(before.loops[k], loop, is_one),
                panels.before,
                panels.after,
                panels.enlarged,
            )
    alone, ripple = ([e for e in step.excerpts if e.amplitude_v is not None] for step in (before, after))
    if ripple:
        panels = figures.ripple_figures([] if is_one else alone, ripple)
        errors = [f"{number(figures.ripple_error(one), 2)} mA/V" for one in (alone, ripple)]
        caption = f"{_ripple(ripple)} {_below('model', errors, is_one)}"
        yield Picture("Ripple, measured and predicted", caption, panels.before, panels.after)
    for earlier, excerpt in zip(before.excerpts, after.excerpts, strict=True):
        if excerpt.amplitude_v is None:
            panels = figures.sweep_figures(None if is_one else earlier, excerpt)
            errors = [f"{number(1e3 * figures.sweep_error(one), 2)} mA" for one in (earlier, excerpt)]
            caption = f"{excerpt.segment}: simulated from the voltage alone, from its first sample on."
            caption = f"{caption} {_below('simulated', errors, is_one)}"
            yield Picture("A sweep, measured and simulated", caption, panels.before, panels.after)
    if after.resistance is not None and len(after.resistance.time_s) > 1:
        panels = figures.heat_figures(None if is_one else before.resistance, after.resistance)
        scale = "" if is_one else " Each on scales of its own, as the heat, too, is computed with the model's R_s."
        caption = f"The R_s that fits each hold and injection point, with the rest of the model as it is.{scale}"
        yield Picture("R_s against the heat", caption, panels.before, panels.after)


def _open_loop(loop: FluxLoop) -> str:
    """What it means where rising and falling current do not fall together, beside what noise makes of it."""
    text = (
        "Rising and falling apart: a loop, for example of iron with memory, of a rotor that twists, or of a constant "
        "voltage error, which the integral sums."
    )
    if loop.noise_wb is None:
        return text
    apart = number(2e3 * loop.noise_wb, 2)
    return f"{text} The noise of the readings alone, integrated, moves them apart by up to {apart} mWb (95 %)."


def _evenness(first: FluxLoop, loop: FluxLoop, is_one: bool) -> str:
    """What an odd part of the flux across a sweep of q means, and how large it is.

    The measured flux is the corrected voltage's integral, so that it is another one before and after.
    """
    measured, of_model = (
        " before, ".join(f"{number(figures.unevenness(psi, loop.i_dq[:, 1]), 2)} mWb" for psi in both)
        + " after" * (not is_one)
        for both in (
            [one.psi_measured for one in ([loop] if is_one else [first, loop])],
            [one.psi_model for one in ([loop] if is_one else [first, loop])],
        )
    )
    corrected = "" if is_one else ", with the effects taken out of the voltage"
    return (
        f"{loop.segment}: the flux of the d axis while q is swept. A symmetric motor locked at the angle that the "
        "drive believes has the same on the left and on the right. A tilt is for example of the angle, of the slots or "
        f"of sensors that are unequal or have an offset. The odd part, rms: "
        f"measured {measured}{corrected}; model {of_model}."
    )


def _below(what: str, errors: Sequence[str], is_one: bool) -> str:
    """What the lower panels show; of two models, each on its own scale, with both sizes."""
    if is_one:
        return f"Below: measured less {what}, rms {errors[1]}."
    return f"Below: measured less {what}, each on a scale of its own: rms {errors[0]} before, {errors[1]} after."


def _ripple(shown: Sequence[CurrentExcerpt]) -> str:
    at = vector(shown[0].i_d_a, shown[0].i_q_a)
    amplitudes = (
        "One amplitude was injected."
        if len(shown) == 1
        else "Two amplitudes part where something is not proportional to them: iron with memory, and the step of an "
        "inverter's dead time or device drop, where the ripple crosses zero current."
    )
    return f"Injected along d at (i_d, i_q) = {at}, per volt injected. {amplitudes}"


def _effects(step: DiagnosisStep) -> str:
    return listed([plain(name) for name in step.effects]) or "the free map"


def _error(step: DiagnosisStep) -> str:
    return quantity(step_error_v(step), "V")


def _of(step: DiagnosisStep) -> str:
    """Which samples the errors are of, as a page states those of the fitted ones, too."""
    return "" if step.heldout_rms_v is None else ", both of the held-out stages alone"
