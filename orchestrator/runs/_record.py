"""`run.json`: procedure, drive and code of a run, without the options that no analysis may see."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Literal

from orchestrator.runs._provenance import Provenance
from protocols import Capabilities, DriveRecord, Procedure, RecordingError, Strict


class RunRecord(Strict):
    """The content of `run.json`."""

    format: Literal["fluxbench-run"] = "fluxbench-run"
    version: Literal[1] = 1
    name: str
    created: str
    """ISO 8601 in UTC."""
    seed: int
    procedure: Procedure
    """The procedure with each sealed drive option replaced by its SHA-256."""
    procedure_sha256: str
    """Hash of `procedure` in this form, with the hashes of sealed options."""
    sealed: tuple[str, ...] = ()
    """Names of the sealed drive options."""
    capabilities: Capabilities
    """Capabilities that the drive reported."""
    provenance: Provenance

    @property
    def drive(self) -> DriveRecord:
        """The drive in a manifest's form."""
        drive = self.capabilities
        return DriveRecord(
            name=drive.name,
            sampling_frequency_hz=drive.sampling_frequency_hz,
            pwm_frequency_hz=drive.pwm_frequency_hz,
            dc_bus_voltage_v=drive.dc_bus_voltage_v,
            voltage_delay_samples=drive.voltage_delay_samples,
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


def unsealed(record: RunRecord, options: dict[str, Any], where: str) -> Procedure:
    """The procedure with its sealed options; raises `RecordingError` where `options` do not match their hashes."""
    for name in record.sealed:
        if record.procedure.drive.options.get(name) != {"sha256": hash_of(options.get(name))}:
            raise RecordingError(where, name, "is not the run's own option (its hash differs)")
    return _with_options(record.procedure, {name: options[name] for name in record.sealed})


def _with_options(procedure: Procedure, options: dict[str, Any]) -> Procedure:
    drive = procedure.drive.model_validate({**procedure.drive.model_dump(), **options})
    return procedure.model_copy(update={"drive": drive})


def hash_of(value: object) -> str:
    """SHA-256 of a JSON value, whatever its layout in a file."""
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
