"""Who is answered: whoever has the token, from the page itself, under this machine's own name."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import psutil
import pytest

from tests.plugins.commands.serve.served import Served, serving

READ = (
    "/", "/page.js", "/choices", "/events", "/report/some",
    "/shelf", "/shelf.js", "/drawing.js", "/listed", "/trend", "/compared", "/labels",
)  # fmt: skip
CHANGING = ("/check", "/start", "/resume", "/answer", "/stop", "/label", "/view")


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with serving(tmp_path_factory.mktemp("bench")) as served:
        yield served


@pytest.mark.parametrize("path", [*READ, "/?token=", "/?token=wrong", "/choices?token=wrong", "/nothing"])
def test_without_the_token_nothing_is_reported(path: str, served: Served) -> None:
    for headers in ({}, {"Cookie": f"fluxbench_{served.port}=wrong"}, {"Cookie": f"fluxbench={served.token}"}):
        reply = served.ask("GET", path, headers)
        assert reply.status == 403
        assert served.token.encode() not in reply.body
        assert "set-cookie" not in reply.headers


@pytest.mark.parametrize("path", CHANGING)
def test_without_the_token_nothing_is_done(path: str, served: Served) -> None:
    assert served.ask("POST", path, {"Origin": served.origin}, b"{}").status == 403


def test_the_token_in_the_address_becomes_a_cookie_that_no_script_reads(served: Served) -> None:
    reply = served.ask("GET", f"/?token={served.token}", {})
    assert reply.status == 200
    cookie = reply.headers["set-cookie"]
    assert cookie == f"fluxbench_{served.port}={served.token}; Path=/; HttpOnly; SameSite=Strict"
    assert served.get("/choices").status == 200


def test_the_token_counts_in_the_page_s_own_address_only(served: Served) -> None:
    assert served.ask("GET", f"/choices?token={served.token}", {}).status == 403
    assert served.ask("POST", f"/?token={served.token}", {"Origin": served.origin}, b"{}").status == 403


@pytest.mark.parametrize("host", ["bench.example.org", "bench.example.org:80", "127.0.0.1.example.org", "0.0.0.0", "["])
def test_under_a_foreign_name_nothing_is_reported(host: str, served: Served) -> None:
    assert served.ask("GET", "/choices", {**served.cookie, "Host": host}).status == 403
    assert served.ask("GET", f"/?token={served.token}", {"Host": host}).status == 403


def test_localhost_is_this_machine_too(served: Served) -> None:
    assert served.ask("GET", "/page.css", {**served.cookie, "Host": f"localhost:{served.port}"}).status == 200


@pytest.mark.parametrize("origin", [None, "null", "https://example.org", "http://127.0.0.1:1", "http://localhost"])
@pytest.mark.parametrize("path", CHANGING)
def test_what_changes_something_comes_from_the_page_itself(origin: str | None, path: str, served: Served) -> None:
    headers = served.cookie if origin is None else {**served.cookie, "Origin": origin}
    assert served.ask("POST", path, headers, b"{}").status == 403


@pytest.mark.parametrize("path", CHANGING)
def test_nothing_is_changed_by_reading(path: str, served: Served) -> None:
    assert served.get(path).status == 405


def test_no_other_origin_is_let_read_and_nothing_foreign_is_loaded(served: Served) -> None:
    reply = served.ask("GET", "/", {**served.cookie, "Origin": "https://example.org"})
    assert not [name for name in reply.headers if name.startswith("access-control")]
    assert "default-src 'self'" in reply.headers["content-security-policy"]
    assert reply.headers["cross-origin-resource-policy"] == "same-origin"
    assert reply.headers["cache-control"] == "no-store"
    preflight = served.ask("OPTIONS", "/start", {**served.cookie, "Origin": "https://example.org"})
    assert preflight.status == 403


def test_it_listens_to_this_machine_alone(served: Served) -> None:
    sockets = psutil.Process(served.process.pid).net_connections(kind="inet")
    assert [(s.laddr.ip, s.laddr.port) for s in sockets if s.status == "LISTEN"] == [("127.0.0.1", served.port)]


def test_the_token_stands_in_no_file_no_command_line_and_no_environment(served: Served) -> None:
    process = psutil.Process(served.process.pid)
    assert len(served.token) >= 43
    assert not any(served.token in word for word in [*process.cmdline(), *process.environ().values()])
    files = [path for path in served.folder.rglob("*") if path.is_file()]
    assert not [path for path in files if served.token.encode() in path.read_bytes()]


@pytest.mark.skipif(os.name != "posix" or os.getuid() != 0, reason="another user can be had by root only")
def test_another_user_of_this_machine_is_reported_nothing(served: Served) -> None:
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.setgroups([])
            os.setgid(65534)
            os.setuid(65534)
            found = [str(served.ask("GET", path, {}).status) for path in ("/", "/choices", "/events")]
            for name in ("environ", "mem", "fd/0"):
                found.append(str(os.access(f"/proc/{served.process.pid}/{name}", os.R_OK)))
            os.write(writing, " ".join(found).encode())
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    assert os.read(reading, 1000).decode().split() == ["403"] * 3 + ["False"] * 3


@pytest.mark.parametrize(
    "run", ["..", "%2e%2e", "..%2f..%2fetc", "nothing", "a/b", "%00", "a%00b", "x" * 300, "%ff", "%ed%a0%80"]
)
def test_reports_are_those_of_the_folder_s_runs(run: str, served: Served) -> None:
    assert served.get(f"/report/{run}").status in (400, 404)


@pytest.mark.parametrize(
    "body",
    [b"", b"[]", b"{", b"[" * 60_000, b'{"procedure": 5}', b'{"procedure": "demo", "colour": "red"}', b"x" * 70_000],
)
def test_a_request_that_is_wrong_is_one_line(body: bytes, served: Served) -> None:
    reply = served.ask("POST", "/start", {**served.cookie, "Origin": served.origin}, body)
    assert reply.status == 400
    assert "\n" not in reply.content["problem"]


@pytest.mark.parametrize("name", ["../x.yaml", "/etc/passwd", "--help", "nothing", ""])
def test_what_is_not_on_the_list_is_not_started(name: str, served: Served) -> None:
    assert served.post("/start", {"procedure": name}).status == 400
    if name:
        assert served.post("/start", {"procedure": "demo", "motor": name}).status == 400


@pytest.mark.parametrize("path", ["/start", "/check"])
@pytest.mark.parametrize("text", ["a\0b", "\ud800", "x" * 3000])
@pytest.mark.parametrize("field", ["procedure", "motor", "drive", "settings", "serial", "operator", "tags", "note"])
def test_a_text_that_no_command_line_holds_is_refused(field: str, text: str, path: str, served: Served) -> None:
    value = [text] if field in ("settings", "tags") else text
    reply = served.post(path, {"procedure": "demo"} | {field: value})
    assert reply.status == 400
    assert field in reply.content["problem"] or "surrogate" in reply.content["problem"]


@pytest.mark.parametrize("name", ["a\0b", "x" * 300, "x" * 1900])
def test_a_run_that_no_file_system_holds_is_none(name: str, served: Served) -> None:
    for path in ("/resume", "/label", "/view"):
        assert served.post(path, {"run": name}).status == 400
    assert served.get(f"/labels?run={quote(name)}").status == 400
    assert served.get(f"/compared?runs={quote(name)}&runs={quote(name)}").status == 400


@pytest.mark.parametrize(
    "path",
    [
        "/listed?words=%00", "/listed?sort=colour", "/listed?sort=run;DROP", "/listed?skip=x", "/listed?skip=-1",
        "/listed?skip=" + "9" * 5000, "/listed?colour=red", "/listed?words=" + "x" * 3000, "/trend", "/trend?motor=%00",
        "/compared", "/compared?runs=a", "/compared?runs=a&runs=b", "/compared" + "?" + "&".join(["runs=a"] * 9),
        "/labels", "/labels?run=..", "/labels?run=a&run=b",
    ],
)  # fmt: skip
def test_a_question_that_is_wrong_is_one_line(path: str, served: Served) -> None:
    reply = served.get(path)
    assert reply.status == 400
    assert "\n" not in reply.content["problem"]


def test_a_port_that_is_taken_is_stated_in_one_line(served: Served, tmp_path: Path) -> None:
    from tests.support.processes import called

    done = called("serve", tmp_path, "--port", str(served.port))
    assert done.returncode == 2
    assert done.stderr.startswith(f"fluxbench: --port: {served.port}: ")
