"""Which look-alikes a recording can tell apart by what was measured. Fits nothing."""

from __future__ import annotations

from orchestrator.diagnosis.selection.contrasts import holds
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from protocols import Contrast, Effect


def separating_contrasts(first: Effect, second: Effect) -> tuple[Contrast, ...]:
    """What it takes to tell two effects apart: the contrasts that both need. None: what was measured will do."""
    return tuple(contrast for contrast in first.needs if contrast in second.needs)


def separable(prepared: PreparedRecording, first: Effect, second: Effect) -> bool:
    """Whether the recording holds what it takes to tell two effects apart."""
    return all(holds(prepared, contrast) for contrast in separating_contrasts(first, second))
