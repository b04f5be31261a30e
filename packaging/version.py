"""The version of a build: that of the tag at its commit, else the newest in CHANGELOG.md.

hatchling runs this file (pyproject.toml); nothing else does. A clone without tags and an unpacked archive build too.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def version(root: Path = ROOT) -> str:
    """The version of these sources."""
    return tagged(root) or newest(root)


def tagged(root: Path) -> str | None:
    """The version of the tag ``v1.2.3`` at the commit that is checked out; None without one."""
    if not (root / ".git").exists():  # an archive that was unpacked somewhere in another repository
        return None
    command = ["git", "describe", "--tags", "--exact-match", "--match", "v[0-9]*"]
    try:
        tag = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return None
    return tag.strip().removeprefix("v")


def newest(root: Path) -> str:
    """The newest version in the list of changes; raises `ValueError` where it has none."""
    found = re.search(r"^## \[(\d[^\]]*)\]", (root / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    if found is None:
        raise ValueError("CHANGELOG.md: expected a heading such as ## [1.2.3] - 2026-01-31")
    return found[1]
