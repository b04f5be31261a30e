"""A small set of the benchmark, written by hand: truths, seals and the answers that are right."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from orchestrator.benchmark import effect_sizes, truth_sha256
from orchestrator.benchmark.sealing import rounded

SALT = "0123456789abcdef"
POINTS = [[-1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
FLUX = [[-0.04, 0.0], [0.0, 0.06], [0.04, 0.05]]


def effect(name: str, size: float, twins: tuple[str, ...] = (), *, main: bool = True) -> dict[str, Any]:
    """A hidden effect as it is sealed."""
    return {
        "name": name, "accepted": sorted((name, *twins)), "relative": 1.0, "main": main, "material": None,
        "size": [size, size], "unit": effect_sizes()[name].unit,
    }  # fmt: skip


def truth(
    id: str, kind: str, verdict: str, effects: list[dict[str, Any]], foreign: str | None = None
) -> dict[str, Any]:
    """A sealed object."""
    return {
        "id": id, "class": kind, "origin": "own", "motor": "test", "verdict": verdict, "foreign": foreign,
        "effects": effects, "also": [], "resistance_ohm": 4.3, "flux_wb": FLUX,
    }  # fmt: skip


TRUTHS = [
    truth("r001", "clean", "clean", []),
    truth("r002", "single", "explained", [effect("dead_time", 8.0, ("device_drop",))]),
    truth("r003", "double", "explained", [effect("hysteresis", 0.03), effect("voltage_bias", -0.2)]),
    truth("r004", "foreign", "unknown", [], "poor_contact"),
]


def write_set(folder: Path) -> Path:
    """Write manifest and truths; returns the folder."""
    (folder / "truth").mkdir(parents=True)
    entries = []
    for one in map(rounded, TRUTHS):
        (folder / "truth" / f"{one['id']}.json").write_text(json.dumps(one, indent=1))
        entries.append(
            {
                "id": one["id"], "without": [], "rated_flux_wb": 0.3, "points_a": POINTS, "salt": SALT,
                "data_sha256": "", "truth_sha256": truth_sha256(SALT, one),
            }
        )  # fmt: skip
    effects = {name: {"unit": size.unit, "size": size.meaning} for name, size in effect_sizes().items()}
    manifest = {
        "format": "fluxbench-benchmark", "name": "test", "version": 1, "effects": effects, "recordings": entries,
    }  # fmt: skip
    (folder / "benchmark.json").write_text(json.dumps(manifest))
    return folder


def right_answers() -> list[dict[str, Any]]:
    """One for each recording, right in everything."""
    return [
        {
            "id": one["id"],
            "verdict": one["verdict"],
            "names": [
                {
                    "name": e["name"], "size": e["size"][0], "unit": e["unit"], "low": e["size"][0] - 0.01,
                    "high": e["size"][1] + 0.01,
                }
                for e in one["effects"]
            ],
            "resistance_ohm": {"value": 4.3, "low": 4.2, "high": 4.4},
            "flux_wb": FLUX,
            "flux_std_wb": [[1e-4, 1e-4]] * 3,
            "usable": True,
            "seconds": 1.0,
        }
        for one in TRUTHS
    ]  # fmt: skip


def write_answers(file: Path, answers: list[dict[str, Any]]) -> Path:
    """As JSON lines."""
    file.write_text("".join(json.dumps(answer) + "\n" for answer in answers))
    return file
