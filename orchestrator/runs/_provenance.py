"""The provenance of a run: versions, interpreter, and the state of the source."""

from __future__ import annotations

import platform
import re
import subprocess
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from orchestrator.registry.plugins import DISTRIBUTION, PluginInfo
from protocols import Strict


class GitState(Strict):
    """The checkout of the running code."""

    sha: str
    dirty: bool
    """Whether tracked files differ from that commit."""


class Provenance(Strict):
    """The versions that identify the code of a run."""

    fluxbench: str
    python: str
    platform: str
    host: str | None = None
    """Present in older runs only."""
    packages: dict[str, str]
    """Versions of fluxbench's dependencies."""
    plugins: tuple[PluginInfo, ...] = ()
    """Plugins of the run."""
    git: GitState | None = None
    """None: installed from a wheel, or git is not installed."""


def provenance(plugins: Iterable[PluginInfo] = ()) -> Provenance:
    """The provenance of a run by this process with these plugins."""
    return Provenance(
        fluxbench=_version(DISTRIBUTION) or "?",
        python=platform.python_version(),
        platform=platform.platform(),
        packages=dict(_packages()),
        plugins=tuple(plugins),
        git=_own_git_state(),
    )


@cache  # parses the metadata of each package, and what is imported stays as it is
def _packages() -> Mapping[str, str]:
    try:
        needed = requires(DISTRIBUTION) or []
    except PackageNotFoundError:
        return {}
    names = (re.split(r"[^A-Za-z0-9_.-]", line, maxsplit=1)[0] for line in needed if "extra ==" not in line)
    return {name: installed for name in names if (installed := _version(name)) is not None}


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


@cache  # the code that runs is the code that was imported, whatever becomes of the files
def _own_git_state() -> GitState | None:
    return _git_state(Path(__file__).resolve().parents[2])


def _git_state(source: Path) -> GitState | None:
    # An installed wheel may lie inside somebody else's checkout; only the checkout's own top counts.
    if not (source / ".git").exists():
        return None
    sha = _git(source, "rev-parse", "HEAD")
    changes = _git(source, "status", "--porcelain", "--untracked-files=no")
    return None if sha is None or changes is None else GitState(sha=sha, dirty=bool(changes))


def _git(source: Path, *arguments: str) -> str | None:
    command = ["git", "-C", str(source), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
