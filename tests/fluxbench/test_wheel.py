"""Wheel and sdist: the same sources give the same bytes, with all that the code reads beside it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("protocols", "orchestrator", "plugins", "fluxbench")
SOURCES = ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "packaging", *PACKAGES)

PLACE = "import sysconfig; print(sysconfig.get_path('purelib'))"


def built(folder: Path, *, mode: int, mtime_s: float, target: str = "wheel") -> Path:
    """The wheel (or sdist) of a checkout of which every file has this mode and age."""
    sources = folder / "sources"
    sources.mkdir(parents=True)
    for name in SOURCES:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, sources / name)
    for file in (f for f in sources.rglob("*") if f.is_file()):
        file.chmod(mode)
        os.utime(file, (mtime_s, mtime_s))
    return build(sources, target, folder)


def build(sources: Path, target: str, folder: Path) -> Path:
    """What hatchling makes of the sources."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", target, "-d", str(folder)]
    subprocess.run(command, cwd=sources, check=True, capture_output=True)
    (made,) = (file for file in folder.iterdir() if file.name.endswith((".whl", ".tar.gz")))
    return made


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("one"), mode=0o644, mtime_s=1.5e9)


def test_two_checkouts_make_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    assert built(tmp_path, mode=0o664, mtime_s=1.7e9).read_bytes() == wheel.read_bytes()


def test_a_wheel_holds_every_file_of_its_packages_and_nothing_else(wheel: Path) -> None:
    tracked = subprocess.run(["git", "ls-files", *PACKAGES], cwd=ROOT, check=True, capture_output=True, text=True)
    with zipfile.ZipFile(wheel) as content:
        packed = {name for name in content.namelist() if ".dist-info/" not in name}
    assert packed == set(tracked.stdout.split())


def test_a_wheel_carries_its_licence(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as content:
        (licence,) = [name for name in content.namelist() if name.endswith(".dist-info/licenses/LICENSE")]
        (metadata,) = [name for name in content.namelist() if name.endswith(".dist-info/METADATA")]
        assert content.read(licence) == (ROOT / "LICENSE").read_bytes()
        assert b"License-Expression: Apache-2.0" in content.read(metadata)


@pytest.mark.slow
def test_two_checkouts_make_the_same_sdist_and_it_makes_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    first = built(tmp_path / "first", mode=0o644, mtime_s=1.5e9, target="sdist")
    second = built(tmp_path / "second", mode=0o664, mtime_s=1.7e9, target="sdist")
    assert first.read_bytes() == second.read_bytes()
    with tarfile.open(first) as content:
        content.extractall(tmp_path, filter="data")
    (tmp_path / "made").mkdir()
    unpacked = tmp_path / first.name.removesuffix(".tar.gz")
    assert build(unpacked, "wheel", tmp_path / "made").read_bytes() == wheel.read_bytes()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_wheel_measures_a_motor_without_the_sources_beside_it(wheel: Path, tmp_path: Path) -> None:
    python = tmp_path / "environment" / "bin" / "python"
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "environment")], check=True)
    subprocess.run([python, "-m", "pip", "install", "--quiet", "--no-deps", str(wheel)], check=True)
    ours = subprocess.run([python, "-c", PLACE], check=True, capture_output=True, text=True).stdout.strip()
    # The packages that it asks for are those of the tests' own environment.
    Path(ours, "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [str(python.with_name("fluxbench")), "run", "demo", "--out", "run"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert str(ROOT) not in json.dumps(record)
    assert (tmp_path / "run" / "results" / "flux_map.nc").is_file()
