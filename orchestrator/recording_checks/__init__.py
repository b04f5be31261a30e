"""Checks of manifest and logging, made before any physics: a wrong convention would be taken for an effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.recording._recording_checks import SoundRecording
from orchestrator.recording_checks.axes import quarter_turn
from orchestrator.recording_checks.channels import bus_spikes, clipped, dead_channel, require_held, require_response
from orchestrator.recording_checks.correction import CorrectedRecording
from orchestrator.recording_checks.nameplate import nameplate_remarks
from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.rows import broken_rows
from orchestrator.recording_checks.set_points import against_set_points, without_set_points
from orchestrator.recording_checks.survey import survey
from orchestrator.recording_checks.time_base import delay, sampling_rate
from protocols import Convention, RecordingReader, Remark

__all__ = ["CorrectedRecording", "check_recording", "convention_remark", "find_convention"]

HYPOTHESES: tuple[Callable[[Responses], Convention | None], ...] = (
    lambda responses: dead_channel(responses.survey),
    lambda responses: broken_rows(responses.survey),
    lambda responses: clipped(responses.survey),
    sampling_rate,
    against_set_points,
    without_set_points,
    delay,
    quarter_turn,
    lambda responses: bus_spikes(responses.survey),
)
"""Their order: missing channels first, then errors that invalidate every later check, then the rest."""


@dataclass(frozen=True)
class RecordingCheck:
    """The result of a check of manifest and logging.

    Attributes
    ----------
    convention : Convention or None
        The first convention that the readings prove wrong; None where they prove none.
    remarks : tuple of Remark
        Doubts that the readings cannot prove: R and L that differ from the nameplate's.
    """

    convention: Convention | None
    remarks: tuple[Remark, ...] = ()

    @property
    def all_remarks(self) -> tuple[Remark, ...]:
        """The convention as a remark first, for callers that continue nevertheless."""
        return self.remarks if self.convention is None else (convention_remark(self.convention), *self.remarks)


def check_recording(recording: RecordingReader, poll: Callable[[], None] = lambda: None) -> RecordingCheck:
    """The convention that the readings prove wrong, and remarks on doubts that they cannot prove.

    `poll` is called with each segment and each hypothesis; an exception that it raises ends the search.

    Raises
    ------
    RecordingError
        Where the manifest has impossible numbers, or a capture differs from the manifest.
    NotMeasuredError
        Where the current's column is noise, or where the drive has lost its current.
    """
    SoundRecording(recording)
    responses = Responses(survey(recording, poll))
    require_response(responses.survey)
    require_held(responses.survey)
    for hypothesis in HYPOTHESES:
        poll()
        convention = hypothesis(responses)
        if convention is not None:
            return RecordingCheck(convention)
    return RecordingCheck(None, nameplate_remarks(responses))


def find_convention(recording: RecordingReader, poll: Callable[[], None] = lambda: None) -> Convention | None:
    """The convention alone of `check_recording`."""
    return check_recording(recording, poll).convention


def convention_remark(convention: Convention) -> Remark:
    """A wrong convention as a remark, for callers that continue nevertheless."""
    return Remark.of(
        "convention",
        "{what}, by the captured readings ({evidence}): {correction}",
        kind=convention.kind,
        what=convention.what,
        evidence=convention.evidence,
        correction=convention.correction.text,
    )
