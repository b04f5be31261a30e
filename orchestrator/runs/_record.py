"""`run.json`: what was asked for, of which drive, by which code; without what the analysis must not see."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any, Literal

from orchestrator.runs._provenance import Provenance
from protocols import Capabilities, DriveRecord, Procedure, RecordingError, Strict


class RunRecord(Strict):
    """A run as `run.json` describes it."""

    format: Literal["fluxbench-run"] = "fluxbench-run"
    version: Literal[1] = 1
    name: str
    created: str
    """ISO 8601 in UTC."""
    seed: int
    procedure: Procedure
    """With each sealed drive option replaced by its SHA-256."""
    procedure_sha256: str
    """Of `procedure` as it stands here; sealed options are in it by their own hashes."""
    sealed: tuple[str, ...] = ()
    """Names of the drive options that were sealed."""
    capabilities: Capabilities
    """What the drive said of itself."""
    provenance: Provenance

    @property
    def drive(self) -> DriveRecord:
        """The drive as a manifest describes it."""
        found = self.capabilities
        return DriveRecord(
            name=found.name,
            sampling_frequency_hz=found.sampling_frequency_hz,
            pwm_frequency_hz=found.pwm_frequency_hz,
            dc_bus_voltage_v=found.dc_bus_voltage_v,
            voltage_delay_samples=found.voltage_delay_samples,
        )


def make_record(
    procedure: Procedure, capabilities: Capabilities, provenance: Provenance, hidden: Mapping[str, Any]
) -> RunRecord:
    """The record of a run of `procedure`, the drive options in `hidden` replaced by their hashes."""
    redacted = _with_options(procedure, {name: {"sha256": hash_of(value)} for name, value in hidden.items()})
    return RunRecord(
        name=procedure.name,
        created=datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
        seed=procedure.seed,
        procedure=redacted,
        procedure_sha256=hash_of(redacted.model_dump(mode="json")),
        sealed=tuple(sorted(hidden)),
        capabilities=capabilities,
        provenance=provenance,
    )


def sealed_options_of(procedure: Procedure, sealed: Iterable[str]) -> dict[str, Any]:
    """The options of the procedure's drive that are among `sealed`, as they were written."""
    names = set(sealed)
    return {name: value for name, value in procedure.drive.options.items() if name in names}


def unsealed(record: RunRecord, options: dict[str, Any], where: str) -> Procedure:
    """The procedure as it was run; raises `RecordingError` where `options` are not what was sealed."""
    for name in record.sealed:
        if record.procedure.drive.options.get(name) != {"sha256": hash_of(options.get(name))}:
            raise RecordingError(where, name, "is not the option that the run was made with (its hash differs)")
    return _with_options(record.procedure, {name: options[name] for name in record.sealed})


def _with_options(procedure: Procedure, options: dict[str, Any]) -> Procedure:
    drive = procedure.drive.model_validate({**procedure.drive.model_dump(), **options})
    return procedure.model_copy(update={"drive": drive})


def hash_of(value: object) -> str:
    """SHA-256 of a JSON value, whatever its layout in a file."""
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
