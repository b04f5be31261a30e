"""The command's words; what it runs is the adaptive stage's own business."""

from __future__ import annotations

from pathlib import Path

import pytest

from plugins.commands.commission import percent
from protocols import InputError
from tests.support.processes import called


@pytest.mark.parametrize(("text", "value"), [("0.2%", 0.2), (" .5 % ", 0.5), ("1%", 1.0)])
def test_a_target_is_a_percentage(text: str, value: float) -> None:
    assert percent(text) == value


@pytest.mark.parametrize("text", ["0.2", "0%", "-1%", "a%", ""])
def test_what_is_no_percentage_is_one_line(text: str) -> None:
    with pytest.raises(InputError, match="expected a percentage"):
        percent(text)


def test_bad_words_end_with_2_and_leave_nothing_behind(tmp_path: Path) -> None:
    done = called("commission", "--until", "0.2", "--out", tmp_path / "run")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()
