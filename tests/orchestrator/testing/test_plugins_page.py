"""What docs/plugins.md shows is complete, and passes the kits that it praises."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "plugins.md"
RECORDING = ROOT / "tests" / "data" / "pm400-reduced"


def snippets() -> dict[str, str]:
    """The page's files by name: each code block opens with a comment that holds it."""
    blocks = re.findall(r"^```(?:python|toml)\n# (\S+)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    return dict(blocks)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's files, laid out as it says, with the metadata that an installation would leave."""
    folder = tmp_path_factory.mktemp("bench")
    for name, text in snippets().items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    project = tomllib.loads(snippets()["pyproject.toml"])["project"]
    installed = folder / "bench_plugins-0.1.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: bench-plugins\nVersion: 0.1\n", encoding="utf-8")
    points = configparser.ConfigParser()
    points.read_dict(project["entry-points"])
    with (installed / "entry_points.txt").open("w", encoding="utf-8") as file:
        points.write(file)
    shutil.copytree(RECORDING, folder / "tests" / "recording")
    return folder


def in_package(package: Path, *command: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(package), str(ROOT)))}
    return subprocess.run(
        [sys.executable, *command], cwd=package, env=environment, capture_output=True, text=True, timeout=120
    )


def test_page_shows_a_plugin_of_each_kind_and_the_kits() -> None:
    assert set(snippets()) == {
        "pyproject.toml",
        "bench_plugins/supply.py",
        "bench_plugins/thermal_soak.py",
        "bench_plugins/ohmmeter.py",
        "bench_plugins/voltage_offset.py",
        "bench_plugins/points_file.py",
        "tests/test_conformance.py",
    }


def test_page_s_plugins_pass_the_kits(package: Path) -> None:
    done = in_package(package, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests")
    assert done.returncode == 0, done.stdout + done.stderr
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None
    assert int(passed[1]) >= 40, done.stdout


def test_page_s_plugins_are_loaded_by_their_names(package: Path) -> None:
    code = (
        "from orchestrator.registry import PluginKind, load_plugin\n"
        "for kind, name in zip(PluginKind, ('supply', 'thermal_soak', 'ohmmeter', 'voltage_offset', 'points_file')):\n"
        "    assert load_plugin(kind, name).name == name\n"
    )
    done = in_package(package, "-c", code)
    assert done.returncode == 0, done.stderr


def test_a_plugin_that_breaks_its_contract_fails_there_too(package: Path, tmp_path: Path) -> None:
    broken = tmp_path / "bench"
    shutil.copytree(package, broken)
    file = broken / "bench_plugins" / "supply.py"
    file.write_text(file.read_text().replace("LOAD_OHM = 4.0", "LOAD_OHM = -4.0"), encoding="utf-8")
    done = in_package(broken, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests", "-k", "TestSupply")
    assert done.returncode == 1
    assert "polarity is wrong" in done.stdout
