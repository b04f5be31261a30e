"""A new package passes its kit before a line of it is changed."""

from __future__ import annotations

import configparser
import os
import re
import shlex
import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path
from typing import Any, get_args

import pytest

import protocols
from orchestrator.interface.cli._new import new
from orchestrator.interface.scaffolding import KINDS, write_package
from protocols import Capabilities, ExcitationKind, InputError, PluginError, Procedure, Stage
from tests.support.cases import few

ROOT = Path(__file__).parents[4]
NO_INDEX = re.compile(
    "Failed to establish a new connection|Temporary failure in name resolution|Network is unreachable"
)


def installed_as(folder: Path) -> None:
    """Leave the metadata that an installation would leave."""
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    info = folder / f"{project['name'].replace('-', '_')}-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 0.1.0\n")
    points = configparser.ConfigParser()
    points.read_dict(project["entry-points"])
    with (info / "entry_points.txt").open("w") as file:
        points.write(file)


def in_package(folder: Path, *command: str, paths: str = "") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *command],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join((paths or str(folder), str(ROOT)))},
        capture_output=True,
        text=True,
        timeout=120,
    )


def sign_and_size_of(folder: Path) -> dict[str, Any]:
    """The names of a new effect's own test, run beside its module without an import of either."""
    names: dict[str, Any] = {"__name__": __name__}
    for file in (folder / "fluxbench_fresh" / "fresh.py", folder / "tests" / "test_fresh.py"):
        lines = [line for line in file.read_text().splitlines() if "fluxbench_fresh" not in line]
        exec(compile("\n".join(lines), str(file), "exec"), names)
    return names


def test_a_new_effect_s_own_test_fails_for_a_wrong_sign_and_a_wrong_size(tmp_path: Path) -> None:
    plugin = write_package("effect", "fresh", tmp_path / "effect")[0]
    right = plugin.read_text()
    sign_and_size_of(tmp_path / "effect")["test_sign_and_size"]()
    for wrong in (right.replace("signals.v_ab - ", "signals.v_ab + "), right.replace("i_a**3", "2 * i_a**3")):
        plugin.write_text(wrong)
        assert wrong != right
        with pytest.raises(AssertionError, match="Not equal to tolerance"):
            sign_and_size_of(tmp_path / "effect")["test_sign_and_size"]()


@pytest.mark.slow
def test_a_new_effect_is_hidden_in_a_recording_and_named(tmp_path: Path) -> None:
    write_package("effect", "fresh", tmp_path / "effect")
    for installed in (False, True):
        if installed:
            installed_as(tmp_path / "effect")
        done = in_package(tmp_path / "effect", "hide.py")
        assert done.returncode == 0, done.stdout + done.stderr
        assert "likely cause: fresh (rise 0.0500" in done.stdout, done.stdout
        found = r"rise_ohm_per_a2: hidden 0.05, found 0.05\d* \(95 %: 0.04\d+ to 0.05\d*\) ohm/A\^2"
        assert re.search(found, done.stdout), done.stdout


@few("kinds", [("drive",), tuple(KINDS)], ids=["drive", "side by side"])
def test_a_new_package_passes_its_kit(kinds: tuple[str, ...], tmp_path: Path) -> None:
    for kind in kinds:
        write_package(kind, f"my_{kind}", tmp_path / kind)
        installed_as(tmp_path / kind)
    paths = os.pathsep.join(str(tmp_path / kind) for kind in kinds)
    words = ("-v", "--import-mode=importlib", "-p", "no:cacheprovider")
    done = in_package(tmp_path, "-m", "pytest", *words, *(f"{kind}/tests" for kind in kinds), paths=paths)
    assert done.returncode == 0, done.stdout + done.stderr
    for kind in kinds:
        assert len(re.findall(rf"test_my_{kind}\.py::.* PASSED", done.stdout)) >= 6, done.stdout


def test_a_new_package_has_test_settings_of_its_own_within_another_project(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text('[tool.pytest.ini_options]\naddopts = "--strict-config"\nnot_known = 1\n')
    write_package("effect", "inner", tmp_path / "inner")
    installed_as(tmp_path / "inner")
    done = in_package(tmp_path / "inner", "-m", "pytest", "tests", "--collect-only", "-q", "-p", "no:cacheprovider")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_a_new_drive_has_a_procedure_that_runs_and_learns_all_stages_that_it_cannot_do(tmp_path: Path) -> None:
    write_package("drive", "fresh", tmp_path / "drive")
    installed_as(tmp_path / "drive")
    done = in_package(tmp_path / "drive", "-m", "fluxbench", "run", "procedure.yaml", "--out", "run")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "every stage is done" in done.stdout
    done = in_package(tmp_path / "drive", "-m", "fluxbench", "check", "demo", "--drive", "fresh")
    unfit = "stages.0, stages.4, stages.7, stages.8: the drive 'fresh' has no gates_off, injection, trapezoid; it has"
    assert f"{unfit} hold" in done.stderr


@pytest.mark.parametrize("kind", KINDS)
def test_a_readme_speaks_of_names_that_there_are(kind: str, tmp_path: Path) -> None:
    code = [path.read_text() for path in write_package(kind, "fresh", tmp_path / kind) if path.suffix == ".py"]
    readme = (tmp_path / kind / "README.md").read_text()
    known = {*re.findall(r"\w+", "\n".join(code)), *dir(protocols), *get_args(ExcitationKind), *dir(Stage)}
    known |= {*Capabilities.model_fields, *Procedure.model_fields, "demo", "protocols"}
    assert [name for name in re.findall(r"`(\w+)`", readme) if name not in known] == []
    values = re.findall(r"`\w+ = ([^`]+)`", readme)
    assert [value for value in values if value not in known] == []


def test_a_new_package_is_tidy(tmp_path: Path) -> None:
    for kind in KINDS:
        write_package(kind, f"my_{kind}", tmp_path / kind)
    config = ["--config", str(ROOT / "pyproject.toml")]
    for tool in (["check", *config], ["format", "--check", *config]):
        done = in_package(tmp_path, "-m", "ruff", *tool, *(f"{kind}/fluxbench_my_{kind}" for kind in KINDS))
        assert done.returncode == 0, done.stdout + done.stderr


def test_a_new_drive_is_under_a_hundred_written_lines(tmp_path: Path) -> None:
    plugin = write_package("drive", "short", tmp_path / "new")[0]
    written = [line for line in plugin.read_text().splitlines() if line.strip()]
    assert len(written) < 100


@pytest.mark.parametrize("name", ["", "Upper", "1st", "with-dash", "class", "../up", "a b"])
def test_a_name_that_cannot_be_is_refused_and_nothing_written(tmp_path: Path, name: str) -> None:
    with pytest.raises(PluginError, match="a name has lower-case letters"):
        write_package("drive", name, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_the_name_of_an_installed_plugin_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="is installed already"):
        write_package("drive", "simulated", tmp_path / "new")


def test_a_kind_that_there_is_not_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="there are drive, stage, estimator, effect, stream"):
        write_package("motor", "mine", tmp_path / "new")
    with pytest.raises(PluginError, match="did you mean 'effect'"):
        write_package("efect", "mine", tmp_path / "new")


def test_a_folder_that_is_there_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "precious").write_text("x")
    with pytest.raises(InputError, match="exists already"):
        write_package("drive", "mine", tmp_path / "new")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["precious"]


@pytest.mark.parametrize("name", ["x" * 81, "x" * 400])
def test_a_name_too_long_for_a_file_is_refused_in_one_short_line(tmp_path: Path, name: str) -> None:
    with pytest.raises(PluginError, match="at most 80 letters") as caught:
        write_package("drive", name, tmp_path / "new")
    assert len(str(caught.value)) < 100
    assert not (tmp_path / "new").exists()


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment that has this one's packages, where plugins may be installed."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False, symlinks=True)
    packages = folder / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    (packages / "here.pth").write_text("\n".join([str(ROOT), sysconfig.get_path("purelib")]))
    return folder / "bin" / "python"


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_next_steps_run_as_they_are_printed(
    kind: str,
    environment: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "executable", str(environment))
    assert new(kind, f"next_{kind}", tmp_path / f"a new {kind}") == 0
    last = capsys.readouterr().out.splitlines()[-1].removeprefix("next: ")
    done = subprocess.run(
        ["bash", "-c", last],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    if NO_INDEX.search(done.stderr):
        pytest.skip("no package index within reach, which pip builds the package with")
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"\d+ passed", done.stdout), done.stdout
    found = subprocess.run(
        [str(environment), "-m", "fluxbench", "plugins"], capture_output=True, text=True, check=True, env={**os.environ}
    )
    assert f"next_{kind}" in found.stdout


def test_what_to_do_next_can_be_pasted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "my plugin's; folder"
    assert new("effect", "mine", folder) == 0
    last = capsys.readouterr().out.splitlines()[-1].removeprefix("next: ")
    assert shlex.split(last.partition(" && ")[0]) == ["cd", str(folder)]
