"""The report as a browser shows it: pictures for the documentation, and what the browser had to complain about.

Needs Chromium or Chrome on the path; nothing is fetched from a network.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from plugins.streams.report import write_report

PICTURES = Path(__file__).parents[2] / "docs" / "pictures"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--enable-logging=stderr",
    "--v=0",
)
DESKTOP, PHONE = (1200, 5000), (360, 9000)
TIMEOUT_S = 120.0
WANTED = {
    "report": ("summary", "checks"),
    "report-diagnosis": ("diagnosis",),
    "report-motor": ("motor",),
}
"""The page's sections of each picture on a desk."""
MAP = "demo"
NOT_OF_THE_MAP = "main > :not(section), h2, figure:not(:nth-of-type(n+3):nth-of-type(-n+8))"
"""What the picture of the map leaves out of the motor's section: all but fluxes and inductances."""
LONGEST = 2600
"""Rows of a picture that a page of documentation bears."""


def report_pictures(run: Path, folder: Path = PICTURES) -> tuple[Path, ...]:
    """Shoot the report of a run or recording: its summary, its diagnosis where there is one, and a phone's view.

    The run is read only; the page is made elsewhere.

    Raises
    ------
    FileNotFoundError
        Where there is no browser.
    RuntimeError
        Where the browser complains about the page.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shots = []
    with tempfile.TemporaryDirectory() as scratch:
        page = write_report(run, Path(scratch) / "report.html")
        sections = re.findall(r'<section id="(\w+)"', page.read_text(encoding="utf-8"))
        for name, ids in WANTED.items():
            if set(ids) <= set(sections):
                shots.append(_shot(only(page, ids), folder / f"{name}.png", DESKTOP))
        if "motor" in sections:
            shots.append(_shot(only(page, ("motor",), NOT_OF_THE_MAP), folder / f"{MAP}.png", DESKTOP))
        shots.append(_shot(only(page, ("summary", "diagnosis")), folder / "report-phone.png", PHONE))
    return tuple(shots)


def browser() -> str | None:
    """The browser's path; None where there is none."""
    return next((found for name in BROWSERS if (found := shutil.which(name))), None)


def only(page: Path, sections: tuple[str, ...], hidden: str = "") -> Path:
    """A copy of a page that shows these sections alone, less what a selector names, beside it."""
    shown = ", ".join(f"section#{name}" for name in sections)
    also = f", {hidden}" if hidden else ""
    style = f"<style>section:not({shown}){also} {{ display: none; }}</style></head>"
    copy = page.with_name("-".join(sections) + ".html")
    copy.write_text(page.read_text(encoding="utf-8").replace("</head>", style, 1), encoding="utf-8")
    return copy


def browse(page: Path, size: tuple[int, int], *words: str) -> tuple[str, list[str]]:
    """Open a page; what the browser printed, and its console's lines."""
    program = browser()
    if program is None:
        raise FileNotFoundError(f"no browser: one of {', '.join(BROWSERS)} is needed")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [program, *_FLAGS, f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}", *words]
        done = subprocess.run(
            [*command, page.resolve().as_uri()], capture_output=True, text=True, timeout=TIMEOUT_S, check=True
        )
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def _shot(page: Path, target: Path, size: tuple[int, int]) -> Path:
    with tempfile.TemporaryDirectory() as scratch:
        raw = Path(scratch) / "shot.png"
        _, complaints = browse(page, size, f"--screenshot={raw}")
        if complaints:
            raise RuntimeError(f"{page.name}: {complaints[0]}")
        with Image.open(raw) as image:
            picture = image.convert("RGB")
    rows = np.flatnonzero((np.asarray(picture) < 250).any(axis=(1, 2)))
    height = min(int(rows[-1]) + 24 if len(rows) else size[1], LONGEST, picture.height)
    picture.crop((0, 0, picture.width, height)).save(target, optimize=True)
    return target
