"""A viewer that is absent, late, stopped, killed or started again costs nothing, and misses only what is counted."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from plugins.streams.rerun import RerunOptions, RerunStream
from plugins.streams.rerun._live import LiveFeed, free_port, wait_for_viewer
from plugins.streams.rerun._tape import Entry, is_whole, scalars
from plugins.streams.rerun._viewer import start, viewer_words
from protocols import StreamSetup
from tests.plugins.streams.rerun.reading import arrived, entities, receiver, rows
from tests.plugins.streams.rerun.test_stream import POINTS, a_commissioning
from tests.support.processes import wait_until

BLOCK = 500


def a_block(number: int) -> Entry:
    times = number + np.arange(BLOCK) / BLOCK
    return scalars("drive/current", times, np.zeros((BLOCK, 2)))


def listening(pid: int) -> set[str]:
    """Addresses that a process and its children listen on."""
    process = psutil.Process(pid)
    found = [c for p in (process, *process.children(recursive=True)) for c in p.net_connections()]
    return {c.laddr.ip for c in found if c.status == psutil.CONN_LISTEN}


def test_without_a_viewer_nothing_waits_and_what_is_dropped_is_counted() -> None:
    feed = LiveFeed("nobody", free_port(), 1e6)
    took = []
    for number in range(200):
        block = a_block(number)
        begun = time.perf_counter()
        feed.put(block)
        took.append(time.perf_counter() - begun)
    # A busy machine holds up one or two; a wait for the viewer would hold up all.
    assert sorted(took)[-10] < 0.1
    kept = int(1e6 / a_block(0).size)
    assert feed.dropped == 200 - kept
    feed.close()
    assert feed.dropped == 200


def test_a_viewer_that_starts_late_gets_what_was_kept(tmp_path: Path) -> None:
    port = free_port()
    feed = LiveFeed("late", port, 1e7)
    for number in range(5):
        feed.put(a_block(number))
    with receiver(port, tmp_path / "got.rrd"):
        wait_until(lambda: feed.delivered == 5)
        feed.put(a_block(5))
        feed.close()
        wait_until(lambda: arrived(tmp_path / "got.rrd")["/drive/current"] == 6 * BLOCK)
    assert feed.dropped == 0


def test_a_viewer_that_is_started_again_gets_everything_again(tmp_path: Path) -> None:
    port = free_port()
    feed = LiveFeed("again", port, 1e7)
    with receiver(port, tmp_path / "first.rrd"):
        feed.put(a_block(0))
        wait_until(lambda: feed.delivered == 1)
    for number in range(1, 4):
        feed.put(a_block(number))
    with receiver(port, tmp_path / "second.rrd"):
        wait_until(lambda: feed.delivered >= 5)
        feed.close()
        wait_until(lambda: arrived(tmp_path / "second.rrd")["/drive/current"] == 4 * BLOCK)
    assert feed.dropped == 0


def test_a_viewer_that_is_stopped_holds_up_neither_the_run_nor_its_end(tmp_path: Path) -> None:
    port = free_port()
    run = tmp_path / "run"
    run.mkdir()
    with receiver(port, tmp_path / "got.rrd") as viewer:
        options = RerunOptions(view="connect", port=port, queue_mb=0.1)
        stream = RerunStream(StreamSetup(run=run, options=options))
        messages = a_commissioning(run, points=60)
        for number, message in enumerate(messages):
            if number == 20:
                viewer.send_signal(signal.SIGSTOP)
            begun = time.perf_counter()
            stream.receive(message)
            assert time.perf_counter() - begun < 1.0
        begun = time.perf_counter()
        stream.close()
        assert time.perf_counter() - begun < 5.0
    assert is_whole(run / "view.rrd")
    assert entities(run / "view.rrd")["/drive/current"] == 50 * 60


DRAW = """
import sys
from pathlib import Path
from plugins.streams.rerun import RerunOptions, RerunStream
from protocols import StreamSetup
from tests.plugins.streams.rerun.test_stream import a_commissioning
run = Path(sys.argv[1])
stream = RerunStream(StreamSetup(run=run, options=RerunOptions(view="connect", port=int(sys.argv[2]))))
for message in a_commissioning(run):
    stream.receive(message)
print("half", flush=True)
sys.stdin.readline()
for message in a_commissioning(run, points=100):
    stream.receive(message)
stream.close()
print("closed", flush=True)
"""


@pytest.mark.slow
def test_a_stopped_viewer_does_not_keep_the_process_from_ending(tmp_path: Path) -> None:
    port = free_port()
    run = tmp_path / "run"
    run.mkdir()
    with receiver(port, tmp_path / "got.rrd") as viewer:
        words = [sys.executable, "-c", DRAW, str(run), str(port)]
        root = Path(__file__).parents[4]
        with subprocess.Popen(words, cwd=root, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            assert process.stdout.readline() == "half\n"
            viewer.send_signal(signal.SIGSTOP)
            print("on", file=process.stdin, flush=True)
            assert process.stdout.readline() == "closed\n"
            begun = time.perf_counter()
            assert process.wait(20.0) == 0
            assert time.perf_counter() - begun < 10.0
    assert is_whole(run / "view.rrd")


def test_a_viewer_that_is_killed_leaves_the_file_whole_and_the_loss_reported(tmp_path: Path) -> None:
    port = free_port()
    run = tmp_path / "run"
    run.mkdir()
    with receiver(port, tmp_path / "got.rrd") as viewer:
        stream = RerunStream(StreamSetup(run=run, options=RerunOptions(view="connect", port=port)))
        messages = a_commissioning(run)
        for number, message in enumerate(messages):
            if number == 8:
                viewer.kill()
                viewer.wait()
            stream.receive(message)
        stream.close()
    assert stream.dropped > 0
    assert stream.notes == (f"the live viewer missed {stream.dropped} entries; view.rrd has them all",)
    assert is_whole(run / "view.rrd")
    assert entities(run / "view.rrd")["/drive/current"] == 50 * POINTS
    assert any("missed" in str(row) for row in rows(run / "view.rrd", "/log"))


def test_the_page_and_its_data_are_served_to_this_machine_alone() -> None:
    port, web_port = free_port(), free_port()
    process = start(viewer_words(port, "500MB", web_port=web_port))
    try:
        assert wait_for_viewer(web_port, 20.0, lambda: process.has_ended)
        assert wait_for_viewer(port, 20.0, lambda: process.has_ended)
        assert listening(process.pid) == {"127.0.0.1"}
    finally:
        process.stop()
    assert not psutil.pid_exists(process.pid)


@pytest.mark.parametrize("web_port", [None, 9090])
@pytest.mark.parametrize("headless", [True, False])
def test_every_viewer_is_reported_to_stay_on_this_machine(web_port: int | None, headless: bool) -> None:
    words = viewer_words(9876, "1GB", web_port=web_port, headless=headless)
    assert words[words.index("--bind") + 1] == "127.0.0.1"
