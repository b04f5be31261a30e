"""The notes of a release: a version's part of CHANGELOG.md, by default the newest version's.

``python packaging/release_notes.py [VERSION]``; "Unreleased" is a version too.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

CHANGES = Path(__file__).resolve().parents[1] / "CHANGELOG.md"


def notes(text: str, version: str | None = None) -> str:
    """The part of one version, without its heading; raises `ValueError` where there is none."""
    parts = re.split(r"^## \[([^\]]+)\].*$", text, flags=re.MULTILINE)
    by_version = dict(zip(parts[1::2], parts[2::2], strict=True))
    wanted = version or next((name for name in by_version if name[0].isdigit()), "")
    if wanted not in by_version:
        raise ValueError(f"CHANGELOG.md has no version {wanted}: there are {', '.join(by_version)}")
    return by_version[wanted].strip() + "\n"


if __name__ == "__main__":
    try:
        sys.stdout.write(notes(CHANGES.read_text(encoding="utf-8"), *sys.argv[1:2]))
    except ValueError as error:
        sys.exit(str(error))
