"""Make the set: recordings, sealed truths and the manifest, and say where they differ from the frozen table."""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from orchestrator.benchmark.definition import MANIFEST, NAME, RECORDINGS, TRUTHS, VERSION, Row, effect_sizes
from orchestrator.benchmark.sealing import data_sha256, rounded, truth_sha256
from tests.blind.benchmark.logs import write_log
from tests.blind.benchmark.plants import made_by
from tests.blind.benchmark.truths import truth_of


def make_set(rows: Sequence[Row], out: Path, tell: Callable[[str], None] = lambda _: None) -> list[str]:
    """Write the recordings that are not there yet, their truths, and the manifest of what is there.

    Returns
    -------
    list of str
        What is missing or differs from the table, a line each.
    """
    (out / RECORDINGS).mkdir(parents=True, exist_ok=True)
    (out / TRUTHS).mkdir(exist_ok=True)
    remarks: list[str] = []
    entries: dict[str, Any] = {entry["id"]: entry for entry in _entries(out)}
    for row in rows:
        if row.id in entries and (out / RECORDINGS / row.id).exists():
            entries[row.id] = {**entries[row.id], "data_sha256": data_sha256(out / RECORDINGS / row.id)}
            continue
        tell(row.id)
        try:
            entries[row.id] = make_one(row, out)
        except ModuleNotFoundError as missing:
            remarks.append(f"{row.id}: not made, as the package {missing.name} is not installed")
            continue
        _write(out / MANIFEST, manifest(sorted(entries.values(), key=lambda entry: str(entry["id"]))))
    for row in rows:
        entry = entries.get(row.id, {})
        for what in ("data_sha256", "truth_sha256"):
            frozen = getattr(row, what)
            if entry and frozen and entry[what] != frozen:
                remarks.append(f"{row.id}: {what.removesuffix('_sha256')} differs from that of version {VERSION}")
    return remarks


def make_one(row: Row, out: Path) -> dict[str, Any]:
    """Make one recording and its truth; returns its entry of the manifest."""
    made = made_by(row)
    folder = out / RECORDINGS / row.id
    with tempfile.TemporaryDirectory(prefix=".making-", dir=out) as place:
        recording = Path(place) / "recording"
        made.record(recording)
        done = write_log(recording, Path(place) / "log") if row.log else recording
        shutil.rmtree(folder, ignore_errors=True)
        done.rename(folder)
    truth = rounded(truth_of(row.id, row.kind, row.origin, row.motor, row.without, made))
    _write(out / TRUTHS / f"{row.id}.json", truth)
    salt = hashlib.sha256(f"{NAME} {VERSION} {row.id} {row.seed}".encode()).hexdigest()[:16]
    return {
        "id": row.id,
        "without": [row.without] if row.without else [],
        "rated_flux_wb": float(f"{made.plate.rated_flux_wb:.6g}"),
        "points_a": [list(point) for point in made.points()],
        "salt": salt,
        "data_sha256": data_sha256(folder),
        "truth_sha256": truth_sha256(salt, truth),
    }


def manifest(entries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """`benchmark.json`: what an answerer may know."""
    return {
        "format": "fluxbench-benchmark",
        "name": NAME,
        "version": VERSION,
        "effects": {name: {"unit": size.unit, "size": size.meaning} for name, size in effect_sizes().items()},
        "recordings": list(entries),
    }


def _entries(out: Path) -> list[dict[str, Any]]:
    file = out / MANIFEST
    return json.loads(file.read_text(encoding="utf-8"))["recordings"] if file.exists() else []


def _write(file: Path, content: Any) -> None:
    file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
