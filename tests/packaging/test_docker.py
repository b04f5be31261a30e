"""The image is made of files that are there, installs pinned versions, and runs the demo as no root."""

from __future__ import annotations

import json
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
FILE = ROOT / "packaging" / "docker" / "Dockerfile"
KNOWN = {"ARG", "CMD", "COPY", "ENTRYPOINT", "ENV", "FROM", "RUN", "USER", "WORKDIR"}


def instructions() -> list[tuple[str, str]]:
    """Instruction and arguments of every line, continued lines joined."""
    lines = [line for line in FILE.read_text().splitlines() if not line.startswith("#")]
    joined = re.sub(r"\\\n\s*", "", "\n".join(lines))
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in joined.splitlines() if line)]


def arguments(name: str) -> list[str]:
    return [rest for word, rest in instructions() if word == name]


def test_its_instructions_are_docker_s() -> None:
    assert {word for word, _ in instructions()} <= KNOWN
    assert instructions()[0][0] == "FROM"
    assert all(rest for _, rest in instructions())


def test_its_bases_have_the_python_that_the_tests_run_with() -> None:
    assert {base.partition(" ")[0] for base in arguments("FROM")} == {"python:3.11-slim"}


def test_what_it_copies_is_there_and_not_ignored() -> None:
    ignored = FILE.with_name("Dockerfile.dockerignore").read_text().splitlines()
    for words in (rest.split() for rest in arguments("COPY") if not rest.startswith("--from")):
        for source in words[:-1]:
            assert (ROOT / source).exists()
            assert f"!{source}" in ignored


def test_versions_are_the_pinned_ones() -> None:
    (install,) = [run for run in arguments("RUN") if run.startswith("pip install")]
    assert "--constraint /tmp/constraints.txt" in install


def test_it_runs_the_demo_as_a_user_that_it_made() -> None:
    names = [word for word, _ in instructions()]
    (user,) = arguments("USER")
    assert f"useradd --create-home --uid 1000 {user}" in " ".join(arguments("RUN"))
    assert names.index("USER") > max(at for at, name in enumerate(names) if name in ("COPY", "RUN"))
    assert json.loads(arguments("ENTRYPOINT")[0]) + json.loads(arguments("CMD")[0]) == ["fluxbench", "run", "demo"]
