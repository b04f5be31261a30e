"""What manifest or logger may have wrong, tried before any physics: it would pass for some effect or other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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
from orchestrator.recording_checks.nameplate import nameplate_remarks
from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.rows import broken_rows
from orchestrator.recording_checks.set_points import against_set_points, without_set_points
from orchestrator.recording_checks.survey import survey
from orchestrator.recording_checks.time_base import delay, sampling_rate
from protocols import Convention, RecordingReader, Remark

__all__ = [
    "ConventionCriteria",
    "CorrectedRecording",
    "RecordingCheck",
    "check_recording",
    "convention_remark",
    "find_convention",
]

HYPOTHESES: tuple[Callable[[Responses], Convention | None], ...] = (
    lambda seen: dead_channel(seen.survey),
    lambda seen: broken_rows(seen.survey),
    lambda seen: clipped(seen.survey),
    sampling_rate,
    against_set_points,
    without_set_points,
    delay,
    quarter_turn,
    lambda seen: bus_spikes(seen.survey),
)
"""In this order: what is not in the file at all, what spoils every other look at it, and the rest."""


@dataclass(frozen=True)
class RecordingCheck:
    """What a recording says of manifest and logging.

    Attributes
    ----------
    convention : Convention or None
        The first one that the readings themselves prove wrong; None where they prove none.
    remarks : tuple of Remark
        What the readings do not prove: R and L that are not the nameplate's.
    """

    convention: Convention | None
    remarks: tuple[Remark, ...] = ()

    @property
    def all_remarks(self) -> tuple[Remark, ...]:
        """The convention as a remark first, for what goes on all the same."""
        return self.remarks if self.convention is None else (convention_remark(self.convention), *self.remarks)


def check_recording(
    recording: RecordingReader, criteria: ConventionCriteria | None = None, poll: Callable[[], None] = lambda: None
) -> RecordingCheck:
    """The convention that the readings prove wrong, and remarks on what they do not prove.

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
            return RecordingCheck(found)
    return RecordingCheck(None, nameplate_remarks(seen))


def find_convention(
    recording: RecordingReader, criteria: ConventionCriteria | None = None, poll: Callable[[], None] = lambda: None
) -> Convention | None:
    """The convention alone of `check_recording`, which see."""
    return check_recording(recording, criteria, poll).convention


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
