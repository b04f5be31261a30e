"""What a diagnosis shows: each rung of the error ladder is one step of the timeline `effect_added`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from orchestrator.formatting.colours import GUIDE, MEASURED_ON_SCREEN, MODEL, PHASES, packed_all, sequential
from orchestrator.formatting.names import plain, rung_name
from orchestrator.formatting.quantities import duration, number, quantity, vector
from orchestrator.formatting.results import ladder_rows, setting_rows
from orchestrator.formatting.sentences import markdown_table
from plugins.streams.rerun._axes import Chart, colour_bar, dotted, lined, plane, reach, worded
from plugins.streams.rerun._detail import DETAIL
from plugins.streams.rerun._tape import ALWAYS, Entry, When, entry, properties
from plugins.streams.rerun._words import page, search_page, words_page
from protocols import (
    Compared,
    CurrentExcerpt,
    Diagnosed,
    DiagnosisStep,
    ExperimentProposed,
    FluxLoop,
    LawLearned,
    Message,
    RealArray,
    ResistanceCourse,
)

_ERRORS = "ladder/rms_mv"


@dataclass(frozen=True)
class Contents:
    """What the steps of a diagnosis bring along, so that no view is laid out for nothing."""

    excerpts: int
    loops: int
    resistance: bool
    laws: int = 0

    @classmethod
    def of(cls, step: DiagnosisStep) -> Contents:
        return cls(
            min(len(step.excerpts), DETAIL.excerpts), min(len(step.loops), DETAIL.loops), step.resistance is not None
        )


@dataclass(frozen=True)
class _Scales:
    """Fixed by the first step, so that the error is seen to fall."""

    reach_a: float
    residual_v: float
    phase_reach_a: tuple[float, float]
    phase_v: tuple[float, float]
    loops_wb: dict[str, tuple[float, float]]


class Diagnosis:
    """The pictures of a diagnosis as its ladder grows."""

    def __init__(self) -> None:
        self._base, self._at_s = 0, -1.0
        self._step = 0
        self._rungs: list[DiagnosisStep] = []
        self._scales: _Scales | None = None
        self._page: dict[str, str] = {}
        self._laws: list[LawLearned] = []

    def take(self, message: Message, after_s: float = 0.0) -> list[Entry]:
        """The entries that a message makes; none for what is not a diagnosis's.

        On the experiment's time each step stands a second after what was measured, or after the one before it.
        """
        if isinstance(message, DiagnosisStep):
            self._at_s = max(self._at_s, after_s) + 1.0
            return self._on(message)
        if isinstance(message, Diagnosed):
            return self._diagnosed(message)
        if isinstance(message, LawLearned):
            self._laws.append(message)
            return [*_law(f"law/{self.laws - 1}", message), page("law/page", ALWAYS, _laws_page(self._laws))]
        if isinstance(message, ExperimentProposed):
            return self._proposed(message)
        if isinstance(message, Compared):
            return self._compared(message)
        return []

    @property
    def laws(self) -> int:
        """Number of laws that were learned."""
        return len(self._laws)

    def _on(self, step: DiagnosisStep) -> list[Entry]:
        out: list[Entry] = []
        if step.index == 0 or self._scales is None:
            # A step between two diagnoses is left free for the gap between their lines.
            self._base, self._rungs = (self._step + 2 if self._rungs else 0), []
            self._scales = _scales(step)
            # No line leads from the last error of an earlier diagnosis up to the first of this one.
            gap = When(experiment_s=self._at_s - 0.5, step=self._base - 1 if self._base > 0 else None)
            out.append(entry(_ERRORS, gap, rr.Clear(recursive=False)))
            out += plane("residual/plane/amperes", self._scales.reach_a)
        self._step = self._base + len(self._rungs)
        self._rungs.append(_without_arrays(step))
        when = When(experiment_s=self._at_s, step=self._step)
        out += [*self._ladder(when), *_residual(when, step, self._scales)]
        for k, excerpt in enumerate(step.excerpts[: DETAIL.excerpts]):
            out += _excerpt(when, f"excerpts/{k}", excerpt)
        for k, loop in enumerate(step.loops[: DETAIL.loops]):
            out += _loop(when, f"loops/{k}", loop, self._scales.loops_wb.get(loop.segment, _openness(loop)))
        if step.resistance is not None:
            out += _course(when, step.resistance)
        return out

    def _ladder(self, when: When) -> list[Entry]:
        """The rungs so far as bars, the floor as a line, and a page with the numbers."""
        steps = self._rungs
        worst = max(max(s.rms_v, s.heldout_rms_v or 0.0) for s in steps)
        floor = max(min(s.noise_rms_v for s in steps), 1e-9)
        chart = Chart(
            "ladder/chart",
            (1e3 * 0.5 * floor, 1e3 * max(2.0 * worst, 4.0 * floor)),
            (0.0, 1.0),
            "residual, rms [mV]",
            "",
            True,
        )
        out = chart.furniture(when, y_ticks=False)
        rows = max(len(steps), 4)
        at = 1.0 - (np.arange(len(steps)) + 0.6) / rows
        words: list[tuple[float, float, str]] = []
        bars, held = [], []
        for y, step in zip(at, steps, strict=True):
            bars.append(chart.place([chart.x[0], 1e3 * step.rms_v], [y, y]))
            if step.heldout_rms_v is not None:
                held.append(chart.place([1e3 * step.heldout_rms_v], [y])[0])
            x, height = chart.place([np.sqrt(chart.x[0] * chart.x[1])], [y])[0]
            words.append((float(x), float(height) - 7.0, f"{_name(step)}: {quantity(step.rms_v, 'V')}"))
        out.append(lined("ladder/chart/fitted", when, bars, MODEL, -4.0))
        out.append(dotted("ladder/chart/heldout", when, np.array(held).reshape(-1, 2), MEASURED_ON_SCREEN, -4.0))
        out.append(chart.line("floor", when, np.full(2, 1e3 * floor), np.array([0.0, 1.0]), GUIDE))
        words.append((float(chart.place([1e3 * floor], [1.0])[0, 0]), -9.0, "noise"))
        out.append(worded("ladder/chart/words", when, words))
        out.append(page("ladder/page", when, _ladder_page(steps)))
        row = [steps[-1].rms_v, steps[-1].heldout_rms_v or steps[-1].rms_v, steps[-1].noise_rms_v]
        return [*out, entry(_ERRORS, when, rr.Scalars([1e3 * v for v in row]))]

    def _diagnosed(self, message: Diagnosed) -> list[Entry]:
        report = message.report
        effects = ", ".join(effect.name for effect in report.effects)
        facts = {"verdict": report.verdict, "effects": effects, "round": message.round}
        pages = self._text_page("words", words_page(message.words, [reason.sentence for reason in report.reasons]))
        if report.search:
            pages = self._text_page("search", search_page(report.search))
        return [*pages, properties("diagnosis", facts)]

    def _proposed(self, message: ExperimentProposed) -> list[Entry]:
        apart = f"**{plain(message.separates[0])}** from **{plain(message.separates[1])}**"
        follows = "it follows now" if message.accepted else "it is not done here"
        text = (
            f"## The next experiment\n\nIt tells {apart} and takes {duration(60.0 * message.minutes)}; {follows}.\n\n"
        )
        return self._text_page("next", text + markdown_table(("setting", "value"), setting_rows(message.stage)))

    def _compared(self, message: Compared) -> list[Entry]:
        rows = [
            (
                plain(s.stage),
                quantity(s.pwm_frequency_hz, "Hz"),
                quantity(s.rms_v, "V"),
                quantity(s.noise_rms_v, "V"),
                number(s.chi2, 3),
            )
            for s in message.report.stages
        ]
        head = ("stage", "PWM", "residual, rms", "noise floor", "χ² per degree of freedom")
        return self._text_page("compared", "## The model against the measurements\n\n" + markdown_table(head, rows))

    def _text_page(self, part: str, text: str) -> list[Entry]:
        """The page of the diagnosis, which always stands as it was last."""
        self._page[part] = text
        parts = [self._page[name] for name in ("words", "next", "compared", "search") if name in self._page]
        return [page("diagnosis", ALWAYS, "\n\n".join(parts))]


def _name(step: DiagnosisStep) -> str:
    return rung_name(step.added, step.index)


def furniture() -> list[Entry]:
    """What stands from the beginning."""
    names = ["fitted [mV]", "held out [mV]", "noise floor [mV]"]
    colours = [MODEL, MEASURED_ON_SCREEN, GUIDE]
    lines = rr.SeriesLines(names=names, colors=packed_all(colours), widths=[2.5, 2.5, 1.5])
    return [entry(_ERRORS, ALWAYS, lines)]


def _without_arrays(step: DiagnosisStep) -> DiagnosisStep:
    """Only the figures are kept of the rungs below."""
    none = np.empty(0)
    flat: dict[str, Any] = {
        "time_s": none,
        "noise_v": none,
        "i_dq": np.empty((0, 2)),
        "residual_dq_v": np.empty((0, 2)),
    }
    flat |= {"i_abc": np.empty((0, 3)), "residual_abc_v": np.empty((0, 3)), "stage": ()}
    return step.model_copy(update=flat | {"excerpts": (), "loops": (), "resistance": None})


def _scales(step: DiagnosisStep) -> _Scales:
    size = np.hypot(*step.residual_dq_v.T) if len(step.residual_dq_v) else np.zeros(0)
    largest = float(np.quantile(size, DETAIL.inner_part)) if size.size else 0.0
    reach_a = 1.05 * float(np.abs(step.i_dq).max()) if step.i_dq.size else 1.0
    return _Scales(
        reach_a=reach_a or 1.0,
        residual_v=largest or 1e-3,
        phase_reach_a=reach(step.i_abc.ravel()),
        phase_v=reach(step.residual_abc_v.ravel(), DETAIL.inner_part),
        loops_wb={loop.segment: _openness(loop) for loop in step.loops},
    )


def _in_volts(largest_v: float) -> tuple[float, str]:
    """Factor and unit for voltages up to this one."""
    return (1e3, "mV") if largest_v < 1.0 else (1.0, "V")


def _visible(fractions: RealArray) -> RealArray:
    """The dark end of the colours left out: dots of it would be lost on a dark ground."""
    out: RealArray = 0.3 + 0.7 * np.clip(fractions, 0.0, 1.0)
    return out


def _residual(when: When, step: DiagnosisStep, scales: _Scales) -> list[Entry]:
    """Size of the residual over the current plane; each phase's residual over that phase's current."""
    some = np.linspace(0, len(step.time_s) - 1, min(DETAIL.windows, len(step.time_s))).astype(int)
    size = np.hypot(*step.residual_dq_v[some].T)
    order = np.argsort(size)  # the largest on top
    path = "residual/plane/amperes"
    colours = sequential(_visible(size[order] / scales.residual_v))
    out = [dotted(f"{path}/windows", when, step.i_dq[some][order], colours, -3.0)]
    bar = sequential(_visible(np.linspace(0.0, 1.0, 64)))
    scale, unit = _in_volts(scales.residual_v)
    out += colour_bar(path, when, scales.reach_a, bar, (0.0, scale * scales.residual_v), f"residual [{unit}]")
    scale, unit = _in_volts(scales.phase_v[1])
    span = (scale * scales.phase_v[0], scale * scales.phase_v[1])
    chart = Chart("residual/phases", scales.phase_reach_a, span, "current of the phase [A]", f"residual of it [{unit}]")
    out += chart.furniture(when, _name(step))
    for phase, (name, colour) in enumerate(zip("abc", PHASES, strict=True)):
        x, y = step.i_abc[some, phase], scale * step.residual_abc_v[some, phase]
        out.append(chart.points(name, when, x, y, colour, -1.8))
    return [*out, chart.legend(when, [(f"phase {n}", c) for n, c in zip("abc", PHASES, strict=True)])]


def _excerpt(when: When, path: str, excerpt: CurrentExcerpt) -> list[Entry]:
    """Measured and predicted current of the axis that moves more, less its mean."""
    axis = int(np.ptp(excerpt.measured_a, axis=0).argmax())
    mean = excerpt.measured_a[:, axis].mean()
    measured, predicted = excerpt.measured_a[:, axis] - mean, excerpt.predicted_a[:, axis] - mean
    span = reach(np.concatenate([measured, predicted]))
    scale, unit = (1e3, "mA") if span[1] < 1.0 else (1.0, "A")
    seconds = float(excerpt.time_s[-1]) if len(excerpt.time_s) and excerpt.time_s[-1] > 0 else 1.0
    chart = Chart(
        path, (0.0, 1e3 * seconds), (scale * span[0], scale * span[1]), "time [ms]", f"Δi_{'dq'[axis]} [{unit}]"
    )
    injected = "" if excerpt.amplitude_v is None else f", {quantity(excerpt.amplitude_v, 'V')}"
    title = f"{plain(excerpt.stage)} at {vector(excerpt.i_d_a, excerpt.i_q_a)}{injected}"
    return [
        *chart.furniture(when, title),
        chart.line("measured", when, 1e3 * excerpt.time_s, scale * measured, MEASURED_ON_SCREEN, -1.6),
        chart.line("predicted", when, 1e3 * excerpt.time_s, scale * predicted, MODEL, -0.9, 25.0),
        chart.legend(when, [("measured", MEASURED_ON_SCREEN), ("predicted", MODEL)]),
    ]


def _loop(when: When, path: str, loop: FluxLoop, span_wb: tuple[float, float]) -> list[Entry]:
    """Integrated voltage less the model's map, up and down: a loop that closes as the model improves."""
    axis = 0 if loop.swept_axis == "d" else 1
    current, apart = loop.i_dq[:, axis], (loop.psi_measured - loop.psi_model)[:, axis]
    name = "dq"[axis]
    span_mwb = (1e3 * span_wb[0], 1e3 * span_wb[1])
    chart = Chart(path, _around(current), span_mwb, f"i_{name} [A]", f"ψ_{name} − model [mWb]")
    return [
        *chart.furniture(when, loop.segment),
        chart.line("model", when, np.array(chart.x), np.zeros(2), MODEL),
        chart.line("measured", when, current, 1e3 * (apart - apart.mean()), MEASURED_ON_SCREEN, -1.4, 25.0),
        chart.legend(when, [("integrated voltage", MEASURED_ON_SCREEN), ("the model's map", MODEL)]),
    ]


def _law(path: str, law: LawLearned) -> list[Entry]:
    """A learned law with its 95 % band, and its formula."""
    low, high = law.y - 1.96 * law.y_std, law.y + 1.96 * law.y_std
    form = law.y if law.y_form is None else law.y_form
    chart = Chart(path, _around(law.x), _around(np.concatenate([low, high, form])), law.x_label, law.y_label)
    band = np.concatenate([law.x, law.x[::-1], law.x[:1]]), np.concatenate([low, high[::-1], low[:1]])
    out = [
        *chart.furniture(ALWAYS, f"y = {law.formula}"),
        chart.line("band", ALWAYS, *band, GUIDE),
        chart.line("curve", ALWAYS, law.x, law.y, MEASURED_ON_SCREEN, -1.6),
    ]
    names = [("95 % band", GUIDE), ("flexible law", MEASURED_ON_SCREEN)]
    if law.y_form is not None:
        out.append(chart.line("formula", ALWAYS, law.x, law.y_form, MODEL, -0.9, 25.0))
        names.append(("formula", MODEL))
    return [*out, chart.legend(ALWAYS, names)]


def _laws_page(laws: Sequence[LawLearned]) -> str:
    return "\n\n".join(f"{law.sentence}\n\n**y = {law.formula}**" for law in laws)


def _openness(loop: FluxLoop) -> tuple[float, float]:
    """The range that holds a loop [Wb]."""
    axis = 0 if loop.swept_axis == "d" else 1
    apart = (loop.psi_measured - loop.psi_model)[:, axis]
    return reach(apart - apart.mean())


def _course(when: When, course: ResistanceCourse) -> list[Entry]:
    """R_s over the heat taken up."""
    both = np.concatenate([course.measured_ohm, course.model_ohm])
    chart = Chart("heat", _around(course.heat_j), _around(both), "heat in the winding so far [J]", "R_s [Ω]")
    order = np.argsort(course.heat_j)
    return [
        *chart.furniture(when),
        chart.points("measured", when, course.heat_j, course.measured_ohm, MEASURED_ON_SCREEN, -3.0),
        chart.line("model", when, course.heat_j[order], course.model_ohm[order], MODEL),
        chart.legend(when, [("measured by each dwell", MEASURED_ON_SCREEN), ("the model's", MODEL)]),
    ]


def _around(values: RealArray) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    edge = 0.06 * (high - low) or 0.05 * max(abs(high), 1e-9)
    return low - edge, high + edge


def _ladder_page(steps: list[DiagnosisStep]) -> str:
    last = steps[-1]
    head = ("model", "χ² per dof", "fitted, rms", "held out, rms", "current")
    return "\n\n".join(
        [
            f"# {_name(last)}",
            f"The residual is {quantity(last.rms_v, 'V')}; noise alone would leave {quantity(last.noise_rms_v, 'V')}.",
            markdown_table(head, ladder_rows(steps)),
            f"The model holds: {', '.join(map(plain, last.effects)) or 'no effect yet'}.",
        ]
    )
