"""The work on one source: identify it, and run the steps of the plan. Knows no other source and no table."""

from __future__ import annotations

import platform
import tempfile
import time
from functools import partial
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any

from pydantic import Field

from orchestrator.fleet._content import content_sha256, local_copy
from orchestrator.fleet._engine import error_line
from orchestrator.fleet._sources import Source
from orchestrator.operating_system.memory import peak_memory
from protocols import FluxbenchError, RecordingError, Strict
from protocols.fleet import FleetRow, FleetStep, FleetVersions

SCRATCH, IMPORTED = "fluxbench-fleet-", "recording"
"""Prefix of a source's temporary folder, and name of an imported recording in it."""


class Plan(Strict):
    """The steps for each recording."""

    steps: tuple[FleetStep, ...] = Field(default=("estimate",), min_length=1)
    mapping: Path | None = None
    """With the step ``import``: the file that describes a measurement file's columns."""
    keep: Path | None = None
    """Folder, the same on all workers, for each recording's results and exports, below its key."""


class Identified(Strict):
    """The identity of a source, by its content."""

    content_sha256: str | None
    failed: str | None = None
    fetched: bool = False
    """Whether the worker has a copy until the source is worked on."""


class Order(Strict):
    """A source to work on."""

    source: Source
    key: str
    content_sha256: str | None
    plan: Plan


def identify(source: Source) -> Identified:
    """Fetch and hash a source; an error is returned, not raised."""
    try:
        with local_copy(source, keep=True) as path:
            return Identified(content_sha256=content_sha256(path), fetched=str(path) != source.url)
    except FluxbenchError as error:
        return Identified(content_sha256=None, failed=error_line(error))


def work_on(order: Order, _: Identified | None = None) -> dict[str, Any]:
    """The row of a source, as a mapping of its fields; an error is in the field `failed`."""
    began = time.perf_counter()
    fields: dict[str, Any] = {}
    places: list[str] = []
    try:
        with local_copy(order.source, keep=False) as path, tempfile.TemporaryDirectory(prefix=SCRATCH) as scratch:
            places = [f"{scratch}/{IMPORTED}", str(path)]
            _run_steps(order, path, Path(scratch), fields)
    except Exception as error:  # an error belongs to the recording's own row
        fields["failed"] = error_line(error)
        for place in places:
            fields["failed"] = fields["failed"].replace(place, order.source.url)
    row = FleetRow(
        **{
            **bare_fields(order),
            **fields,
            "seconds": time.perf_counter() - began,
            "peak_mb": 1e-6 * (peak_memory() or 0),
        }
    )
    return row.model_dump()


def bare_fields(order: Order) -> dict[str, Any]:
    """The fields that are known before the work begins."""
    return {
        "key": order.key,
        "source": order.source.url,
        "fingerprint": order.source.fingerprint,
        "content_sha256": order.content_sha256,
        "batch": order.source.batch,
        "asked": order.plan.steps,
        "versions": versions(),
    }


def versions() -> FleetVersions:
    """Versions of the software that computes rows here."""
    return FleetVersions(fluxbench=version("fluxbench"), python=platform.python_version(), numpy=version("numpy"))


def _run_steps(order: Order, path: Path, scratch: Path, fields: dict[str, Any]) -> None:
    """Run all steps in order; results before a failing step stay in `fields`."""
    from orchestrator.estimation import has_estimates
    from orchestrator.fleet import _rows as rows
    from orchestrator.interface.api import chosen_effects
    from orchestrator.registry.plugins import PluginKind, make_plugins
    from orchestrator.runs import open_any

    plan = order.plan
    out = scratch / "out" if plan.keep is None else plan.keep / order.key
    if plan.mapping is not None:
        from orchestrator.importing import import_files

        import_files(plan.mapping, [path], scratch / IMPORTED)
        path = scratch / IMPORTED
    recording = open_any(path)
    fields |= rows.identity(recording)
    fields |= rows.temperature(recording)
    if plan.mapping is not None:  # a mapping gives all files the same name
        fields["name"] = PurePosixPath(order.source.url).stem
    if "estimate" in plan.steps or "export" in plan.steps:
        from orchestrator.estimation import estimate_recording
        from orchestrator.screening import check_model

        # A diagnosis decides itself whether its model explains the recording.
        judge = None if "diagnose" in plan.steps else partial(check_model, chosen_effects())
        estimate_recording(recording, make_plugins(PluginKind.ESTIMATORS), out, check_model=judge)
        fields |= rows.estimate_fields(rows.summary_of(recording, out))
    if "compare" in plan.steps:
        from orchestrator.diagnosis import compare_recording

        fields["chi2"] = compare_recording(recording, chosen_effects(), model="saturated").chi2
    if "diagnose" in plan.steps:
        from orchestrator.diagnosis import diagnose_and_keep
        from orchestrator.experiment_design.proposal import next_experiment

        diagnosed = diagnose_and_keep(recording, chosen_effects(), propose=next_experiment, out=out)[0]
        fields |= rows.diagnosis_fields(diagnosed.report)
        if has_estimates(out):  # the model's map and R_s, if it has any
            fields |= rows.estimate_fields(rows.summary_of(recording, out))
    if "export" in plan.steps:
        _export(recording, out)


def _export(recording: Any, out: Path) -> None:
    from orchestrator.estimation import load_estimates
    from orchestrator.flux_maps import load_map
    from orchestrator.flux_maps.exporting import export_map

    if load_estimates(out).method is None:
        raise RecordingError(str(recording.path), "", "has no map to export")
    export_map(load_map(out), recording.manifest.motor, out / "export", recording=recording.manifest.name)
