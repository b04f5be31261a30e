"""The wheel: whoever builds it of the same sources gets the same bytes, with all that the code reads beside it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = ("pyproject.toml", "README.md", "LICENSE", "protocols", "orchestrator", "plugins", "fluxbench")


def built(folder: Path, *, mode: int, mtime_s: float) -> Path:
    """The wheel of a checkout of which every file has this mode and age."""
    sources = folder / "sources"
    sources.mkdir(parents=True)
    for name in SOURCES:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, sources / name)
    for file in (f for f in sources.rglob("*") if f.is_file()):
        file.chmod(mode)
        os.utime(file, (mtime_s, mtime_s))
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=sources, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("one"), mode=0o644, mtime_s=1.5e9)


def test_two_checkouts_make_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    assert built(tmp_path, mode=0o664, mtime_s=1.7e9).read_bytes() == wheel.read_bytes()


def test_a_wheel_holds_every_file_of_its_packages_and_nothing_else(wheel: Path) -> None:
    tracked = subprocess.run(["git", "ls-files", *SOURCES[3:]], cwd=ROOT, check=True, capture_output=True, text=True)
    with zipfile.ZipFile(wheel) as content:
        packed = {name for name in content.namelist() if ".dist-info/" not in name}
    assert packed == set(tracked.stdout.split())


def test_a_wheel_carries_its_licence(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as content:
        (licence,) = [name for name in content.namelist() if name.endswith(".dist-info/licenses/LICENSE")]
        (metadata,) = [name for name in content.namelist() if name.endswith(".dist-info/METADATA")]
        assert content.read(licence) == (ROOT / "LICENSE").read_bytes()
        assert b"License-Expression: Apache-2.0" in content.read(metadata)
