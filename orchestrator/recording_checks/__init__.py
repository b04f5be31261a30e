"""What manifest or logger may have wrong, tried before any physics: it would pass for some effect or other."""

from __future__ import annotations

from collections.abc import Callable

from orchestrator.recording._recording_checks import SoundRecording
from orchestrator.recording_checks.axes import quarter_turn
from orchestrator.recording_checks.channels import (
    bus_spikes,
    clipped,
    dead_channel,
    require_held,
    require_response,
)
from orchestrator.recording_checks.correction import CorrectedRecording
from orchestrator.recording_checks.criteria import ConventionCriteria
from orchestrator.recording_checks.nameplate import against_nameplate
from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.rows import broken_rows
from orchestrator.recording_checks.set_points import against_set_points, without_set_points
from orchestrator.recording_checks.survey import survey
from orchestrator.recording_checks.time_base import delay, sampling_rate
from protocols import Convention, RecordingReader, Remark

__all__ = ["ConventionCriteria", "CorrectedRecording", "convention_remark", "find_convention"]

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


def convention_remark(convention: Convention) -> Remark:
    """A wrong convention as a remark, for what goes on all the same."""
    return Remark.of(
        "convention",
        "{what}, by what was captured ({evidence}): {correction}",
        kind=convention.kind,
        what=convention.what,
        evidence=convention.evidence,
        correction=convention.correction.text,
    )
