"""One pass of the estimators over a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import numpy as np

from orchestrator.analysis._captures import HeldCaptures
from orchestrator.estimation.delivery import earlier_model, join_model
from orchestrator.estimation.judgement import EstimatorResults, report_with_checks
from orchestrator.estimation.nameplate import with_nameplate_checks
from orchestrator.estimation.results import write_results
from orchestrator.estimation.usability import missing_model, unmet
from orchestrator.recording._recording_checks import SoundRecording
from protocols import (
    Convention,
    Estimate,
    EstimationContext,
    EstimationReport,
    Estimator,
    FluxMap,
    FluxMapEstimate,
    MapCriteria,
    NotMeasuredError,
    PluginError,
    RecordingReader,
    Remark,
    ResistanceEstimate,
    SegmentStage,
    UsabilityCheck,
)

ModelCheck = Callable[[RecordingReader, FluxMap, MapCriteria], UsabilityCheck]
"""Whether a model explains a recording, and has the map that was estimated from it."""


def estimate_recording(
    recording: RecordingReader,
    estimators: Sequence[Estimator],
    out: Path,
    *,
    criteria: MapCriteria | None = None,
    on_estimate: Callable[[Estimate], None] | None = None,
    check_model: ModelCheck | None = None,
) -> EstimationReport:
    """Run the estimators and write results/flux_map.nc, flux_map_<method>.nc and estimates.json below `out`.

    These replace the maps and the report of an earlier pass as one set; other files there stay. The model of an earlier
    diagnosis of the same segments keeps its place among them, and so do its objections.

    Parameters
    ----------
    recording : RecordingReader
    estimators : sequence of Estimator
        Each runs after those whose products it requires, and gets the results before it. Of resistances the
        narrowest interval is used; of maps that of the highest rank is recommended, unless it fails its checks.
    out : Path
        Directory that gets the folder ``results``.
    criteria : MapCriteria, optional
        Thresholds of the maps' checks.
    on_estimate : callable, optional
        Called with each estimate as soon as it is there.
    check_model : callable, optional
        Whether a model explains the recording, as from `orchestrator.screening`; called for a map that passes every
        other check. Without it, no map is judged to be usable. The model of an earlier diagnosis decides without it.

    Raises
    ------
    NotMeasuredError
        Where nothing at all can be estimated, or currents and voltages cannot be a motor's; no file is written then.
        A remark names a wrong convention.
    PluginError
        Where an estimator's result has another type than declared, or estimators require each other.
    StorageError
        Where a result cannot be written.
    """
    recording = HeldCaptures(recording)  # estimators read the same segments
    data_faults = _data_faults(recording)
    results: list[tuple[Estimator, Estimate]] = []
    missing: list[Remark] = []
    # An estimator that names no stages is always tried.
    stages_read: list[tuple[SegmentStage, ...]] = [getattr(one, "reads", ()) for one in estimators]
    applicable = [
        one for one, reads in zip(estimators, stages_read, strict=True) if not reads or recording.segments(*reads)
    ]
    for estimator in in_order(applicable):
        context = EstimationContext(tuple(estimate for _, estimate in results))
        try:
            estimate = estimator.estimate(recording, context)
        except NotMeasuredError as error:
            missing.append(Remark(code="not_measured", text=str(error)).by(estimator.name))
            continue
        except np.linalg.LinAlgError as error:
            text = "{recording}: its readings do not determine the equations: {problem}"
            unsolved = Remark.of("no_solution", text, recording=recording.manifest.name, problem=str(error))
            missing.append(unsolved.by(estimator.name))
            continue
        if not isinstance(estimate, estimator.produces):
            problem = f"returned {type(estimate).__name__} instead of {estimator.produces.__name__}"
            raise PluginError(estimator.name, "estimate", problem)
        results.append((estimator, estimate))
        if on_estimate is not None:
            on_estimate(estimate)
    if not results:
        problem = "; ".join(remark.text for remark in missing) or "no estimator was chosen"
        raise NotMeasuredError(recording.manifest.name, "", f"nothing can be estimated: {problem}")
    results.sort(key=lambda pair: -pair[0].rank)
    maps = {estimate.map.method: estimate for _, estimate in results if isinstance(estimate, FluxMapEstimate)}
    resistances = {e.name: estimate for e, estimate in results if isinstance(estimate, ResistanceEstimate)}
    motor, stages = recording.manifest.motor, {segment.stage for segment in recording.segments()}
    found = EstimatorResults(resistances, maps, tuple(missing), stages)
    report = report_with_checks(found, motor, criteria or MapCriteria())
    by_method = {method: found.map for method, found in maps.items()}
    report = with_nameplate_checks(report, by_method, motor).checked(unmet("conventions", data_faults))
    earlier, left_out = earlier_model(out, recording.manifest)
    report = report.model_copy(update={"remarks": (*report.remarks, *left_out)})
    if report.usable and earlier is None:
        judged = (recording, by_method[str(report.method)], report.criteria)
        check = missing_model("no model was fitted") if check_model is None else check_model(*judged)
        report = report.checked([check])
    if earlier is not None:
        report, by_method = join_model(report, by_method, *earlier, motor)
    return write_results(report, by_method, out / "results", motor=motor.name, recording=recording.manifest.name)


def in_order(estimators: Sequence[Estimator]) -> list[Estimator]:
    """Estimators sorted so that each follows those whose products it requires; otherwise the order stays.

    Raises
    ------
    PluginError
        Where estimators require each other in a circle.
    """
    makers = {
        k: [m for m, other in enumerate(estimators) if m != k and issubclass(other.produces, one.requires)]
        for k, one in enumerate(estimators)
    }
    try:
        return [estimators[k] for k in TopologicalSorter(makers).static_order()]
    except CycleError as error:
        names = " -> ".join(estimators[k].name for k in error.args[1])
        raise PluginError("estimators", "requires", f"a circle: {names}") from None


def _data_faults(recording: RecordingReader) -> list[Remark]:
    """Faults of metadata or logging; raises `NotMeasuredError` where no motor could give such readings."""
    # imported on use: reading results does not need the checks
    from orchestrator.recording_checks import convention_remark, find_convention

    named = find_convention(recording)
    try:
        SoundRecording(recording).read_through()
    except NotMeasuredError as error:
        if named is None:
            raise
        raise _refused(recording, named) from error
    if named is not None and named.kind == "dead_channel":
        # The other sensor alone gives no current vector.
        raise _refused(recording, named)
    return [] if named is None else [convention_remark(named)]


def _refused(recording: RecordingReader, named: Convention) -> NotMeasuredError:
    problem = f"{named.what}: {named.correction.text}"
    return NotMeasuredError(recording.manifest.name, named.correction.field or "captures", problem)
