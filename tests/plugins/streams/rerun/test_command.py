"""`fluxbench view`: makes what is missing, says so, prints the table, and keeps to this machine."""

from __future__ import annotations

import http.client
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from orchestrator.estimation import load_estimates
from plugins.streams.rerun._blueprints import diagnosis
from plugins.streams.rerun._catalogue import row, served
from plugins.streams.rerun._command import TABS, Later, command
from plugins.streams.rerun._diagnosis import Contents
from plugins.streams.rerun._live import HOST, free_port, wait_for_viewer
from plugins.streams.rerun._making import comparison_view, whole_view
from plugins.streams.rerun._replay import replay
from plugins.streams.rerun._tape import is_whole
from protocols import LawLearned, Note, PointDone, RecordingError, RunEnded, RunStarted, SamplesCaptured, StorageError
from tests.orchestrator.discovery.test_command import a_discovery
from tests.plugins.streams.example_run import a_run_directory
from tests.plugins.streams.rerun.reading import entities, rows
from tests.plugins.streams.rerun.test_live import listening
from tests.support.cases import few
from tests.support.processes import start_afresh, wait_until

RECORDING = Path(__file__).parents[3] / "data" / "pm400-reduced"


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run; tests take copies."""
    return a_run_directory(tmp_path_factory.mktemp("example") / "run")


def copied(example: Path, to: Path) -> Path:
    return Path(shutil.copytree(example, to))


def test_a_run_is_replayed_with_its_samples_before_each_point_and_its_maps_before_the_end(example: Path) -> None:
    kinds = [message.kind for message in replay(example)]
    assert kinds[0] == "run_started"
    assert kinds[-1] == "run_ended"
    assert kinds.count("samples_captured") == kinds.count("point_done") > 0
    assert all(kinds[k - 1] == "samples_captured" for k, kind in enumerate(kinds) if kind == "point_done")
    assert kinds.index("map_estimated") > len(kinds) - kinds[::-1].index("point_done") - 1


def test_a_recording_that_no_run_made_is_replayed_too() -> None:
    messages = list(replay(RECORDING))
    assert isinstance(messages[0], RunStarted)
    done = [m for m in messages if isinstance(m, PointDone)]
    longest = max((m.achieved_d_a**2 + m.achieved_q_a**2) ** 0.5 for m in done)
    assert messages[0].limits.current_a > longest
    assert {m.segment for m in messages if isinstance(m, SamplesCaptured)} == {m.id for m in done}


def test_a_learned_law_is_replayed_with_its_curve_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    recording = copied(RECORDING, tmp_path / "recording")
    file = recording / "results" / "discovery.json"
    file.parent.mkdir(exist_ok=True)
    file.write_text(a_discovery().model_dump_json(), encoding="utf-8")
    (law,) = (m for m in replay(recording) if isinstance(m, LawLearned))
    assert (law.formula, law.x_label, law.y_label) == ("a tanh(i / b)", "i [A]", "leg voltage [V]")
    assert list(law.y) == pytest.approx([-0.1, 0.0, 0.1])
    file.write_text("{", encoding="utf-8")
    assert any(isinstance(m, Note) and "discovery.json" in m.text for m in replay(recording))


def test_a_view_is_made_where_there_is_none_and_made_anew_where_it_is_torn(tmp_path: Path, example: Path) -> None:
    run = copied(example, tmp_path / "run")
    before = {p.name for p in run.iterdir()}
    messages: list[str] = []
    found = whole_view(run, messages.append)
    assert found.file == run / "view.rrd"
    assert is_whole(found.file)
    assert {p.name for p in run.iterdir()} == before | {"view.rrd"}
    assert "is missing" in messages[-1]
    whole = entities(found.file)
    with found.file.open("r+b") as torn:
        torn.truncate(found.file.stat().st_size // 2)
    whole_view(run, messages.append)
    assert "is torn" in messages[-1]
    assert entities(found.file) == whole
    whole_view(run, messages.append)
    assert len(messages) == 2


@pytest.mark.slow
def test_a_view_that_is_older_than_the_results_is_made_anew(tmp_path: Path, example: Path) -> None:
    run = copied(example, tmp_path / "run")
    messages: list[str] = []
    file = whole_view(run, messages.append).file
    os.utime(file, (file.stat().st_mtime - 3600.0,) * 2)
    whole_view(run, messages.append)
    assert "is older than the run's results" in messages[-1]
    whole_view(run, messages.append)
    assert len(messages) == 2


@pytest.mark.slow
def test_a_view_that_is_served_is_due_anew_when_there_are_later_results(tmp_path: Path, example: Path) -> None:
    run = copied(example, tmp_path / "run")
    later = Later(run, whole_view(run, print).file)
    assert not later.is_due()
    os.utime(later.file, (later.file.stat().st_mtime - 3600.0,) * 2)
    result = next((run / "results").iterdir())
    os.utime(result)
    assert not later.is_due(), "it may be written to still"
    assert later.is_due(settled_s=0.0)
    later.make()
    assert not later.is_due(settled_s=0.0)
    assert is_whole(later.file)


@pytest.mark.slow
def test_a_page_keeps_its_address_when_the_view_is_made_anew(tmp_path: Path, example: Path) -> None:
    run = copied(example, tmp_path / "run")
    process = start_afresh("view", run, "--web")
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        address = urlsplit(process.stdout.readline().strip())
        assert "open this address" in "".join(process.stderr.readline() for _ in range(2))
        for file, age_s in ((run / "view.rrd", 3600.0), *((result, 60.0) for result in (run / "results").iterdir())):
            os.utime(file, (time.time() - age_s,) * 2)
        assert "newer results" in process.stderr.readline()
        assert "reload the page" in process.stderr.readline()
        assert wait_for_viewer(int(address.port or 0), 30.0)
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)


def test_a_foreign_recording_is_left_as_it_is(tmp_path: Path) -> None:
    recording = tmp_path / "foreign"
    shutil.copytree(RECORDING, recording)
    before = sorted(p.name for p in recording.rglob("*"))
    found = whole_view(recording, print)
    try:
        assert recording not in found.file.parents
        assert "left as it is" in found.remark
        assert is_whole(found.file)
    finally:
        shutil.rmtree(found.file.parent)
    assert sorted(p.name for p in recording.rglob("*")) == before


def test_a_folder_of_runs_is_a_table_one_line_a_run(
    tmp_path: Path, example: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copied(example, tmp_path / "a")
    a_run_directory(tmp_path / "b", motor="other motor", ended=False)
    broken = copied(example, tmp_path / "c")
    (broken / "run.json").write_text("{", encoding="utf-8")
    assert command([str(tmp_path), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(r["run"], r["outcome"], r["view"]) for r in rows] == [
        ("a", "finished", "missing"),
        ("b", "unfinished", "missing"),
        ("c", "unreadable", "missing"),
    ]
    assert rows[1]["motor"] == "other motor"


def test_the_catalogue_serves_runs_with_their_properties_to_this_machine_alone(tmp_path: Path, example: Path) -> None:
    files = [whole_view(copied(example, tmp_path / name), print).file for name in "ab"]
    for file in files:
        assert ["x"] in rows(file, "/__properties/motor")[0].values()
        assert rows(file, "/__properties/outcome")
    with served(files) as url:
        assert url.startswith(f"rerun+http://{HOST}:")
        assert listening(os.getpid()) == {HOST}


@pytest.mark.parametrize("more", [[], ["--screenshot", "picture.png"], ["--web", "--screenshot", "picture.png"]])
def test_a_folder_of_runs_in_a_pipe_is_refused_with_the_runs_in_it(tmp_path: Path, more: list[str]) -> None:
    for name in "abcdefghi":
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").touch()
    with pytest.raises(RecordingError, match=r"a folder of runs, not a run: a, b, c, d, e, f, g, h and 1 more; name"):
        command([str(tmp_path), *more])


def test_the_tabs_that_help_lists_are_those_of_the_layouts() -> None:
    layout = diagnosis(Contents(excerpts=1, loops=1, resistance=True, laws=1), measured=True)
    named = [str(tab.name) for tab in layout.root_container.contents]
    assert sorted(named) == sorted(TABS)
    page = (Path(__file__).parents[4] / "docs" / "viewer.md").read_text(encoding="utf-8")
    assert all(tab in " ".join(page.split()) for tab in TABS)


@pytest.mark.parametrize("name", ["nowhere", "empty"])
def test_what_cannot_be_viewed_is_one_line(tmp_path: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match=name) as caught:
        command([str(tmp_path / name)])
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_without_a_display_it_is_a_page_on_this_machine_until_interrupted(
    tmp_path: Path, example: Path, by: signal.Signals
) -> None:
    run, port = copied(example, tmp_path / "run"), free_port()
    code = "import sys; from plugins.streams.rerun._command import command; sys.exit(command(sys.argv[1:]))"
    words = [sys.executable, "-c", code, str(run), "--port", str(port)]
    hidden = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    with subprocess.Popen(
        words, env=hidden, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=Path(__file__).parents[4]
    ) as process:
        try:
            assert process.stdout is not None
            page = process.stdout.readline()  # once it is served, however long a busy machine takes
            assert listening(process.pid) == {HOST}
            handed = urlsplit(unquote(page.partition("?url=")[2].strip()))
            assert got(handed.port, handed.path) == (200, f"http://{HOST}:{port}")
            assert got(handed.port, "/wrong/view.rrd") == (403, None)
        finally:
            process.send_signal(by)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert page.startswith(f"http://{HOST}:{port}/?url=")
    assert not wait_for_viewer(port, 0.3)


def got(port: int | None, path: str) -> tuple[int, str | None]:
    """What a port answers to a request, and which pages a browser lets read it."""
    line = http.client.HTTPConnection(HOST, port or 0, timeout=5.0)
    try:
        line.request("GET", path)
        answer = line.getresponse()
        return answer.status, answer.getheader("access-control-allow-origin")
    finally:
        line.close()


@pytest.mark.slow
def test_a_killed_page_takes_its_server_with_it(tmp_path: Path, example: Path) -> None:
    if shutil.which("setpriv") is None:
        pytest.skip("there is no setpriv here")
    code = """
import sys, time
from plugins.streams.rerun._viewer import start, tied
print(start(tied([sys.executable, "-c", "import time; time.sleep(60)"])).pid, flush=True)
time.sleep(60)
"""
    root = Path(__file__).parents[4]
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=root) as process:
        assert process.stdout is not None
        server = int(process.stdout.readline())
        wait_until(lambda: b"setpriv" not in Path(f"/proc/{server}/cmdline").read_bytes())
        process.kill()
    wait_until(lambda: not Path(f"/proc/{server}/fd").exists() or _is_zombie(server))


def _is_zombie(pid: int) -> bool:
    try:
        return ") Z" in Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return True


@pytest.mark.parametrize("content", [b"junk", b"", b"RRF2 and no end"])
def test_a_file_that_is_none_of_reruns_or_torn_is_one_line(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "some.rrd"
    file.write_bytes(content)
    with pytest.raises(RecordingError, match=r"torn: its end" if content.startswith(b"RRF") else "not a rerun file"):
        command([str(file), "--screenshot", str(tmp_path / "x.png")])
    assert not (tmp_path / "x.png").exists()


@few("is_ours", [True, False])
def test_a_full_disk_is_one_line_and_leaves_no_half_view(
    tmp_path: Path, example: Path, is_ours: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = copied(example, tmp_path / "run") if is_ours else Path(shutil.copytree(RECORDING, tmp_path / "run"))
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    before = sorted(tmp_path.rglob("*"))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(StorageError, match="cannot be written") as caught:
            whole_view(run, print)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "\n" not in str(caught.value)
    assert sorted(tmp_path.rglob("*")) == before


def test_what_was_made_for_a_picture_alone_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = Path(shutil.copytree(RECORDING, tmp_path / "foreign"))
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    monkeypatch.setattr("plugins.streams.rerun._command._picture", lambda file, to, tab: int(not file.is_file()))
    assert command([str(recording), "--screenshot", str(tmp_path / "x.png")]) == 0
    assert list((tmp_path / "tmp").iterdir()) == []


def test_the_table_has_the_verdict_of_a_later_diagnosis(tmp_path: Path, example: Path) -> None:
    run = copied(example, tmp_path / "run")
    (run / "results").mkdir(exist_ok=True)
    (run / "results" / "diagnosis.json").write_text('{"verdict": "within_noise"}', encoding="utf-8")
    assert row(run, pytest.fail)["verdict"] == "within_noise"


def test_the_table_has_the_results_of_a_later_estimate(tmp_path: Path, example: Path) -> None:
    run = copied(example, tmp_path / "run")
    report = load_estimates(run).model_copy(update={"method": "model", "usable": True})
    (run / "results" / "estimates.json").write_text(report.model_dump_json(), encoding="utf-8")
    assert report.resistance is not None
    assert [row(run, pytest.fail)[name] for name in ("r_s_ohm", "map_by", "usable")] == [
        report.resistance.value_ohm,
        "model",
        True,
    ]


def test_a_replay_ends_with_the_newest_estimates(tmp_path: Path, example: Path) -> None:
    run = copied(example, tmp_path / "run")
    report = load_estimates(run).model_copy(update={"method": "model"})
    (run / "results" / "estimates.json").write_text(report.model_dump_json(), encoding="utf-8")
    ended = list(replay(run))[-1]
    assert isinstance(ended, RunEnded)
    assert ended.estimates is not None
    assert ended.estimates.method == "model"


def test_several_runs_are_one_view_with_what_changed_in_it(example: Path, tmp_path: Path) -> None:
    found = comparison_view([example, copied(example, tmp_path / "again")])
    try:
        assert is_whole(found.file)
        assert {"/comparison/changes", "/comparison/runs"} <= set(entities(found.file))
    finally:
        found.remove()
    assert not found.file.exists()
