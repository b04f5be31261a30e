"""Figures that are made but not drawn: matplotlib takes a tenth of a second of each, a page has two dozen.

For tests of what stands around the pictures. What is drawn is tested in tests/plugins/streams/report.
"""

from __future__ import annotations

from pathlib import Path
from typing import IO

import pytest

NOTHING = b'<?xml version="1.0" encoding="utf-8"?>\n<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>\n'


def draw_nothing(patch: pytest.MonkeyPatch) -> None:
    """From here on a figure is laid out by nobody, and its file is an empty drawing."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    patch.setattr(ConstrainedLayoutEngine, "execute", lambda engine, figure: None)
    patch.setattr(Figure, "savefig", _save_nothing)


def _save_nothing(figure: object, target: Path | IO[bytes], **options: object) -> None:
    if isinstance(target, Path):
        target.write_bytes(NOTHING)
    else:
        target.write(NOTHING)
