"""The workflows call what there is: targets of the Makefile, folders of tests, and the project's Python."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.fluxbench.test_other_systems import ROOMS

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def jobs(file: Path) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(file.read_text())["jobs"]
    return found


def steps(file: Path) -> Iterator[dict[str, Any]]:
    for job in jobs(file).values():
        yield from job["steps"]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_workflow_calls_targets_and_folders_that_there_are(file: Path) -> None:
    makefile = (ROOT / "Makefile").read_text()
    for command in (step["run"] for step in steps(file) if "run" in step):
        for target in re.findall(r"\bmake ([\w-]+)", command):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE)
        for folder in re.findall(r"tests/[\w/]+", command):
            assert (ROOT / folder).is_dir()


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_workflow_installs_the_python_that_the_project_is_made_for(file: Path) -> None:
    versions = [step["with"]["python-version"] for step in steps(file) if "setup-python" in step.get("uses", "")]
    assert len(versions) == len(jobs(file))
    assert set(versions) == {"3.11"}


def test_windows_and_macos_run_the_rooms_that_pass_without_posix() -> None:
    job = jobs(ROOT / ".github" / "workflows" / "test.yml")["rooms"]
    (command,) = [step["run"] for step in job["steps"] if "pytest" in step.get("run", "")]
    assert sorted(re.findall(r"tests/([\w/]+)", command)) == sorted(ROOMS)
    assert set(job["strategy"]["matrix"]["system"]) == {"macos-latest", "windows-latest"}
