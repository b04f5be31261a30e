"""The list of changes is in Keep a Changelog's form (https://keepachangelog.com)."""

from __future__ import annotations

import re
import runpy
from datetime import date
from pathlib import Path

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
KINDS = ["Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"]
MAX_ENTRY_CHARACTERS = 160
HEADINGS = re.findall(r"^## (.+)$", TEXT, flags=re.MULTILINE)


def test_unreleased_stands_above_dated_versions_and_the_newest_is_the_package_s() -> None:
    assert HEADINGS[0] == "[Unreleased]"
    found = [re.fullmatch(r"\[(\d+)\.(\d+)\.(\d+)\] - (\d{4}-\d\d-\d\d)", heading) for heading in HEADINGS[1:]]
    versions = [tuple(int(part) for part in one.groups()[:3]) for one in found if one]
    dates = [date.fromisoformat(one.group(4)) for one in found if one]
    assert len(versions) == len(HEADINGS) - 1
    assert versions == sorted(set(versions), reverse=True)
    assert dates == sorted(dates, reverse=True)
    newest = runpy.run_path(str(ROOT / "packaging" / "version.py"))["newest"]
    assert ".".join(str(part) for part in versions[0]) == newest(ROOT)


def test_each_version_has_known_kinds_of_changes_once_and_in_order() -> None:
    for part in re.split(r"^## .+$", TEXT, flags=re.MULTILINE)[1:]:
        kinds = re.findall(r"^### (.+)$", part, flags=re.MULTILINE)
        assert kinds
        assert kinds == [kind for kind in KINDS if kind in kinds]


def test_each_entry_is_one_line_and_stands_once() -> None:
    _, _, changes = TEXT.partition("## ")
    lines = [line for line in changes.splitlines()[1:] if line]
    entries = [line for line in lines if line.startswith("- ")]
    assert all(line.startswith(("- ", "## ", "### ")) for line in lines)
    assert len(entries) == len(set(entries))
    assert [entry for entry in entries if len(entry) > MAX_ENTRY_CHARACTERS] == []
    assert [entry for entry in entries if not entry.endswith(".")] == []


def test_a_fixed_entry_names_the_symptom_and_then_what_happens_now() -> None:
    for part in re.findall(r"^### Fixed\n\n((?:- .*\n)+)", TEXT, flags=re.MULTILINE):
        assert [entry for entry in part.splitlines() if ";" not in entry and ". " not in entry] == []


def test_the_links_resolve() -> None:
    links = re.findall(r"\]\(([^)]+)\)", TEXT)
    assert [link for link in links if "://" not in link and not (ROOT / link).is_file()] == []
