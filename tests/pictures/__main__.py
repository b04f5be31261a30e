"""`python -m tests.pictures RUN [FOLDER]`: every picture of the documentation, from one run that was diagnosed."""

from __future__ import annotations

import sys
from pathlib import Path

from protocols import FluxbenchError
from tests.pictures.discover import discover_pictures
from tests.pictures.page import page_pictures
from tests.pictures.report import PICTURES, report_pictures
from tests.pictures.viewer import viewer_pictures


def main(words: list[str]) -> int:
    """Shoot the report and the viewer; one line a picture."""
    if not 1 <= len(words) <= 2:
        print("usage: python -m tests.pictures RUN [FOLDER]", file=sys.stderr)
        return 2
    run, folder = Path(words[0]), Path(words[1]) if len(words) == 2 else PICTURES
    try:
        for shoot in (report_pictures, viewer_pictures):
            for picture in shoot(run, folder):
                print(picture)
        for picture in (*page_pictures(folder), *discover_pictures(folder)):
            print(picture)
    except (FluxbenchError, FileNotFoundError, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
