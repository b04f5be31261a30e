"""The report's section on the drive: what `fluxbench tune` made of the map."""

from __future__ import annotations

import base64
from typing import Any

from plugins.streams.report._collect import Material
from plugins.streams.report._content import Picture

HEAD = ("figure", "value")


def drive_section(material: Material, *, draws: bool) -> dict[str, Any] | None:
    """Figures, notes, picture and files of the tuning; None where there is none."""
    from orchestrator.tuning.words import figure_rows, headline, notes

    tuning = material.tuning
    if tuning is None:
        return None
    folder = material.directory / "tuning"
    image = folder / "tuning.svg"
    pictures = []
    if draws and image.is_file():
        encoded = base64.b64encode(image.read_bytes()).decode("ascii")
        caption = (
            "Torque over speed; references; voltage to add to a leg; what injection is off; what the tuning changes."
        )
        pictures.append(Picture("The drive in pictures", caption, f"data:image/svg+xml;base64,{encoded}"))
    files = [f"tuning/{name}" for name in tuning.files]
    return {
        "line": headline(tuning),
        "head": HEAD,
        "rows": figure_rows(tuning),
        "notes": notes(tuning),
        "pictures": pictures,
        "files": files,
    }
