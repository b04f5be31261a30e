"""What a diagnosis leaves to decide, in the words that the command line prints and that the report advises by."""

from __future__ import annotations

from orchestrator.formatting.quantities import duration, predicted_separation
from protocols import NextExperiment

NOTHING_TO_DECIDE = "nothing left to decide"
"""The section of a diagnosis after which no measurement is left to make."""


def experiment_to_decide(proposal: NextExperiment) -> str:
    """The proposed stage with its duration, and the two effects that it separates."""
    first, second = proposal.separates
    stage = f"{proposal.stage['kind']} stage of {duration(60.0 * proposal.minutes)}"
    return f"{stage}, tells {first} from {second}{predicted_separation(proposal)}"
