"""Run directories: made once, locked, resumable, and a recording at any time."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from orchestrator.recording import capture_path, open_recording
from orchestrator.runs import RunDirectory, private_directory, without_private
from protocols import Capabilities, Note, PointDone, Procedure, RecordingError, StorageError

Measure = Callable[..., PointDone]


def test_a_new_run_has_its_record_and_no_secret(run: RunDirectory, procedure: Procedure) -> None:
    text = (run.path / "run.json").read_text()
    raw = json.loads(text)
    assert raw["format"] == "fluxbench-run"
    assert raw["seed"] == 7
    assert "4.321" not in text
    assert set(raw["procedure"]["drive"]["plant"]) == {"sha256"}
    assert raw["procedure"]["drive"]["max_current_a"] == procedure.drive.options["max_current_a"]
    assert raw["capabilities"]["pwm_frequencies_hz"] == [8000.0, 16000.0]


def test_the_secret_is_beside_the_run_and_only_its_owner_reads_it(run: RunDirectory) -> None:
    assert run.private_directory == private_directory(run.path)
    assert run.private_directory.parent == run.path.parent
    assert run.private_directory.name == "r1.sealed"
    assert run.private_directory.stat().st_mode & 0o077 == 0
    assert "4.321" in (run.private_directory / "options.json").read_text()


def test_an_opened_run_knows_its_procedure_again(run: RunDirectory, procedure: Procedure) -> None:
    again = RunDirectory.open(run.path)
    assert again.record == run.record
    assert again.procedure() == procedure
    assert again.record.procedure != procedure


def test_a_run_says_where_it_comes_from(run: RunDirectory) -> None:
    provenance = run.record.provenance
    screened = {plugin.name for plugin in provenance.plugins if plugin.kind == "effects"}
    others = {plugin.name for plugin in provenance.plugins} - screened
    assert others == {"simulated", "gates_off", "estimate", "classical"}
    assert {"dead_time", "winding_heating"} <= screened
    assert {"numpy", "pydantic", "pyarrow"} <= set(provenance.packages)


def test_a_changed_secret_is_noticed(run: RunDirectory) -> None:
    file = run.private_directory / "options.json"
    file.write_text(file.read_text().replace("4.321", "4.322"))
    with pytest.raises(RecordingError, match="hash differs") as caught:
        RunDirectory.open(run.path).procedure()
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("content", [None, "", "[]", '{"plant": 1'])
def test_a_lost_or_broken_secret_is_one_line(run: RunDirectory, content: str | None) -> None:
    file = run.private_directory / "options.json"
    file.unlink()
    if content is not None:
        file.write_text(content)
    with pytest.raises(RecordingError) as caught:
        RunDirectory.open(run.path).procedure()
    assert str(file) in str(caught.value)


def test_a_procedure_without_secrets_needs_no_private_file(
    tmp_path: Path, procedure: Procedure, capabilities: Capabilities
) -> None:
    run = RunDirectory.create(tmp_path / "open", procedure, capabilities)
    (run.private_directory / "options.json").unlink()
    assert RunDirectory.open(run.path).procedure() == procedure


def test_nothing_is_overwritten(
    tmp_path: Path, run: RunDirectory, procedure: Procedure, capabilities: Capabilities
) -> None:
    with pytest.raises(RecordingError, match="not empty"):
        RunDirectory.create(run.path, procedure, capabilities)
    with pytest.raises(RecordingError, match="not empty"):
        RunDirectory.refuse_occupied(run.path)
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="not empty"):
        RunDirectory.refuse_occupied(tmp_path / "file")


def test_what_a_deleted_run_has_left_beside_it_is_set_aside_and_does_not_block_its_name(
    tmp_path: Path, procedure: Procedure, capabilities: Capabilities
) -> None:
    for number in ("", ".1"):
        (tmp_path / f"other.sealed{number}").mkdir()
        (tmp_path / f"other.sealed{number}" / "options.json").write_text(f"{number}")
    RunDirectory.refuse_occupied(tmp_path / "other")
    run = RunDirectory.create(tmp_path / "other", procedure, capabilities, sealed=["plant"])
    assert run.procedure() == procedure
    assert (tmp_path / "other.sealed.1" / "options.json").read_text() == ".1"
    assert (tmp_path / "other.sealed.2" / "options.json").read_text() == ""


def test_an_empty_directory_may_be_used_and_the_drive_may_have_been_there_first(
    tmp_path: Path, procedure: Procedure, capabilities: Capabilities
) -> None:
    (tmp_path / "empty").mkdir()
    RunDirectory.refuse_occupied(tmp_path / "empty")
    (tmp_path / "empty.sealed").mkdir()
    (tmp_path / "empty.sealed" / "truth.json").touch()
    run = RunDirectory.create(tmp_path / "empty", procedure, capabilities, sealed=["plant"])
    assert run.procedure() == procedure
    assert run.private_directory.stat().st_mode & 0o077 == 0


def test_a_place_that_cannot_be_made_is_a_storage_error(
    tmp_path: Path, procedure: Procedure, capabilities: Capabilities
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="cannot be created"):
        RunDirectory.create(tmp_path / "file" / "run", procedure, capabilities)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "broken JSON"),
        (b"{", "broken JSON"),
        (b"\xff", "broken JSON"),
        (b"[]", "expected keys and values"),
        (b"{}", "missing"),
    ],
)
def test_a_broken_record_is_one_line(run: RunDirectory, content: bytes, problem: str) -> None:
    (run.path / "run.json").write_bytes(content)
    with pytest.raises(RecordingError, match=problem) as caught:
        RunDirectory.open(run.path)
    assert str(caught.value).startswith(str(run.path / "run.json"))
    assert "\n" not in str(caught.value)


def test_another_directory_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="neither a run nor a recording"):
        RunDirectory.open(tmp_path)


def test_what_the_journal_calls_done_is_the_recording(run: RunDirectory, measure: Measure) -> None:
    with run.lock():
        for k, start_s in enumerate((0.0, 2.5)):
            run.journal.append(measure(run, f"resistance-{k:03d}", start_s), durable=True)
        measure(run, "resistance-002", 4.0)  # killed before its line was written
        run.write_manifest()
    recording = open_recording(run.path)
    assert [s.id for s in recording.segments()] == ["resistance-000", "resistance-001"]
    assert len(recording.load(recording.segments()[1])) == 50
    assert recording.manifest.name == "secretive"
    assert recording.manifest.drive.pwm_frequency_hz == 8e3
    assert recording.manifest.drive.voltage_delay_samples == 1.0
    assert run.end_s() == pytest.approx(2.505)
    assert list(run.completed()) == ["resistance-000", "resistance-001"]


def test_a_point_measured_again_is_there_once_with_its_last_capture(run: RunDirectory, measure: Measure) -> None:
    with run.lock():
        run.journal.append(measure(run, "resistance-000", 0.0, n=10))
        run.journal.append(measure(run, "resistance-000", 1.0, n=20))
    assert [(s.start_s, s.samples) for s in run.write_manifest().segments] == [(1.0, 20)]


def test_a_capture_that_went_away_is_named(run: RunDirectory, measure: Measure) -> None:
    with run.lock():
        run.journal.append(measure(run, "resistance-000", 0.0))
    capture_path(run.path, "resistance-000").unlink()
    with pytest.raises(RecordingError, match="records it as done"):
        run.write_manifest()


def test_a_run_without_points_stands_at_zero(run: RunDirectory) -> None:
    assert run.completed() == {}
    assert run.end_s() == 0.0
    assert run.write_manifest().segments == ()


def test_a_run_that_was_cut_short_opens_once_its_manifest_is_made(run: RunDirectory, measure: Measure) -> None:
    with run.lock():
        run.journal.append(measure(run, "resistance-000", 0.0))
    with pytest.raises(RecordingError, match="fluxbench resume"):
        open_recording(run.path)
    recording = open_recording(run.path, make_manifest=lambda path: RunDirectory.open(path).write_manifest())
    assert len(recording.segments()) == 1


def test_the_lock_opens_the_journal_and_closes_it(run: RunDirectory) -> None:
    message = Note(level="info", text="x")
    with run.lock():
        run.journal.append(message)
    with pytest.raises(ValueError, match="not open"):
        run.journal.append(message)


def test_a_second_process_is_refused_and_reported_by_whom(run: RunDirectory) -> None:
    code = (
        "import sys; from pathlib import Path; from orchestrator.runs import RunDirectory\n"
        "run = RunDirectory.open(Path(sys.argv[1]))\n"
        "with run.lock():\n    print('locked', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(run.path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "locked\n"
        with pytest.raises(RecordingError, match=f"pid {other.pid}"), run.lock():
            pass
        other.kill()
    with run.lock():  # a killed process holds nothing
        pass


def test_taking_the_lock_clears_up_what_a_killed_process_left(run: RunDirectory) -> None:
    left = run.path / "captures" / ".injection-000.parquet.partial"
    left.touch()
    with run.lock():
        assert not left.exists()


def test_a_run_that_is_gone_cannot_be_locked(run: RunDirectory, tmp_path: Path) -> None:
    run.path.rename(tmp_path / "elsewhere")
    with pytest.raises(StorageError, match="cannot be opened"), run.lock():
        pass


def test_a_refused_folder_is_left_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "to-aunt.txt").write_text("dear")
    with pytest.raises(RecordingError, match="not empty"), RunDirectory.claim(tmp_path / "letters"):
        pytest.fail("it was claimed")
    assert [file.name for file in (tmp_path / "letters").iterdir()] == ["to-aunt.txt"]


def test_of_several_paths_those_that_are_private_are_left_out_and_a_run_of_such_a_name_is_not(tmp_path: Path) -> None:
    names = ("a", "a.sealed", "b.sealed.2", "c.sealed")
    paths = [tmp_path / name for name in names]
    for path in paths:
        path.mkdir()
    (tmp_path / "c.sealed" / "run.json").touch()
    assert without_private(paths) == [tmp_path / "a", tmp_path / "c.sealed"]
    assert without_private(paths[1:3]) == [tmp_path / "a.sealed"]  # something is left to be refused by name
