"""The licences: of the project, and of every package that it asks for."""

from __future__ import annotations

import re
import runpy
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PAGE = ROOT / "docs" / "installing.md"
OF_METADATA = {
    "Python Software Foundation License": "PSF-2.0",
    "Apache Software License": "Apache-2.0",
    "MIT License": "MIT",
    "BSD License": "BSD",
    "GNU Lesser General Public License v3 or later (LGPLv3+)": "LGPL-3.0-or-later",
}
"""What a package's classifier calls a licence, and how the page does."""


def listed() -> dict[str, str]:
    """Package and licence, as the page has them."""
    section = PAGE.read_text(encoding="utf-8").partition("## Licences")[2].partition("\n## ")[0]
    return dict(re.findall(r"^\| ([\w.-]+) \| ([^|]+?) \|", section, re.M))


def direct() -> Iterator[str]:
    """The packages that an installation asks for, by its extras too; those of development alone left out."""
    extras = PROJECT["optional-dependencies"]
    for line in [*PROJECT["dependencies"], *(line for name in extras if name != "dev" for line in extras[name])]:
        yield re.split(r"[\[<>=]", line)[0]


def stated(package: str) -> str | None:
    """The licence by the package's own metadata; None where it is not installed."""
    try:
        content = metadata(package)
    except PackageNotFoundError:
        return None
    if "License-Expression" in content:
        return content["License-Expression"]
    classifiers = [c.rpartition(" :: ")[2] for c in content.get_all("Classifier") or [] if c.startswith("License ::")]
    return OF_METADATA[classifiers[0]]


def test_the_page_lists_every_direct_dependency_and_no_other() -> None:
    assert sorted(set(listed()) - {"package", "---"}) == sorted(set(direct()))


@pytest.mark.parametrize("package", sorted(set(direct())))
def test_a_listed_licence_is_the_one_of_the_package_s_metadata(package: str) -> None:
    licence = stated(package)
    if licence is None:
        pytest.skip(f"{package} is not installed here")
    assert listed()[package].startswith(licence)


def test_the_project_s_licence_is_the_same_everywhere() -> None:
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert "Apache License\n" in text
    assert "Version 2.0, January 2004" in text
    assert PROJECT["license"] == "Apache-2.0"
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    newest = runpy.run_path(str(ROOT / "packaging" / "version.py"))["newest"]
    assert (citation["license"], citation["version"]) == (PROJECT["license"], newest(ROOT))
