"""What a fleet's job must get through: workers and clients that die, bad recordings among good, object stores."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import time
from collections import Counter
from pathlib import Path

import fsspec
import psutil
import pytest

from orchestrator.fleet import find_sources, parts_of, read_table
from tests.orchestrator.fleet.servers import AWS, cluster_of_processes, s3_server, worker_of
from tests.orchestrator.fleet.small import damage, small_recordings
from tests.support.processes import FLUXBENCH, start_afresh, wait_until

LONG = 900
"""Recordings that take half a minute or more, several times as long as rows wait to be written."""
KILLS, BAD = 20, (7, 123, 250, 388, 499)

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


def test_workers_killed_at_random_lose_nothing_and_bad_recordings_are_named(tmp_path: Path) -> None:
    """Scheduler, client and two workers as processes of their own; SIGKILL for a worker, twenty times."""
    made = small_recordings(tmp_path / "bench", LONG)
    for number in BAD:
        damage(made[number])
    chance, kills = random.Random(18), 0
    with cluster_of_processes(tmp_path) as (address, nannies):
        words = ["fleet", str(tmp_path / "bench"), "--out", str(tmp_path / "table"), "--scheduler", address, "--json"]
        wait_until(lambda: (tmp_path / "scheduler.log").read_text().count("Register worker addr") == len(nannies))
        client = start_afresh(*words)
        wait_until(lambda: bool(psutil.Process(client.pid).net_connections("tcp4")))
        while client.poll() is None and kills < KILLS:
            time.sleep(chance.uniform(0.2, 2.0))
            worker = worker_of(chance.choice(nannies))
            if worker is not None:
                worker.kill()
                kills += 1
        printed, complaints = client.communicate()
    assert client.returncode == 0, complaints
    assert kills == KILLS
    rows = read_table(tmp_path / "table")
    assert Counter(row.source for row in rows) == Counter(map(str, made))
    assert len({row.key for row in rows}) == LONG
    bad = {row.source: row.failed for row in rows if row.failed is not None}
    assert sorted(bad) == sorted(str(made[number]) for number in BAD)
    assert all("sha256" in str(problem) for problem in bad.values())
    assert all(row.R_s_ohm is not None for row in rows if row.failed is None)
    assert json.loads(printed)["new"] == LONG
    assert {row.attempts for row in rows} == {1, 2}


def test_a_job_that_is_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    """And leaves no worker behind."""
    made = small_recordings(tmp_path / "bench", LONG)
    words = ["fleet", str(tmp_path / "bench"), "--out", str(tmp_path / "table"), "--jobs", "2", "--json"]
    client = start_afresh(*words)
    wait_until(lambda: bool(parts_of(tmp_path / "table")))
    family = psutil.Process(client.pid).children(recursive=True)
    client.kill()
    client.communicate()
    kept = read_table(tmp_path / "table")
    assert 0 < len(kept) < len(made)
    _, left = psutil.wait_procs(family, 30.0)
    assert not left
    again = subprocess.CompletedProcess(words, *_run(words))
    assert (again.returncode, again.stderr) == (0, "")
    report = json.loads(again.stdout)
    assert (report["known"], report["new"]) == (len(kept), len(made) - len(kept))
    rows = read_table(tmp_path / "table")
    assert Counter(row.source for row in rows) == Counter(map(str, made))
    assert rows[: len(kept)] == kept


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_who_interrupts_a_job_gets_one_line_and_keeps_what_was_done(tmp_path: Path, number: signal.Signals) -> None:
    """Ctrl-C at a terminal reaches the workers too, which have nothing to say about it."""
    small_recordings(tmp_path / "bench", LONG)
    words = ["fleet", str(tmp_path / "bench"), "--out", str(tmp_path / "table"), "--jobs", "1"]
    client = subprocess.Popen(
        [FLUXBENCH, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    wait_until(lambda: bool(parts_of(tmp_path / "table")))
    written = len(read_table(tmp_path / "table"))
    time.sleep(2.0)
    if number is signal.SIGINT:
        os.killpg(client.pid, number)
    else:
        client.send_signal(number)
    _, complaints = client.communicate()
    assert complaints == "fluxbench: interrupted; started again, the job continues where it stopped\n"
    assert client.returncode == 130
    assert written < len(read_table(tmp_path / "table")) < LONG


def test_a_scheduler_that_goes_away_is_one_line_and_what_was_done_is_kept(tmp_path: Path) -> None:
    small_recordings(tmp_path / "bench", LONG)
    with cluster_of_processes(tmp_path) as (address, _):
        client = start_afresh("fleet", tmp_path / "bench", "--out", tmp_path / "table", "--scheduler", address)
        wait_until(lambda: bool(parts_of(tmp_path / "table")))
        children = psutil.Process().children()
        next(one for one in children if "distributed.cli.dask_scheduler" in one.cmdline()).kill()
        _, complaints = client.communicate()
    assert client.returncode == 3
    assert complaints.startswith(f"fluxbench: the scheduler {address} is gone")
    assert complaints.count("\n") == 1
    assert read_table(tmp_path / "table")


def _run(words: list[str]) -> tuple[int, str, str]:
    started = start_afresh(*words)
    out, error = started.communicate()
    return started.returncode, out, error


def test_object_storage_is_a_source_like_any_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server process that speaks S3: the same rows as from the folder, and the same keys: nothing is done twice."""
    made = small_recordings(tmp_path / "bench" / "lot-7", 8)
    damage(made[5])
    table = tmp_path / "table"
    with s3_server(tmp_path) as endpoint:
        for name, value in {**AWS, "AWS_ENDPOINT_URL": endpoint}.items():
            monkeypatch.setenv(name, value)
        fs = fsspec.filesystem("s3", use_listings_cache=False, skip_instance_cache=True)
        fs.mkdir("bench")
        fs.put(str(tmp_path / "bench" / "lot-7"), "bench/lot-7", recursive=True)
        code, out, error = _run(["fleet", "s3://bench", "--out", str(table), "--jobs", "2", "--json"])
        assert (code, error) == (0, "")
        assert json.loads(out)["new"] == 8
        code, out, _ = _run(["fleet", "s3://bench", str(tmp_path / "bench"), "--out", str(table), "--json"])
        report = json.loads(out)
        assert (code, report["known"], report["same"], report["new"]) == (0, 8, 8, 0)
        assert len(find_sources(["s3://bench/lot-7"], files=False, limit=None, tell=lambda _: None)) == 8
    rows = read_table(table)
    assert sorted(row.source for row in rows) == [f"s3://bench/lot-7/r{n:03d}" for n in range(8)]
    (bad,) = [row for row in rows if row.failed is not None]
    assert bad.source == "s3://bench/lot-7/r005"
    assert bad.failed is not None
    assert bad.failed.startswith("s3://bench/lot-7/r005/captures/resistance-000.parquet: sha256")
    assert {row.batch for row in rows} == {"lot-7"}
