"""The operator's page while a run goes on, on a desk and on a phone: pictures for the documentation."""

from __future__ import annotations

import io
import json
import tempfile
from pathlib import Path

from PIL import Image

from tests.orchestrator.shelf.example_runs import a_run
from tests.plugins.commands.serve.served import serving
from tests.support.chromium import Tab, with_chromium

NAMES = ("serve", "serve-phone", "serve-runs")
DESK, PHONE = (1100, 760), (390, 780)
RUNS = (("PM-0042", 4.25), ("PM-0043", 4.38), ("PM-0042", 4.27), ("PM-0042", 4.28), ("PM-0042", 4.31))
"""Serial number and R_s [ohm] of each run."""
SETTINGS = "drive.realtime_factor=8\nstages.7.held_a=[0]"


def page_pictures(folder: Path) -> tuple[Path, ...]:
    """Shoot `serve.png` while the demo sweeps, and `serve-phone.png` beside it.

    Raises
    ------
    FileNotFoundError
        Where there is no browser.
    """
    with tempfile.TemporaryDirectory() as bench, serving(Path(bench)) as served, with_chromium() as chromium:
        desk, phone = chromium.open(served.address), chromium.open(served.address)
        desk.resize(*DESK)
        phone.resize(*PHONE, phone=True)
        desk.until("document.querySelectorAll('[name=procedure] option').length > 1")
        desk.value(f"document.querySelector('[name=settings]').value = {SETTINGS!r}")
        desk.value("document.querySelector('[name=serial]').value = 'PM400-017'")
        desk.value("document.getElementById('folder').style.visibility = 'hidden'")
        desk.value("document.getElementById('start').click()")
        desk.until("/injection.*point (1[0-9]|2[0-9])/.test(document.getElementById('progress').textContent)", 300.0)
        shots = _shot(desk, folder / "serve.png"), _shot(phone, folder / "serve-phone.png")
    return *shots, shelf_picture(folder)


def shelf_picture(folder: Path) -> Path:
    """Shoot `serve-runs.png`: the table with runs of made-up numbers, and the trend of one motor."""
    with tempfile.TemporaryDirectory() as bench:
        for k, (serial, r_s) in enumerate(RUNS):
            run = a_run(
                Path(bench) / "runs" / f"line-{serial}-{k + 1}",
                r_s=r_s,
                accept={"max_resistance_ohm": 4.35, "verdicts": ["clean", "explained"]},
                about={"serial": serial, "tags": ["line 2"]},
            )
            _date(run, f"2026-11-{10 + 3 * k}T08:{10 + 7 * k}:00Z")
        with serving(Path(bench)) as served, with_chromium() as chromium:
            desk = chromium.open(served.address)
            desk.resize(1300, 900)
            desk.until("document.querySelectorAll('#rows tr').length > 3")
            desk.call("Page.navigate", url=f"{served.origin}/shelf")
            desk.until("document.getElementById('count') && document.querySelectorAll('#rows tr').length > 3")
            trend = "[...document.querySelectorAll('#rows tr')[0].querySelectorAll('button')][1]"
            desk.value(f"{trend}.click()")
            desk.until("!document.getElementById('trend').hidden")
            desk.value("scrollTo(0, 0)")
            return _shot(desk, folder / "serve-runs.png")


def _date(run: Path, created: str) -> None:
    file = run / "run.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"created": created}))


def _shot(tab: Tab, to: Path) -> Path:
    raw = tab.shot(to)
    picture = Image.open(io.BytesIO(raw.read_bytes())).convert("RGB")
    picture.quantize(128, dither=Image.Dither.NONE).save(to, "PNG", optimize=True)
    return to
