"""What a run's messages say, a subject and a sentence each: alike on the console, in the viewer and on the page."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.formatting.names import OUTCOME_MOODS, VERDICTS, plain
from orchestrator.formatting.quantities import duration, number, plural, quantity
from orchestrator.formatting.results import resistance
from orchestrator.formatting.sentences import typographic
from protocols import (
    Compared,
    CompareReport,
    Diagnosed,
    DiagnosisStep,
    ExperimentProposed,
    LockChecked,
    MapEstimated,
    Message,
    Note,
    OperatorAnswered,
    OperatorAsked,
    ResistanceEstimated,
    RunEnded,
    RunStarted,
    StagesAppended,
    StageStarted,
    StageSufficed,
    StateChanged,
    UnderWay,
)


@dataclass(frozen=True)
class Said:
    """What a message says.

    Attributes
    ----------
    subject : str
        What it is about.
    text : str
    mood : str
        "good", "info", "warning" or "bad".
    """

    subject: str
    text: str
    mood: str = "info"

    @property
    def line(self) -> str:
        """Both on one line; a remark that is no warning stands alone."""
        return f"{self.subject}: {self.text}" if self.subject not in ("info", "") else self.text


def said(message: Message) -> Said | None:
    """What a message says; None for those of single points and samples."""
    match message:
        case RunStarted():
            done = f", {message.points_done} of them done before" if message.points_done else ""
            time = f", {duration(message.seconds)} on the drive's clock" if message.seconds else ""
            about = "".join(f", {label} {text}" for label, text in message.about.lines())
            where = f"{message.motor.name} on the drive {message.drive}{about}"
            return Said(message.name, f"{where}, {plural(message.points, 'point')}{done}{time}")
        case StageStarted():
            return Said(
                f"stage {message.index + 1}",
                (message.title or plain(message.stage))
                + (f", {plural(message.points, 'point')}" if message.points else ""),
            )
        case StateChanged():
            mood = OUTCOME_MOODS.get(message.target, "info")
            return Said(plain(message.target), message.reason, "bad" if mood == "warning" else mood)
        case OperatorAsked():
            return Said("asked", message.prompt)
        case OperatorAnswered():
            words = f': "{message.words}"' if message.words else ""
            through = f", through the {message.through}" if message.through else ""
            return Said("answered", f"{message.answer} (by {message.by}{through}{words})")
        case LockChecked():
            mood = "info" if message.locked is None else "good" if message.locked else "bad"
            return Said("lock check", typographic(message.summary), mood)
        case ResistanceEstimated():
            return Said("R_s", resistance(message.estimate), "good")
        case MapEstimated():
            grid = message.estimate.map
            return Said("flux map", f"by {grid.method}, {len(grid.i_d)} × {len(grid.i_q)} currents", "good")
        case Compared():
            return Said("comparison", _comparison(message.report))
        case Diagnosed():
            verdict = VERDICTS[message.report.verdict]
            after = f", after experiment {message.round}" if message.round else ""
            return Said("diagnosis", verdict.name.lower() + after, verdict.mood)
        case ExperimentProposed():
            return Said("next experiment", _experiment(message))
        case StagesAppended():
            return Said("stages", f"{len(message.stages)} more to do")
        case StageSufficed():
            saved = f"{plural(message.points_spared, 'point')} of the plan ({duration(message.seconds_spared)})"
            return Said(f"stage {message.index + 1}", f"enough is measured; {saved} not needed", "good")
        case Note():
            return Said(message.level, typographic(message.text), {"error": "bad"}.get(message.level, message.level))
        case UnderWay(is_result=True):
            return Said("", typographic(message.text))
        case RunEnded():
            return Said(message.outcome, message.reason, OUTCOME_MOODS[message.outcome])
        case _:
            return None


def step_error_v(step: DiagnosisStep) -> float:
    """The error that a rung is judged by: that of stages which no fit has seen, where there are such."""
    return step.rms_v if step.heldout_rms_v is None else step.heldout_rms_v


def _experiment(message: ExperimentProposed) -> str:
    first, second = map(plain, message.separates)
    goes_on = "and the run goes on with it" if message.accepted else "for another run"
    kind = plain(str(message.stage.get("kind")))
    return f"{kind}, {duration(60.0 * message.minutes)}, tells {first} from {second}; {goes_on}"


def _comparison(report: CompareReport) -> str:
    """The bare model held against the recording."""
    told = f"the {report.model} model has chi2 {number(report.chi2, 3)}"
    if report.worst:
        told += f", worst in {report.worst[0].segment} with {quantity(report.worst[0].rms_v, 'V')} rms"
    return f"{told} where noise makes {quantity(report.noise_floor.rms_v, 'V')}"
