"""A build has the version of its tag, else the newest of the list of changes; a clone without tags builds."""

from __future__ import annotations

import runpy
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
version: Callable[[Path], str] = runpy.run_path(str(ROOT / "packaging" / "version.py"))["version"]


def git(folder: Path, *words: str) -> None:
    owner = ["-c", "user.name=a", "-c", "user.email=a@b"]
    subprocess.run(["git", *owner, *words], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A repository with one commit."""
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## [Unreleased]\n\n## [0.3.0] - 2026-02-01\n")
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "--quiet", "--message", "First")
    return tmp_path


def test_a_tag_at_the_commit_is_the_version(sources: Path) -> None:
    git(sources, "tag", "v1.2.3")
    assert version(sources) == "1.2.3"


def test_tags_of_other_names_and_commits_are_none(sources: Path) -> None:
    git(sources, "tag", "very-old")
    git(sources, "tag", "v1.2.3")
    git(sources, "commit", "--quiet", "--allow-empty", "--message", "Second")
    assert version(sources) == "0.3.0"


def test_an_archive_in_another_repository_has_its_own_version(sources: Path) -> None:
    git(sources, "tag", "v1.2.3")
    inner = sources / "unpacked"
    inner.mkdir()
    (inner / "CHANGELOG.md").write_text("## [0.2.0] - 2026-01-01\n")
    assert version(inner) == "0.2.0"


def test_a_list_of_changes_without_a_version_is_refused(tmp_path: Path) -> None:
    (tmp_path / "CHANGELOG.md").write_text("## [Unreleased]\n")
    with pytest.raises(ValueError, match=r"expected a heading"):
        version(tmp_path)


def test_this_checkout_has_the_newest_version_or_that_of_its_tag() -> None:
    names = runpy.run_path(str(ROOT / "packaging" / "version.py"))
    assert version(ROOT) == names["newest"](ROOT), "a tag at this commit has another version than the list of changes"
