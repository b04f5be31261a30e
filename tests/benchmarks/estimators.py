"""How many raw samples a second the estimators get through, and what memory that takes; prints, and judges nothing."""

from __future__ import annotations

import resource
import statistics
import tempfile
import time
from pathlib import Path

from orchestrator.config import load_procedure
from orchestrator.engine import AbsentOperator, Interrupts, RunServices, start_run
from orchestrator.estimation.estimation import in_order
from orchestrator.recording import open_recording
from orchestrator.registry.plugins import PluginKind, make_plugins
from protocols import Estimate, EstimationContext, RecordingReader, SegmentStage

ROUNDS = 3
NEEDED = (SegmentStage.RESISTANCE, SegmentStage.CLASSICAL, SegmentStage.INJECTION)


def recorded(folder: Path) -> RecordingReader:
    """The paper's procedure with points three times as far apart; fifteen million samples."""
    procedure = load_procedure("paper", overrides=("stages.5.step_a=0.3",))
    measuring = tuple(stage for stage in procedure.stages if stage.kind != "estimate")
    start_run(procedure.model_copy(update={"stages": measuring}), folder, RunServices(AbsentOperator(), Interrupts()))
    return open_recording(folder)


def seconds_of(recording: RecordingReader) -> dict[str, float]:
    """Time that each installed estimator takes, in the order in which they see what the others found."""
    found: list[Estimate] = []
    spent = {}
    for estimator in in_order(make_plugins(PluginKind.ESTIMATORS)):
        begun = time.perf_counter()
        found.append(estimator.estimate(recording, EstimationContext(tuple(found))))
        spent[estimator.name] = time.perf_counter() - begun
    return spent


def main() -> None:
    """Print one line an estimator, and one for all together."""
    with tempfile.TemporaryDirectory() as folder:
        recording = recorded(Path(folder) / "run")
        seconds_of(recording)  # imports, and kernels from their cache
        rounds = [seconds_of(recording) for _ in range(ROUNDS)]
        samples = sum(s.samples for s in recording.segments(*NEEDED))
    for name in rounds[0]:
        print(f"{name:12s} {statistics.median(one[name] for one in rounds):6.2f} s")
    total = statistics.median(sum(one.values()) for one in rounds)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{samples / 1e6:.1f} M samples in {total:.2f} s: {samples / total / 1e6:.1f} M a second; peak {peak:.0f} MB")


if __name__ == "__main__":
    main()
