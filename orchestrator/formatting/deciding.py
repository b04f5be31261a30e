"""What is left to decide after a diagnosis, and what to do with a map, in the words of command line and report."""

from __future__ import annotations

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import duration, predicted_separation
from orchestrator.formatting.sentences import typographic
from protocols import EstimationReport, NextExperiment, Usability

NOTHING_TO_DECIDE = "nothing left to decide"
"""The section of a diagnosis where no measurement is proposed."""

DISCOVER_FIRST = "`fluxbench discover RUN` looks for the law that is missing"
"""What comes first where no effect of the library explains a recording."""


def experiment_to_decide(proposal: NextExperiment) -> str:
    """The proposed stage with its duration, and the two effects that it separates."""
    first, second = map(plain, proposal.separates)
    stage = f"{plain(str(proposal.stage['kind']))} stage of {duration(60.0 * proposal.minutes)}"
    return f"{stage}, tells {first} from {second}{predicted_separation(proposal)}"


def map_advice(report: EstimationReport | None, run: str) -> str:
    """What to do with a run's map; `run` is the run as a command takes it."""
    if report is None:
        return f"none yet: `fluxbench estimate {run}` makes it."
    if report.usable and "flux_map" in report.files:
        return (
            f"use `results/{report.files['flux_map']}`; `fluxbench export {run}` writes it for other tools, "
            f"`fluxbench tune {run}` computes a drive's references, gains and compensation."
        )
    if report.usability is Usability.NOT_JUDGED:
        return f"not judged: `fluxbench diagnose {run}` decides whether it is usable."
    why = next((typographic(remark.text) for remark in report.remarks), "none could be made")
    if report.model is not None and report.estimators is None:  # after `add`, before any estimation
        return f"that of model.json is not to be relied on: {why}. `fluxbench estimate {run}` makes the estimators’."
    return f"do not rely on it: {why}."
