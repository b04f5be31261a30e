"""A view for a page: with the token for whoever asks, without it for nobody."""

from __future__ import annotations

import http.client
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from plugins.streams.rerun._handing import handed_out

ORIGIN = "http://127.0.0.1:9090"


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    file = tmp_path / "view.rrd"
    file.write_bytes(b"RRF2 and so on")
    with handed_out(file, ORIGIN) as address:
        yield address


def fetch(address: str, path: str | None = None, host: str | None = None) -> tuple[int, bytes, str | None]:
    """Status, content, and who is let read it."""
    place = urlsplit(address)
    with closing(http.client.HTTPConnection("127.0.0.1", place.port or 0, timeout=10)) as line:
        line.request("GET", path or place.path, headers={"Host": host} if host else {})
        answer = line.getresponse()
        return answer.status, answer.read(), answer.getheader("access-control-allow-origin")


def test_with_its_token_the_page_gets_the_file_and_is_let_read_it(address: str) -> None:
    assert fetch(address) == (200, b"RRF2 and so on", ORIGIN)
    assert urlsplit(address).path.endswith("/view.rrd")


@pytest.mark.parametrize("path", ["/view.rrd", "/wrong/view.rrd", "//view.rrd", "/", "/wrong/../view.rrd"])
def test_without_it_nobody_gets_anything(path: str, address: str) -> None:
    status, content, reader = fetch(address, path)
    assert status in (403, 404)
    assert b"RRF2" not in content
    assert reader is None


def test_under_a_foreign_name_nobody_gets_anything(address: str) -> None:
    assert fetch(address, host="bench.example.org")[0] == 403


def test_each_time_there_is_another_token(address: str, tmp_path: Path) -> None:
    with handed_out(tmp_path / "view.rrd", ORIGIN) as other:
        assert len(urlsplit(other).path.split("/")[1]) >= 43
        assert urlsplit(other).path != urlsplit(address).path


def test_when_it_was_seen_nobody_listens_any_more(tmp_path: Path) -> None:
    (tmp_path / "view.rrd").write_bytes(b"RRF2")
    with handed_out(tmp_path / "view.rrd", ORIGIN) as address:
        assert fetch(address)[0] == 200
    with pytest.raises(ConnectionRefusedError):
        fetch(address)
