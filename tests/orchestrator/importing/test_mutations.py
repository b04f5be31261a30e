"""Mappings and files that somebody spoilt: an import, or one line and exit code 2 with nothing written."""

from __future__ import annotations

import copy
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from orchestrator.interface.cli._running import run_app
from tests.orchestrator.importing.benches import held_current, phase_log, write_table

COLUMNS, PLAIN = phase_log(*held_current(120))
MAPPING: dict[str, Any] = PLAIN | {
    "bus": {"column": "udc", "unit": "V", "offset": 0.0, "factor": 1.0},
    "rotor_angle": {"column": "theta", "unit": "deg", "offset": 0.0, "factor": 1.0, "mechanical": True},
    "split_at_gaps": True,
    "segment_column": "what",
    "csv": {"delimiter": ",", "decimal": ".", "skip_rows": 0},
    "files": [
        {"file": "log*", "current": {"unit": "A", "offset": {"a": 0.0, "b": 0.0, "c": 0.0}}},
        {
            "file": "side*",
            "beside": "log*",
            "columns": ["udc"],
            "align": "stamps",
            "time": {"column": "t", "unit": "s"},
        },
    ],
    "segments": [{"label": "x", "stage": "resistance", "from_s": 0.0, "to_s": 9.0, "settings": {"current_d_a": 2.0}}],
}
LOG = COLUMNS | {"theta": [0.0] * 120, "what": ["x"] * 120}
SIDE = {"t": COLUMNS["t"], "udc": [540.0] * 120}
VALUES: list[Any] = [
    *(None, True, 0, -1, 1e30, -1e-30, 3.5, 10**400, 2**63, [], [1, "a"], {}, {"a": "ia"}, {"value": 1}),
    *("", "x", "\x1b[31m", "A" * 300, "ia", "dq", "abc", "switching", "duty", "iso", "tick", "edges", "*", "../x"),
]
BROKEN = ("\t", ": ", "- ", "&a ", "!!python/object:os.system ", "\x00", "é")


def places(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The key path of everything in a document."""
    pairs = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in pairs:
        yield (*path, key)
        yield from places(value, (*path, key))


def spoilt_mapping(rng: random.Random) -> str:
    tree = copy.deepcopy(MAPPING)
    for _ in range(rng.choice((1, 1, 2))):
        path = rng.choice(list(places(tree)))
        above: Any = tree
        for key in path[:-1]:
            above = above[key]
        if rng.random() < 0.3:
            del above[path[-1]]
        elif rng.random() < 0.2 and isinstance(path[-1], str):
            above[f"{path[-1]}x"] = above.pop(path[-1])
        else:
            above[path[-1]] = rng.choice(VALUES)
    text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
    if rng.random() < 0.2:
        at = rng.randrange(len(text))
        text = text[:at] + rng.choice(BROKEN) + text[at + 1 :]
    return text


def spoilt_bytes(rng: random.Random, content: bytes) -> bytes:
    at = rng.randrange(len(content))
    end = min(len(content), at + rng.choice((1, 1, 40, 5000)))
    noise = bytes(rng.randrange(256) for _ in range(9))
    put = rng.choice((b"", b",", b"\n", b"nan", b"1e999", b"\xff\xfe", b'"', b"-", noise))
    return content[:at] + put + content[end:]


@pytest.mark.parametrize(
    ("seed", "turns"), [(0, 9), *(pytest.param(seed, 20, marks=pytest.mark.slow) for seed in range(1, 16))]
)
def test_what_is_spoilt_is_one_line_and_nothing_is_written(
    seed: int, turns: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    rng = random.Random(seed)
    monkeypatch.chdir(tmp_path)
    files = [write_table(tmp_path / "log.csv", LOG), write_table(tmp_path / "side.csv", SIDE)]
    sound = [path.read_bytes() for path in files]
    refused = 0
    for turn in range(turns):
        (tmp_path / "m.yaml").write_text(yaml.safe_dump(MAPPING, sort_keys=False))
        for path, content in zip(files, sound, strict=True):
            path.write_bytes(content)
        if turn % 3 < 2:
            (tmp_path / "m.yaml").write_text(spoilt_mapping(rng))
        else:
            which = rng.randrange(2)
            files[which].write_bytes(spoilt_bytes(rng, sound[which]))
        out = f"out{turn}"
        code = run_app(["import", "m.yaml", "log.csv", "side.csv", "--out", out])
        message = [line for line in capfd.readouterr().err.splitlines() if not line.startswith("  ")]
        left = [entry.name for entry in tmp_path.iterdir() if "out" in entry.name and entry.is_dir()]
        if code == 0:
            assert left == [out]
            assert message == []
            (tmp_path / out).rename(tmp_path.parent / f"{tmp_path.name}-{turn}")
            continue
        refused += 1
        assert (code, left) == (2, []), message
        assert len(message) == 1, message
        assert message[0].startswith("fluxbench: ")
    assert refused > turns // 3


def test_the_mapping_that_is_spoilt_is_sound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_table(tmp_path / "log.csv", LOG)
    write_table(tmp_path / "side.csv", SIDE)
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(MAPPING, sort_keys=False))
    assert run_app(["import", "m.yaml", "log.csv", "side.csv", "--out", "out"]) == 0
