"""The benchmark's words and sums."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.diagnosis import PARTS, REFERENCE, Row, cells, fields_in, parsed, python, size_of

HERE = Path(__file__).parents[2]


def test_all_parts_are_run_where_none_is_named() -> None:
    requested = parsed([])
    assert requested.parts == list(PARTS)
    assert requested.against == REFERENCE
    assert HERE not in requested.cache.parents


def test_parts_commit_and_cache_are_chosen_by_words(tmp_path: Path) -> None:
    requested = parsed(["size", "memory", "--against", "HEAD", "--cache", str(tmp_path)])
    assert (requested.parts, requested.against, requested.cache) == (["size", "memory"], "HEAD", tmp_path)


def test_a_part_that_there_is_not_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parsed(["speed"])
    assert "no part 'speed': there is diagnose" in capsys.readouterr().err


def test_a_row_is_label_value_reference_ratio_and_aim() -> None:
    assert cells(Row("estimate [s]", 3.0, 10.0, "at most 0.3")) == ("estimate [s]", "3", "10", "0.3", "at most 0.3")
    assert cells(Row("lines", 13000.0, None)) == ("lines", "13000", "--", "--", "--")


def test_fields_are_counted_without_those_that_hold_other_fields() -> None:
    source = (
        "from c import C\n\nclass A:\n    x: float = 1.0\n    y: int = 2\n    z = 3\n\n"
        "class B:\n    a: A\n    c: C\n    w: float\n\nn: int = 1\n"
    )
    assert fields_in(source) == 3


def test_the_size_of_a_tree_is_lines_files_and_fields(tmp_path: Path) -> None:
    folder = tmp_path / "orchestrator" / "diagnosis" / "fitting"
    folder.mkdir(parents=True)
    (folder / "fit.py").write_text("a = 1\nb = 2\n")
    (folder.parent / "criteria.py").write_text("class A:\n    x: float\n")
    assert size_of(tmp_path) == (4, 2, 1)


def test_a_command_s_cost_is_its_own_and_its_failure_is_stated(tmp_path: Path) -> None:
    busy = "import time\nwhile time.process_time() < 0.3: pass"
    cost = python(tmp_path, "-c", busy)
    assert 0.3 <= cost.cpu_s < 3.0
    assert cost.peak_mb > 1.0
    with pytest.raises(RuntimeError, match="out of order"):
        python(tmp_path, "-c", "raise SystemExit('out of order')")
