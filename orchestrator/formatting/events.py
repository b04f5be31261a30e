"""Texts of a run's messages, a subject and a sentence each, for console, viewer and page."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.formatting.names import OUTCOME_MOODS, VERDICTS, map_source, plain
from orchestrator.formatting.quantities import duration, number, plural, quantity
from orchestrator.formatting.results import resistance, resistance_course
from orchestrator.formatting.sentences import typographic
from protocols import (
    Compared,
    CompareReport,
    Diagnosed,
    DiagnosisStep,
    ExperimentProposed,
    LawLearned,
    LockChecked,
    MapEstimated,
    Message,
    Note,
    OperatorAnswered,
    OperatorAsked,
    ResistanceEstimate,
    ResistanceEstimated,
    RunEnded,
    RunStarted,
    StagesAppended,
    StageStarted,
    StageSufficed,
    StateChanged,
    UnderWay,
)

DISARMED_WHILE = "the drive is disarmed while"
"""Begin of the reason of a stop after which the run goes on by itself."""


@dataclass(frozen=True)
class EventText:
    """The text of a message.

    Attributes
    ----------
    subject : str
    text : str
    mood : str
        "good", "info", "warning" or "bad".
    """

    subject: str
    text: str
    mood: str = "info"

    @property
    def line(self) -> str:
        """Subject and text on one line; the text alone for a plain remark."""
        return f"{self.subject}: {self.text}" if self.subject not in ("info", "") else self.text


def describe(message: Message) -> EventText | None:
    """The text of a message; None for messages on single points and samples."""
    match message:
        case RunStarted():
            done = f", {message.points_done} of them already done" if message.points_done else ""
            time = f", {duration(message.seconds)} on the drive's clock" if message.seconds else ""
            about = "".join(f", {label} {text}" for label, text in message.about.lines())
            where = f"{message.motor.name} on the drive {message.drive}{about}"
            return EventText(message.name, f"{where}, {plural(message.points, 'point')}{done}{time}")
        case StageStarted():
            return EventText(
                f"stage {message.index + 1}",
                (message.title or plain(message.stage))
                + (f", {plural(message.points, 'point')}" if message.points else ""),
            )
        case StateChanged():
            mood = OUTCOME_MOODS.get(message.target, "info")
            subject = "pausing" if message.reason.startswith(DISARMED_WHILE) else plain(message.target)
            return EventText(subject, message.reason, "bad" if mood == "warning" else mood)
        case OperatorAsked():
            return EventText("question", message.prompt)
        case OperatorAnswered():
            words = f': "{message.words}"' if message.words else ""
            through = f", through the {message.through}" if message.through else ""
            return EventText("answered", f"{message.answer} (by {message.by}{through}{words})")
        case LockChecked():
            mood = "info" if message.locked is None else "good" if message.locked else "bad"
            return EventText("lock check", typographic(message.summary), mood)
        case ResistanceEstimated():
            return EventText("R_s", f"{resistance(message.estimate)}, {_resistance_source(message.estimate)}", "good")
        case MapEstimated():
            grid = message.estimate.map
            return EventText(
                "flux map", f"{map_source(grid.method)}, {len(grid.i_d)} × {len(grid.i_q)} currents", "good"
            )
        case Compared():
            return EventText("comparison", _comparison(message.report))
        case Diagnosed():
            verdict = VERDICTS[message.report.verdict]
            after = f", after experiment {message.round}" if message.round else ""
            return EventText("diagnosis", verdict.name.lower() + after, verdict.mood)
        case LawLearned():
            return EventText("law", f"y = {message.formula}: {message.sentence}")
        case ExperimentProposed():
            kind, first, second = map(plain, (str(message.stage.get("kind")), *message.separates))
            where = "the run continues with it" if message.accepted else "for another run"
            text = f"{kind}, {duration(60.0 * message.minutes)}, separates {first} from {second}; {where}"
            return EventText("next experiment", text)
        case StagesAppended():
            return EventText("stages", f"{len(message.stages)} appended")
        case StageSufficed():
            saved = f"{plural(message.points_spared, 'point')} of the plan ({duration(message.seconds_spared)})"
            return EventText(f"stage {message.index + 1}", f"sufficiently measured; {saved} not needed", "good")
        case Note():
            return EventText(
                message.level, typographic(message.text), {"error": "bad"}.get(message.level, message.level)
            )
        case UnderWay(is_result=True):
            return EventText("", typographic(message.text))
        case RunEnded():
            return EventText(message.outcome, message.reason, OUTCOME_MOODS[message.outcome])
        case _:
            return None


def step_error_v(step: DiagnosisStep) -> float:
    """The error of a ladder step: that of held-out stages, where there are any."""
    return step.rms_v if step.heldout_rms_v is None else step.heldout_rms_v


SINGLE_READINGS = (
    "the value of all holds together is outside these, as one reading also has the inverter's error at its current"
)
"""Why a mean may lie outside the first and the last reading."""


def _resistance_source(estimate: ResistanceEstimate) -> str:
    """Of two values in one run, which is which: only the model takes out the winding's heating.

    An interval is of the readings' noise alone, and much narrower than what the winding's temperature changes.
    """
    if estimate.is_of_model:
        return "of the fitted model at 0 s, before any current warms the winding; the interval is of noise alone"
    source = f"by the estimators, the mean over the whole run ({resistance_course(estimate)})"
    low, high = sorted((estimate.first_ohm, estimate.last_ohm))
    beside = "" if low <= estimate.value_ohm <= high else f"; {SINGLE_READINGS}"
    return f"{source}{beside}; the interval is of noise alone"


def _comparison(report: CompareReport) -> str:
    """A sentence on the model's error in the recording."""
    over_all = [
        f"error {quantity(report.rms_v, 'V')} rms",
        f"noise floor {quantity(report.noise_floor.rms_v, 'V')}",
        f"chi2 {number(report.chi2, 3)}",
    ]
    text = f"the {report.model} model, over all stages: {', '.join(over_all)}"
    if not report.worst:
        return text
    worst = report.worst[0]
    floor = f", noise floor there {quantity(worst.noise_rms_v, 'V')}" if worst.noise_rms_v is not None else ""
    return f"{text}; worst in {worst.segment}: {quantity(worst.rms_v, 'V')} rms{floor}"
