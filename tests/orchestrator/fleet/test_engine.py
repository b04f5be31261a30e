"""Every task is answered once, few are in flight, and a worker that dies costs its task one retry."""

from __future__ import annotations

import http.client
import re
import socket
import ssl
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
import pytest

from orchestrator.fleet import (
    ClusterSettings,
    Done,
    EngineSettings,
    FleetJob,
    FleetTable,
    Plan,
    Task,
    connected,
    find_sources,
    work_through,
)
from protocols import InputError
from tests.orchestrator.fleet.small import REFERENCE, damage, small_recordings
from tests.orchestrator.fleet.tasks import die, double, leave, refuse, stumble

if TYPE_CHECKING:
    from distributed import Client


def one_by_one(tasks: list[Task]) -> Callable[[], Task | None]:
    rest = iter(tasks)
    return lambda: next(rest, None)


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    with connected(ClusterSettings(jobs=2)) as found:
        yield found


def test_without_a_cluster_everything_is_done_here() -> None:
    tasks = [Task("a", double, (1,)), Task("b", refuse, (2,)), Task("c", stumble, (3,))]
    done = {answer.task.name: (answer.result, answer.failed) for answer in work_through(one_by_one(tasks))}
    assert done == {
        "a": (2, None),
        "b": (None, "tasks: 2: is refused"),
        "c": (None, "ZeroDivisionError: 3 in two lines"),
    }


DASK_PAGES = ("/status", "/info/main/workers.html", "/json/identity.json", "/metrics", "/health", "/proxy/80/127.0.0.1")


def pages_of_this_process() -> dict[str, bytes]:
    """What the HTTP ports of this process and its workers answer to a foreign host name."""
    answers: dict[str, bytes] = {}
    here = psutil.Process()
    for process in (here, *here.children(recursive=True)):
        for line in process.net_connections(kind="inet"):
            if line.status != psutil.CONN_LISTEN:
                continue
            assert line.laddr.ip == "127.0.0.1"
            for page in DASK_PAGES:
                connection = http.client.HTTPConnection("127.0.0.1", line.laddr.port, timeout=5.0)
                # The ports of tasks speak TLS.
                with suppress(OSError, http.client.HTTPException), closing(connection):
                    connection.request("GET", page, headers={"Host": "elsewhere.example"})
                    answer = connection.getresponse()
                    if answer.status == 200:
                        answers[page] = answer.read()
    return answers


def test_dask_shows_no_page_unless_it_is_requested(client: Client) -> None:
    assert all(address.startswith("tls://127.0.0.1:") for address in client.nthreads())
    assert pages_of_this_process() == {}


@pytest.mark.slow
def test_a_dashboard_that_is_requested_serves_no_data_and_loads_nothing_from_elsewhere() -> None:
    with connected(ClusterSettings(jobs=1, dashboard_port=0)) as client:
        assert client.dashboard_link.startswith("http://127.0.0.1:")
        answers = pages_of_this_process()
    assert set(answers) == {"/status", "/health"}
    assert not re.findall(rb'(?:src|href)="(?:https?:)?//(?!127)', answers["/status"])


def test_who_has_not_the_key_gives_the_workers_nothing_to_do(client: Client) -> None:
    """Whoever speaks to a scheduler or a worker has code run: another user of this machine is not let in."""
    for address in (client.scheduler_info()["address"], *client.nthreads()):
        port = int(address.rpartition(":")[2])
        assert answer_to(port, encrypted=False) == answer_to(port, encrypted=True) == b""


def answer_to(port: int, encrypted: bool) -> bytes:
    """What comes back to a line of nonsense from somebody without a certificate."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=10) as plain:
        if not encrypted:
            plain.sendall(bytes(64))
            return plain.recv(1)
        with context.wrap_socket(plain) as line:
            line.sendall(bytes(64))
            return line.recv(1)
    return b""


def test_all_are_answered_once_whatever_they_raise_and_few_are_in_flight(client: Client) -> None:
    tasks = [Task(f"t{n}", stumble if n % 7 == 0 else double, (n,)) for n in range(40)]
    upcoming = one_by_one(tasks)
    given = answered = most = 0

    def next_task() -> Task | None:
        nonlocal given, most
        task = upcoming()
        given += task is not None
        most = max(most, given - answered)
        return task

    answers: list[Done] = []
    for answer in work_through(next_task, client, EngineSettings(in_flight_per_worker=3)):
        answered += 1
        answers.append(answer)
    assert sorted(answer.task.name for answer in answers) == sorted(task.name for task in tasks)
    assert [a.result for a in answers if a.failed is None] != []
    assert all(a.result == 2 * a.task.arguments[0] for a in answers if a.failed is None)
    assert {a.task.arguments[0] % 7 for a in answers if a.failed is not None} == {0}
    assert most <= 6


def test_new_tasks_may_come_of_answers(client: Client) -> None:
    more = [Task("first", double, (1,))]
    results = []
    for answer in work_through(lambda: more.pop() if more else None, client):
        results.append(answer.result)
        if answer.result < 10:
            more.append(Task(f"after-{answer.result}", double, (answer.result,)))
    assert results == [2, 4, 8, 16]


@pytest.mark.slow
def test_a_dead_worker_costs_its_task_one_retry_and_its_neighbours_nothing(client: Client, tmp_path: Path) -> None:
    """And the rest of the job goes on: a row each for good and bad recordings afterwards."""
    tasks = [Task(f"t{n}", double, (n,)) for n in range(12)]
    tasks[3:3] = [Task("once", die, (str(tmp_path / "once"), 1)), Task("always", die, (str(tmp_path / "always"), 9))]
    answers = {answer.task.name: answer for answer in work_through(one_by_one(tasks), client)}
    assert len(answers) == 14
    assert (answers["once"].result, answers["once"].attempts) == ("alive", 2)
    assert (answers["always"].failed, answers["always"].attempts) == ("its worker died 2 times", 2)
    assert all(answers[f"t{n}"].result == 2 * n for n in range(12))


@pytest.mark.slow
def test_an_answer_that_was_lost_with_its_worker_is_made_again(client: Client, tmp_path: Path) -> None:
    """The job looks at it only when it is gone."""
    next_task = one_by_one([Task("other", double, (4,)), Task("lost", leave, (str(tmp_path / "left"), 0.5))])
    results = {}
    for answer in work_through(next_task, client):
        results[answer.task.name] = answer.result
        time.sleep(1.2)
    assert results == {"lost": 7, "other": 8}


@pytest.mark.slow
def test_recordings_are_worked_on_by_processes(client: Client, tmp_path: Path) -> None:
    damage(small_recordings(tmp_path / "bench", 6)[1])
    found = find_sources([str(tmp_path / "bench"), str(REFERENCE)], files=False, limit=None, tell=lambda _: None)
    with FleetTable.opened(tmp_path / "table") as table:
        rows = list(FleetJob(found, table, Plan()).rows(client))
    good = {str(row.name): row for row in rows if row.failed is None}
    assert sorted(good) == [*(f"motor-{n}" for n in (0, 2, 3, 4, 5)), "pm400-reduced"]
    whole = good["pm400-reduced"]
    assert whole.L_d_h == pytest.approx(0.0432, rel=0.01)
    assert whole.L_q_h == pytest.approx(0.069, rel=0.01)
    assert whole.set_points is not None
    assert len(whole.set_points) == 8
    assert [row.name for row in rows if row.failed is not None] == ["motor-1"]


def test_a_scheduler_that_is_not_there_is_one_line() -> None:
    settings = ClusterSettings(scheduler="tcp://127.0.0.1:9", wait_s=0.2)
    with pytest.raises(InputError, match=r"^--scheduler: tcp://127\.0\.0\.1:9: no scheduler"), connected(settings):
        pass
