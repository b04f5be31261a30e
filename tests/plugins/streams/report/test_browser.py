"""The page in a real browser: no complaint, no network, nothing wider than a phone."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from orchestrator.diagnosis import save_diagnosis
from plugins.streams.report import write_report
from tests.pictures.report import browse, browser, report_pictures
from tests.plugins.streams.example_run import a_run_directory
from tests.plugins.streams.report.example_diagnosis import WORDS, a_diagnosis, some_steps

pytestmark = [pytest.mark.slow, pytest.mark.skipif(browser() is None, reason="no Chromium or Chrome on the path")]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = a_run_directory(tmp_path_factory.mktemp("browsed") / "run")
    save_diagnosis(made, a_diagnosis(), WORDS, some_steps())
    write_report(made)
    return made


def test_the_browser_has_nothing_to_complain_about(run: Path) -> None:
    # Whatever the page would fetch, its own policy refuses, and the console says so.
    assert browse(run / "report.html", (1200, 800), "--dump-dom")[1] == []


def test_a_page_that_fetches_something_would_be_noticed(run: Path, tmp_path: Path) -> None:
    page = (run / "report.html").read_text(encoding="utf-8")
    spoilt = tmp_path / "spoilt.html"
    spoilt.write_text(page.replace("</main>", '<img src="https://example.invalid/x.png"></main>'), encoding="utf-8")
    assert browse(spoilt, (1200, 800), "--dump-dom")[1]


@pytest.mark.parametrize("width", [320, 360, 414, 768])
def test_nothing_is_wider_than_the_screen(run: Path, tmp_path: Path, width: int) -> None:
    page = (run / "report.html").read_text(encoding="utf-8")
    measured = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page)
    # A frame of the screen's width, for a browser without a screen has a least width of its own.
    (tmp_path / "inner.html").write_text(measured, encoding="utf-8")
    script = "document.title = document.querySelector('iframe').contentDocument.documentElement.scrollWidth"
    outer = tmp_path / "outer.html"
    outer.write_text(
        f'<iframe src="inner.html" style="width:{width}px;height:800px;border:0" onload="{script}"></iframe>',
        encoding="utf-8",
    )
    dom, _ = browse(outer, (1200, 900), "--dump-dom", "--allow-file-access-from-files")
    found = re.search(r"<title>(\d+)</title>", dom)
    assert found is not None
    assert int(found[1]) <= width


def test_pictures_for_the_documentation_are_made(run: Path, tmp_path: Path) -> None:
    before = sorted(p.name for p in run.rglob("*"))
    names = [picture.name for picture in report_pictures(run, tmp_path)]
    assert names == ["report.png", "report-diagnosis.png", "report-motor.png", "demo.png", "report-phone.png"]
    assert all((tmp_path / name).stat().st_size > 20_000 for name in names)
    assert sorted(p.name for p in run.rglob("*")) == before
