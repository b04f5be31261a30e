"""What the README tells a newcomer to type is typed here, in order, in a fresh folder."""

from __future__ import annotations

import re
import shlex
import subprocess
from contextlib import chdir
from pathlib import Path

import pytest

from orchestrator.registry.plugins import PluginKind, installed
from tests.support.processes import called
from tests.support.tiny import all_effects_but
from tests.support.undrawn import draw_nothing

ROOT = Path(__file__).parents[1]
MYSTERY = re.compile(r"\bmystery\b|mystery-4")
"""Its commands fit a model again and again: a minute or two."""
DEMO = re.compile(r"^fluxbench run demo\b")
LONG = re.compile(r"^fluxbench estimate\b")
"""The run's estimates once more: seconds."""
OTHERS = all_effects_but("dead_time", "winding_heating")
SHORT = (
    " --set stages.7.held_a=[0] --set stages.8.step_a=2.5 --set stages.11.rounds=0"
    f" --set 'stages.11.without=[{','.join(OTHERS)}]' --set drive.watchdog_s=60"
)
"""The demo with a few points of each stage, few effects to tell apart, and without the experiment that its diagnosis
asks for; with patience, where the machine is busy. Nothing is drawn."""


def console_lines(page: Path) -> list[str]:
    """The lines of a page's console blocks."""
    blocks = re.findall(r"^```console\n(.*?)^```", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    return [line for block in blocks for line in block.splitlines() if line]


@pytest.mark.long
@pytest.mark.parametrize("added", [SHORT, pytest.param("", marks=pytest.mark.slow)], ids=["short", "as it stands"])
def test_every_command_of_the_readme_works(added: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if added:
        draw_nothing(monkeypatch)
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    lines = console_lines(ROOT / "README.md")
    assert len(lines) > 5
    left_out = [MYSTERY, LONG] if added else [MYSTERY]
    lines = [line for line in lines if not any(pattern.search(line) for pattern in left_out)]
    type_in([line + (added if DEMO.match(line) else "") for line in lines], tmp_path)
    shown = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), flags=re.DOTALL | re.MULTILINE)
    assert len(shown) == 1
    with chdir(tmp_path):
        exec(compile(shown[0], "README.md", "exec"), {})


def test_the_readme_s_motor_file_is_whole(tmp_path: Path) -> None:
    (text,) = re.findall(
        r"^```yaml\n(motor:\n.*?)^```", (ROOT / "README.md").read_text(), flags=re.DOTALL | re.MULTILINE
    )
    (tmp_path / "motor.yaml").write_text(text)
    done = called("check", "demo", "--motor", tmp_path / "motor.yaml")
    assert done.returncode == 0, done.stderr
    assert "limits, as the motor file has none of these: current_a" in done.stdout


@pytest.mark.slow
def test_the_readme_s_mystery_is_found(tmp_path: Path) -> None:
    type_in([line for line in console_lines(ROOT / "README.md") if MYSTERY.search(line)], tmp_path)


def type_in(lines: list[str], tmp_path: Path) -> None:
    for line in lines:
        command, _, target = line.partition(" > ")
        name, *words = shlex.split(command, comments=True)
        assert name == "fluxbench"
        done = called(*words, cwd=tmp_path)
        assert done.returncode == 0, f"{line}: {done.stderr}"
        if target:
            (tmp_path / target).write_text(done.stdout)


def test_every_link_between_pages_leads_somewhere() -> None:
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_two_commands_are_targets_of_the_makefile() -> None:
    makefile = (ROOT / "Makefile").read_text()
    for target in ("demo", "test"):
        assert f"    make {target}" in (ROOT / "README.md").read_text()
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE)


def test_make_help_lists_every_target() -> None:
    makefile = (ROOT / "Makefile").read_text()
    (phony,) = re.findall(r"^\.PHONY: (.*)$", makefile, flags=re.MULTILINE)
    done = subprocess.run(
        ["make", "--no-print-directory", "help"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert sorted(line.split()[0] for line in done.stdout.splitlines()) == sorted(phony.split())


def test_pages_count_the_effects_that_there_are() -> None:
    count = len(installed(PluginKind.EFFECTS))
    assert f"{count} effects in all" in (ROOT / "README.md").read_text()
    assert f"It diagnoses {count} effects" in (ROOT / "docs" / "how-it-compares.md").read_text()
