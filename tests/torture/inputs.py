"""Files with something wrong in them: other values, other bytes, an end that is missing."""

from __future__ import annotations

import copy
import json
import random
import shutil
from pathlib import Path
from typing import Any

import yaml

from tests.support.processes import called
from tests.support.tiny import tiny_document

REDUCED = Path(__file__).parents[1] / "data" / "pm400-reduced"


def mutated(rng: random.Random, folder: Path) -> str:
    """A file with something wrong in it is read, or refused in one line."""
    if rng.random() < 0.4:
        file = folder / "procedure.yaml"
        file.write_bytes(damaged(rng, changed_document(rng, tiny_document())))
        words: list[str | Path] = ["check", file]
    else:
        recording = folder / "recording"
        (recording / "captures").mkdir(parents=True)
        manifest = json.loads((REDUCED / "recording.json").read_text(encoding="utf-8"))
        manifest["segments"] = [s for s in manifest["segments"] if s["stage"] == "resistance"][:3]
        names = [f"{segment['id']}.parquet" for segment in manifest["segments"]]
        for name in names:
            shutil.copy(REDUCED / "captures" / name, recording / "captures" / name)
        chosen = recording / "captures" / rng.choice(names)
        if rng.random() < 0.6:
            (recording / "recording.json").write_bytes(damaged(rng, changed_document(rng, manifest)))
        else:
            for segment in manifest["segments"]:
                segment["sha256"] = None
            (recording / "recording.json").write_text(json.dumps(manifest), encoding="utf-8")
            chosen.write_bytes(damaged(rng, chosen.read_bytes(), always=True))
        words = ["estimate", recording, "--estimator", "resistance", "--out", folder / "out"]
    done = called(*words)
    assert done.returncode in (0, 2, 3), done.stderr
    assert done.stderr.count("\n") <= 1, done.stderr
    assert (done.returncode == 0) == (not done.stderr), done.stderr
    return {0: "taken", 2: "refused", 3: "given up"}[done.returncode]


_ODD: tuple[Any, ...] = (
    True, None, -1, 0, 1e300, -1e-300, 2**70, "", "x" * 5000, "\x1b[2J\u202e",
    [], {}, [[]], "nan", "1", 0.5, [1, 2], {"a": {}},
)  # fmt: skip


def changed_document(rng: random.Random, document: Any, *, yaml_too: bool = True) -> bytes:
    """A document with some values replaced, left out or doubled, as JSON or YAML."""
    document = json.loads(json.dumps(document))
    for _ in range(rng.choice((0, 1, 1, 1, 2, 5))):
        here: Any = document
        while isinstance(here, dict | list) and here:
            key = rng.choice(list(here)) if isinstance(here, dict) else rng.randrange(len(here))
            if not isinstance(here[key], dict | list) or not here[key] or rng.random() < 0.15:
                if rng.random() < 0.2:
                    del here[key]
                else:
                    here[key] = copy.deepcopy(rng.choice(_ODD))
                break
            here = here[key]
    text = json.dumps(document) if not yaml_too or rng.random() < 0.5 else yaml.safe_dump(document)
    return text.encode("utf-8", "surrogatepass")


def damaged(rng: random.Random, content: bytes, *, always: bool = False) -> bytes:
    """Bytes, some of them others, or an end that is missing."""
    if not always and rng.random() < 0.7:
        return content
    data = bytearray(content)
    for _ in range(rng.choice((1, 2, 10, 100))):
        data[rng.randrange(max(0, len(data) - rng.choice((400, 4000, len(data)))), len(data))] = rng.randrange(256)
    return bytes(data[: rng.randrange(len(data))] if rng.random() < 0.2 else data)
