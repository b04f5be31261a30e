"""What is done with a run's results, spoilt before: a drive is tuned by them, and a law is looked for.

Where the answer is no refusal, everything that was written is finite, and the C code compiles.
"""

from __future__ import annotations

import functools
import json
import math
import random
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.orchestrator.tuning.closed_loop import STRICT
from tests.support.processes import called
from tests.support.tiny import STAGES, run_tiny
from tests.torture.inputs import changed_document, damaged
from tests.torture.numbers import EXTREMES, limited

TUNING_SECONDS = 60.0
SPOILT = ("results/flux_map.nc", "results/estimates.json", "results/diagnosis.json", "model.json", "recording.json")
LIMITS = ("--current-a", "--bus-v", "--speed-rpm", "--sampling-hz")


def tuned(rng: random.Random, folder: Path) -> str:
    """A drive is tuned by results of which a file or a limit is spoilt: finite files that compile, or one line."""
    run, out = folder / "run", folder / "out"
    shutil.copytree(_diagnosed_run(), run)
    words: list[str | Path] = ["tune", run, "--out", out]
    if rng.random() < 0.6:
        _spoil(rng, run / rng.choice(SPOILT))
    for limit in rng.sample(LIMITS, rng.choice((0, 1, 2))):
        value = rng.choice((*EXTREMES, math.exp(rng.uniform(-7.0, 12.0))))
        words += [limit, str(value)]
    with limited(TUNING_SECONDS):
        done = called(*words)
    assert done.returncode in (0, 2, 3), done.stderr
    if done.returncode:
        assert done.stderr.count("\n") == 1, done.stderr
        assert not out.exists(), "refused, and something was written"
        return "refused"
    _require_finite(out)
    return "tuned"


def discovered(rng: random.Random, folder: Path) -> str:
    """A law is looked for in a run of which a file is spoilt: an answer, or one line and no file."""
    run, target = folder / "run", folder / "law.py"
    shutil.copytree(_diagnosed_run(), run)
    if rng.random() < 0.3:
        captures: Sequence[Path] = sorted((run / "captures").iterdir())
        _spoil(rng, rng.choice(captures))
    else:
        _spoil(rng, run / rng.choice(SPOILT))
    with limited(TUNING_SECONDS):
        done = called("discover", run, "--write", target)
    assert done.returncode in (0, 2, 3), done.stderr
    if done.returncode:
        assert done.stderr.count("\n") == 1, done.stderr
        assert not target.exists(), "refused, and a law was written"
        return "refused"
    return "a law" if target.exists() else "nothing to learn"


@functools.cache
def _diagnosed_run() -> Path:
    """A small run with its diagnosis, in a folder that lasts as long as the process."""
    folder = Path(_lasting().name)
    return run_tiny(folder, stages=[*STAGES, {"kind": "diagnose", "rounds": 0}]).path


@functools.cache
def _lasting() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="torture-run-")


def _spoil(rng: random.Random, file: Path) -> None:
    """Other values in a document, or other bytes."""
    if file.suffix == ".json" and rng.random() < 0.8:
        file.write_bytes(changed_document(rng, json.loads(file.read_text(encoding="utf-8")), yaml_too=False))
    else:
        file.write_bytes(damaged(rng, file.read_bytes(), always=True))


def _require_finite(out: Path) -> None:
    """Assert that a tuning's files hold finite numbers alone, and that its code compiles without a warning."""

    def refused(name: str) -> Any:
        raise AssertionError(f"{name} in tuning.json")

    json.loads((out / "tuning.json").read_text(encoding="utf-8"), parse_constant=refused)
    for table in out.glob("*.csv"):
        rows = np.genfromtxt(table, delimiter=",", skip_header=1)
        assert np.isfinite(rows).all(), table.name
    for source in out.glob("*.c"):
        words = re.findall(r"\b(?:nan|inf)f?\b", source.read_text(encoding="utf-8"), re.IGNORECASE)
        assert not words, f"{words[0]} in {source.name}"
        compiler = shutil.which("gcc")
        if compiler is not None:
            command: list[str | Path] = [compiler, *STRICT, "-fsyntax-only", source]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr
