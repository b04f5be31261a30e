"""Run the estimators on what has been measured so far."""

from __future__ import annotations

from collections.abc import Sequence

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


class EstimateStage(Stage):
    """Run the estimators on what has been measured so far; the drive is disarmed meanwhile."""

    name = "estimate"
    title = "estimation"
    working = (ESTIMATING,)
    journalled = False

    estimators: tuple[str, ...] | None = None
    """None: every installed one."""

    def uses(self) -> Sequence[PluginUse]:
        if self.estimators is None:
            return (PluginUse("estimators", None),)
        return [PluginUse("estimators", name, f"estimators.{k}") for k, name in enumerate(self.estimators)]

    def work(self, run: StageRun) -> None:
        run.enter(ESTIMATING)  # before anything that takes its time, as an import does
        from orchestrator.estimation import estimate_recording

        def publish_estimate(estimate: Estimate) -> None:
            run.check()
            is_resistance = isinstance(estimate, ResistanceEstimate)
            run.publish(ResistanceEstimated(estimate=estimate) if is_resistance else MapEstimated(estimate=estimate))

        wanted = [e for e in run.plugins("estimators") if self.estimators is None or e.name in self.estimators]
        try:
            run.conclude(estimate_recording(run.recording(), wanted, run.path, on_estimate=publish_estimate))
        except NotMeasuredError as error:
            run.publish(Note(level="warning", text=str(error)))
