"""Run the estimators on what has been measured so far."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from protocols import (
    Estimate,
    MapEstimated,
    Note,
    NotMeasuredError,
    PluginUse,
    ResistanceEstimate,
    ResistanceEstimated,
    Stage,
    StageRun,
    StageState,
)

ESTIMATING = StageState("estimating", "estimate")
DIAGNOSIS = "diagnose"
"""Kind of the stage that diagnoses."""


class EstimateStage(Stage):
    """Run the estimators on what has been measured so far; the drive is disarmed meanwhile."""

    name = "estimate"
    title = "estimation"
    working = (ESTIMATING,)
    journalled = False

    estimators: tuple[str, ...] | None = None
    """None: every installed one."""

    def uses(self) -> Sequence[PluginUse]:
        screened = PluginUse("effects", None)
        if self.estimators is None:
            return (PluginUse("estimators", None), screened)
        return [*(PluginUse("estimators", name, f"estimators.{k}") for k, name in enumerate(self.estimators)), screened]

    def work(self, run: StageRun) -> None:
        run.enter(ESTIMATING)  # before anything that takes its time, as an import does
        from orchestrator.estimation import estimate_recording
        from orchestrator.screening import check_model

        def publish_estimate(estimate: Estimate) -> None:
            run.check()
            is_resistance = isinstance(estimate, ResistanceEstimate)
            run.publish(ResistanceEstimated(estimate=estimate) if is_resistance else MapEstimated(estimate=estimate))

        wanted = [e for e in run.plugins("estimators") if self.estimators is None or e.name in self.estimators]
        # A diagnosis in the same run decides itself whether its model explains the recording.
        is_diagnosed = any(entry.kind == DIAGNOSIS for entry in run.procedure.stages)
        judge = None if is_diagnosed else partial(check_model, run.plugins("effects"))
        try:
            run.conclude(
                estimate_recording(run.recording(), wanted, run.path, on_estimate=publish_estimate, check_model=judge)
            )
        except NotMeasuredError as error:
            run.publish(Note(level="warning", text=str(error)))
