"""Small recordings in large numbers: the reference motor's rests alone, each with a name of its own."""

from __future__ import annotations

import json
import os
from pathlib import Path

REFERENCE = Path("tests/data/pm400-reduced").resolve()
KEPT = ("gates_off-000", "resistance-000", "resistance-003", "resistance-009", "resistance-028")


def small_recordings(folder: Path, count: int) -> list[Path]:
    """So many recordings `r000`, ... in a folder; captures are links to the same files."""
    manifest = json.loads((REFERENCE / "recording.json").read_text())
    manifest["segments"] = [segment for segment in manifest["segments"] if segment["id"] in KEPT]
    made = []
    for number in range(count):
        path = folder / f"r{number:03d}"
        (path / "captures").mkdir(parents=True)
        (path / "recording.json").write_text(json.dumps({**manifest, "name": f"motor-{number}"}))
        for name in KEPT:
            os.link(_local_copy(folder, name), path / "captures" / f"{name}.parquet")
        made.append(path)
    return made


def _local_copy(folder: Path, name: str) -> Path:
    """Links do not reach from one file system to another."""
    copy = folder / ".captures" / f"{name}.parquet"
    if not copy.exists():
        copy.parent.mkdir(exist_ok=True)
        copy.write_bytes((REFERENCE / "captures" / copy.name).read_bytes())
    return copy


def damage(recording: Path) -> None:
    """Change a byte in the middle of a capture."""
    file = recording / "captures" / f"{KEPT[1]}.parquet"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0xFF
    file.unlink()
    file.write_bytes(content)
