"""Hashes of recordings and of truths, which do not depend on how a file was compressed or spaced."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.benchmark.definition import LOG, MAPPING

SIGNIFICANT_DIGITS = 6
"""Of a truth's numbers: the mathematical libraries of two machines differ in the sixteenth."""


def rounded(value: Any) -> Any:
    """The same JSON with each number to `SIGNIFICANT_DIGITS`."""
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(part) for part in value]
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.{SIGNIFICANT_DIGITS}g}")
    return value


def canonical(value: Any) -> bytes:
    """JSON with sorted keys and without spaces."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()


def truth_sha256(salt: str, truth: Any) -> str:
    """The seal of a truth; `scorer.py` computes it by itself."""
    return hashlib.sha256(salt.encode() + canonical(truth)).hexdigest()


def data_sha256(folder: Path) -> str:
    """Of a recording: its manifest without the files' own hashes, and its columns' bytes; of a log: its two files."""
    found = hashlib.sha256()
    if (folder / LOG).exists():
        for name in (LOG, MAPPING):
            found.update((folder / name).read_bytes())
        return found.hexdigest()
    import pyarrow.parquet as pq

    manifest = json.loads((folder / "recording.json").read_text(encoding="utf-8"))
    found.update(canonical({**manifest, "segments": [{**s, "sha256": None} for s in manifest["segments"]]}))
    for segment in manifest["segments"]:
        table = pq.read_table(folder / "captures" / f"{segment['id']}.parquet")
        for name in sorted(table.column_names):
            found.update(name.encode() + np.ascontiguousarray(table[name].to_numpy()).tobytes())
    return found.hexdigest()
