"""What manifest or logger may have wrong, tried before any physics: it would pass for some effect or other."""

from __future__ import annotations

from collections.abc import Callable

from orchestrator.diagnosis.conventions.axes import quarter_turn
from orchestrator.diagnosis.conventions.channels import (
    bus_spikes,
    clipped,
    dead_channel,
    require_held,
    require_response,
)
from orchestrator.diagnosis.conventions.correction import CorrectedRecording
from orchestrator.diagnosis.conventions.nameplate import against_nameplate
from orchestrator.diagnosis.conventions.report import convention_remark, convention_report, convention_words
from orchestrator.diagnosis.conventions.responses import Responses
from orchestrator.diagnosis.conventions.rows import broken_rows
from orchestrator.diagnosis.conventions.set_points import against_set_points, without_set_points
from orchestrator.diagnosis.conventions.survey import survey
from orchestrator.diagnosis.conventions.time_base import delay, sampling_rate
from orchestrator.diagnosis.criteria import ConventionCriteria
from orchestrator.recording._recording_checks import SoundRecording
from protocols import Convention, RecordingReader

__all__ = ["CorrectedRecording", "convention_remark", "convention_report", "convention_words", "find_convention"]

HYPOTHESES: tuple[Callable[[Responses], Convention | None], ...] = (
    lambda seen: dead_channel(seen.survey),
    lambda seen: broken_rows(seen.survey),
    lambda seen: clipped(seen.survey),
    sampling_rate,
    against_set_points,
    without_set_points,
    delay,
    quarter_turn,
    against_nameplate,
    lambda seen: bus_spikes(seen.survey),
)
"""In this order: what is not in the file at all, what spoils every other look at it, and the rest."""


def find_convention(
    recording: RecordingReader, criteria: ConventionCriteria | None = None, poll: Callable[[], None] = lambda: None
) -> Convention | None:
    """The first convention that the recording speaks for; None where it has none of those that are known.

    What `poll` raises ends the search; it is called with each segment and each hypothesis.

    Raises
    ------
    RecordingError
        Where the manifest has numbers that cannot be meant, or a capture is not what it says.
    NotMeasuredError
        Where what stands in the place of the current is noise, or where the drive has lost its current on the way.
    """
    SoundRecording(recording)
    seen = Responses(survey(recording, criteria or ConventionCriteria(), poll))
    require_response(seen.survey)
    require_held(seen.survey)
    for hypothesis in HYPOTHESES:
        poll()
        found = hypothesis(seen)
        if found is not None:
            return found
    return None
