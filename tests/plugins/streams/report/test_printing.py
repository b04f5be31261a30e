"""The page as PDF, by whatever browser is there."""

from __future__ import annotations

from pathlib import Path

import pytest

from plugins.streams.report._printing import print_page
from protocols import InputError, StorageError
from tests.pictures.report import browser


@pytest.fixture
def page(tmp_path: Path) -> Path:
    page = tmp_path / "report.html"
    page.write_text("<!DOCTYPE html><title>t</title><p>R_s</p>")
    return page


@pytest.mark.skipif(browser() is None, reason="no Chromium or Chrome on the path")
def test_a_page_becomes_a_pdf_beside_it(page: Path, tmp_path: Path) -> None:
    assert print_page(page, tmp_path / "report.pdf").read_bytes().startswith(b"%PDF-")


def test_without_a_browser_it_is_stated_what_to_install(page: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no browser to print with; install one of nobodys-browser"):
        print_page(page, tmp_path / "report.pdf", ("nobodys-browser",))


def test_a_browser_that_makes_nothing_is_reported_in_one_line(page: Path, tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="the browser made no file"):
        print_page(page, tmp_path / "report.pdf", ("true",))
