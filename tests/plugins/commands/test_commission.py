"""The command's words; what it runs is the adaptive stage's own business."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

import pytest

from plugins.commands.commission import percent
from protocols import InputError, Procedure
from tests.orchestrator.shelf.example_runs import a_run
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


def test_a_queue_names_its_motors_and_their_folders_itself() -> None:
    done = called("commission", "--queue", "--serial", "PM-1")
    assert done.returncode == 2
    assert done.stderr == "fluxbench: --queue: excludes --serial and --out\n"


@pytest.mark.parametrize("passes", [True, False])
def test_the_motor_s_limits_decide_about_the_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, passes: bool
) -> None:
    """The measurement itself, of a minute, is replaced by its results."""
    procedures = []

    def measured(procedure: Procedure, *, out: Path, **options: object) -> SimpleNamespace:
        procedures.append(procedure)
        accept = procedure.accept
        assert accept is not None
        about = procedure.about.model_dump()
        return SimpleNamespace(path=a_run(out, about=about, accept=accept.model_dump(exclude_defaults=True)))

    monkeypatch.setattr("orchestrator.interface.api.run", measured)
    limit = f"accept.max_resistance_ohm={4.5 if passes else 4.2}"
    words = ("--set", limit, "--serial", "PM-7", "--out", tmp_path / "run", "--junit", tmp_path / "out.xml")
    done = called("commission", *words)
    assert done.returncode == (0 if passes else 4)
    assert done.stdout.startswith(f"PM-7  {'PASS' if passes else 'FAIL'}  ")
    assert ("not accepted: R_s 4.250 Ω" in done.stderr) is not passes
    assert ET.parse(tmp_path / "out.xml").find(".//testsuite[@name='PM-7']") is not None
    assert [procedure.about.serial for procedure in procedures] == ["PM-7"]
