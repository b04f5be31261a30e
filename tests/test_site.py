"""The documentation as a site: every page is in its navigation, and nothing in it comes from elsewhere."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
SITE: dict[str, Any] = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
GENERATED = ("index.md", "contributing.md")
"""From the README and CONTRIBUTING, by docs/front_page.py."""


def pages_of(entries: Any) -> Iterator[str]:
    """The pages of a part of the navigation."""
    if isinstance(entries, str):
        yield entries
        return
    for entry in entries.values() if isinstance(entries, dict) else entries:
        yield from pages_of(entry)


def test_the_navigation_names_every_page_once() -> None:
    named = sorted(pages_of(SITE["nav"]))
    pages = [str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")]
    assert named == sorted([*pages, *GENERATED])


def test_the_site_is_built_strictly_and_asks_no_other_machine_for_anything() -> None:
    assert SITE["strict"] is True
    assert SITE["theme"]["font"] is False
    assert not {"extra_javascript", "extra_css"} & SITE.keys()


def test_the_reference_is_of_what_there_is() -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in (DOCS / "reference").glob("*.md"))
    named = re.findall(r"^::: (\S+)", text, re.M)
    assert len(named) >= 5
    for name in named:
        module, _, attribute = name.rpartition(".")
        assert find_spec(name) or hasattr(import_module(module), attribute)


@pytest.mark.slow
@pytest.mark.skipif(find_spec("mkdocs") is None, reason="`make docs` installs what builds it")
def test_it_builds_without_a_network_and_shows_docstrings(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    alone = ["unshare", "--net", "--map-root-user"] if shutil.which("unshare") else []
    done = subprocess.run([*alone, *command], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    built = list((tmp_path / "site").rglob("*.html"))
    assert len(built) > len(list(pages_of(SITE["nav"]))) - 1
    loaded = re.compile(r'<(?:script|img|link|iframe)\b[^>]*\b(?:src|href)="(?:https?:)?//')
    assert not [page.name for page in built if loaded.search(page.read_text(encoding="utf-8"))]
    contracts = (tmp_path / "site" / "reference" / "contracts.html").read_text(encoding="utf-8")
    assert "One segment as an effect sees it" in contracts
