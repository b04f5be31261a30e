"""The journal: what is appended comes back in order, whatever the last instant tore off."""

from __future__ import annotations

import errno
import json
import os
import resource
import signal
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from orchestrator.runs import Journal
from protocols import Note, RecordingError, StateChanged, StorageError


def note(text: str) -> Note:
    return Note(level="info", text=text)


def texts(journal: Journal) -> list[str]:
    return [record.message.text for record in journal.read() if isinstance(record.message, Note)]


@pytest.fixture
def journal(tmp_path: Path) -> Journal:
    return Journal(tmp_path / "journal.jsonl")


def filled(journal: Journal, count: int) -> Journal:
    with journal:
        for k in range(count):
            journal.append(note(f"{k}"))
    return journal


def test_messages_come_back_numbered_and_dated(journal: Journal) -> None:
    with journal:
        journal.append(note("a\nb ünï"), durable=True)
        journal.append(StateChanged(source="idle", target="connecting"))
    first, second = journal.read()
    assert (first.n, second.n) == (0, 1)
    assert first.message == note("a\nb ünï")
    assert second.message == StateChanged(source="idle", target="connecting")
    assert datetime.fromisoformat(first.t).tzinfo is not None


def test_a_line_is_plain_json_with_three_keys(journal: Journal) -> None:
    filled(journal, 1)
    (line,) = journal.path.read_text().splitlines()
    assert list(json.loads(line)) == ["t", "n", "message"]


def test_a_journal_that_is_not_there_is_empty(journal: Journal) -> None:
    assert journal.read() == []


def test_it_can_be_read_while_it_is_written(journal: Journal) -> None:
    with journal:
        journal.append(note("a"))
        assert texts(Journal(journal.path)) == ["a"]


def test_appending_goes_on_where_it_stopped(journal: Journal) -> None:
    filled(journal, 2)
    with journal:
        journal.append(note("again"))
    assert [record.n for record in journal.read()] == [0, 1, 2]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.integers(0, 400))
def test_whatever_was_torn_off_the_end_is_dropped_and_the_rest_is_whole(tmp_path: Path, cut: int) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    journal.path.unlink(missing_ok=True)
    content = filled(journal, 4).path.read_bytes()
    kept = content[: max(0, len(content) - cut)]
    journal.path.write_bytes(kept)
    whole = kept.count(b"\n")
    assert texts(journal) == [str(k) for k in range(whole)]
    with journal:
        journal.append(note("resumed"))
    assert texts(journal) == [*(str(k) for k in range(whole)), "resumed"]
    assert [record.n for record in journal.read()] == list(range(whole + 1))


@pytest.mark.parametrize(
    ("damage", "problem"),
    [
        (lambda lines: [lines[0], lines[1][:20], lines[2]], "damaged in its middle"),
        (lambda lines: [lines[0], lines[2]], "expected record 1, got 2"),
        (lambda lines: [lines[0], lines[0], lines[1]], "expected record 1, got 0"),
        (lambda lines: [lines[0], "[]", lines[2]], "expected keys and values, got"),
        (lambda lines: [lines[0], lines[1].replace('"note"', '"nota"'), lines[2]], "note"),
        (lambda lines: [lines[0], "[" * 100_000, lines[2]], "damaged in its middle"),
    ],
    ids=["torn", "missing", "doubled", "no object", "unknown", "deep"],
)
def test_damage_in_the_middle_is_an_error_that_names_the_line(
    journal: Journal, damage: Callable[[list[str]], list[str]], problem: str
) -> None:
    lines = filled(journal, 3).path.read_text().splitlines()
    journal.path.write_text("".join(f"{line}\n" for line in damage(lines)))
    with pytest.raises(RecordingError, match=problem) as caught:
        journal.read()
    assert str(caught.value).startswith(f"{journal.path}:2: ")
    assert "\n" not in str(caught.value)


def test_only_an_open_journal_takes_messages(journal: Journal) -> None:
    with pytest.raises(ValueError, match="not open"):
        journal.append(note("a"))


def test_durable_means_synced(journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    with journal:
        monkeypatch.setattr(os, "fdatasync", synced.append)
        journal.append(note("a"))
        assert synced == []
        journal.append(note("b"), durable=True)
        assert len(synced) == 1


@pytest.fixture
def small_disk() -> Iterator[None]:
    old_limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    old_handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, old_limit[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, old_limit)
    signal.signal(signal.SIGXFSZ, old_handler)


@pytest.mark.usefixtures("small_disk")
def test_a_full_disk_is_a_storage_error_and_the_journal_ends_with_a_whole_line(journal: Journal) -> None:
    with journal:
        journal.append(note("fits"))
        with pytest.raises(StorageError, match="cannot be written"):
            journal.append(note("x" * 20_000))
        journal.append(note("fits again"))
    assert texts(journal) == ["fits", "fits again"]


def unable(*_: int) -> None:
    raise OSError(errno.EIO, os.strerror(errno.EIO))


def test_after_a_failed_sync_it_ends_with_what_was_synced_and_takes_nothing_more(
    journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    with journal:
        journal.append(note("synced"), durable=True)
        journal.append(note("in doubt"))
        with monkeypatch.context() as patch:
            patch.setattr(os, "fdatasync", unable)
            with pytest.raises(StorageError, match="cannot be written: Input/output error"):
                journal.append(note("not synced"), durable=True)
        with pytest.raises(StorageError, match="cannot be written: Input/output error"):
            journal.append(note("too late"), durable=True)
    assert texts(journal) == ["synced"]
    with journal:
        journal.append(note("again"), durable=True)
    assert texts(journal) == ["synced", "again"]


@pytest.mark.parametrize("failing", ["fdatasync", "write"])
def test_where_not_even_cutting_works_no_number_comes_twice(
    journal: Journal, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    with journal:
        journal.append(note("synced"), durable=True)
        with monkeypatch.context() as patch:
            patch.setattr(os, failing, unable)
            patch.setattr(os, "ftruncate", unable)
            with pytest.raises(StorageError):
                journal.append(note("in doubt"), durable=True)
        with pytest.raises(StorageError):
            journal.append(note("too late"))
    with journal:
        journal.append(note("again"), durable=True)
    assert texts(journal) == ["synced", *(["in doubt"] if failing == "fdatasync" else []), "again"]


def test_a_journal_that_cannot_be_synced_at_opening_leaves_no_file_open(
    journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    monkeypatch.setattr(os, "fsync", unable)
    with pytest.raises(StorageError), journal:
        pass
    assert len(list(Path("/proc/self/fd").iterdir())) == before
