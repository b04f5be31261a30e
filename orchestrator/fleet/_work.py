"""What a worker does with one source: tell what it is, and do what was asked with it. Knows no other and no table."""

from __future__ import annotations

import platform
import resource
import tempfile
import time
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any

from pydantic import Field

from orchestrator.fleet._content import at_hand, content_sha256
from orchestrator.fleet._engine import said_of
from orchestrator.fleet._sources import Source
from protocols import FluxbenchError, RecordingError, Strict
from protocols.fleet import FleetRow, FleetStep, FleetVersions

SCRATCH, IMPORTED = "fluxbench-fleet-", "recording"
"""A folder for the time that one source takes, and in it what an import makes of it."""


class Plan(Strict):
    """What is asked of each recording."""

    steps: tuple[FleetStep, ...] = Field(default=("estimate",), min_length=1)
    mapping: Path | None = None
    """With the step ``import``: the file that says what a measurement file's columns are."""
    keep: Path | None = None
    """Folder, the same on all workers, that gets each recording's results and exports, below its key."""


class Identified(Strict):
    """What a source is, by what is in it."""

    content_sha256: str | None
    failed: str | None = None
    fetched: bool = False
    """Whether it lies beside the worker that was asked, until it is worked on."""


class Order(Strict):
    """A source to work on."""

    source: Source
    key: str
    content_sha256: str | None
    plan: Plan


def identify(source: Source) -> Identified:
    """Fetch and hash a source; what is wrong with it is told, not raised."""
    try:
        with at_hand(source, stays=True) as path:
            return Identified(content_sha256=content_sha256(path), fetched=str(path) != source.url)
    except FluxbenchError as error:
        return Identified(content_sha256=None, failed=said_of(error))


def work_on(order: Order, _: Identified | None = None) -> dict[str, Any]:
    """The row of a source, as a mapping of its fields; what is wrong with it is in the field `failed`."""
    began = time.perf_counter()
    fields: dict[str, Any] = {}
    places: list[str] = []
    try:
        with at_hand(order.source, stays=False) as path, tempfile.TemporaryDirectory(prefix=SCRATCH) as scratch:
            places = [f"{scratch}/{IMPORTED}", str(path)]
            _do(order, path, Path(scratch), fields)
    except Exception as error:  # whatever a recording makes go wrong is its own row's
        fields["failed"] = said_of(error)
        for place in places:
            fields["failed"] = fields["failed"].replace(place, order.source.url)
    row = FleetRow(
        **{
            **bare_fields(order),
            **fields,
            "seconds": time.perf_counter() - began,
            "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        }
    )
    return row.model_dump()


def bare_fields(order: Order) -> dict[str, Any]:
    """What is known of an order before it is begun."""
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
    """Of what computes rows here."""
    return FleetVersions(fluxbench=version("fluxbench"), python=platform.python_version(), numpy=version("numpy"))


def _do(order: Order, path: Path, scratch: Path, fields: dict[str, Any]) -> None:
    """All steps, in their order; what was found before one fails stays in `fields`."""
    from orchestrator.estimation import has_estimates
    from orchestrator.fleet import _rows as rows
    from orchestrator.runs import open_any

    plan = order.plan
    out = scratch / "out" if plan.keep is None else plan.keep / order.key
    if plan.mapping is not None:
        path = _imported(plan.mapping, path, scratch / IMPORTED)
    recording = open_any(path)
    fields |= rows.identity(recording)
    fields |= rows.temperature(recording)
    if plan.mapping is not None:  # a mapping calls all files alike
        fields["name"] = PurePosixPath(order.source.url).stem
    if "estimate" in plan.steps or "export" in plan.steps:
        _estimate(recording, out)
        fields |= rows.estimated(rows.said_of(recording, out))
    if "compare" in plan.steps:
        fields |= _compare(recording)
    if "diagnose" in plan.steps:
        fields |= _diagnose(recording, out)
        if has_estimates(out):  # the model's map and R_s, where it delivers some
            fields |= rows.estimated(rows.said_of(recording, out))
    if "export" in plan.steps:
        _export(recording, out)


def _imported(mapping: Path, file: Path, out: Path) -> Path:
    from orchestrator.importing import import_files

    import_files(mapping, [file], out)
    return out


def _estimate(recording: Any, out: Path) -> None:
    from orchestrator.estimation import estimate_recording
    from orchestrator.registry import PluginKind, make_plugins

    estimate_recording(recording, make_plugins(PluginKind.ESTIMATORS, None), out)


def _compare(recording: Any) -> dict[str, Any]:
    from orchestrator.api import chosen_effects
    from orchestrator.diagnosis import compare_recording
    from orchestrator.fleet._rows import compared

    return compared(compare_recording(recording, chosen_effects(), model="saturated"))


def _diagnose(recording: Any, out: Path) -> dict[str, Any]:
    from orchestrator.api import chosen_effects
    from orchestrator.diagnosis import diagnose_and_keep
    from orchestrator.experiment_design.proposal import next_experiment
    from orchestrator.fleet._rows import diagnosed

    return diagnosed(diagnose_and_keep(recording, chosen_effects(), propose=next_experiment, out=out)[0].report)


def _export(recording: Any, out: Path) -> None:
    from orchestrator.estimation import load_estimates
    from orchestrator.exporting import export_map
    from orchestrator.flux_maps import load_map

    if load_estimates(out).method is None:
        raise RecordingError(str(recording.path), "", "no map came of it, so there is nothing to export")
    export_map(load_map(out), recording.manifest.motor, out / "export", recording=recording.manifest.name)
