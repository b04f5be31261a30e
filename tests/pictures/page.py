"""The operator's page while a run goes on, on a desk and on a phone: pictures for the documentation."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

from PIL import Image

from tests.plugins.commands.serve.served import serving
from tests.support.chromium import Tab, with_chromium

NAMES = ("serve", "serve-phone")
DESK, PHONE = (1100, 760), (390, 780)
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
        return _shot(desk, folder / "serve.png"), _shot(phone, folder / "serve-phone.png")


def _shot(tab: Tab, to: Path) -> Path:
    raw = tab.shot(to)
    picture = Image.open(io.BytesIO(raw.read_bytes())).convert("RGB")
    picture.quantize(128, dither=Image.Dither.NONE).save(to, "PNG", optimize=True)
    return to
