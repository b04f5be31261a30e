"""Files that are read whole: plain ones, and no larger than such files are."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from orchestrator.validation.plain_files import read_bytes, read_text
from tests.support.processes import called


def test_a_plain_file_is_read_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes("Ω\r\n".encode())
    assert (read_bytes(path), read_text(path)) == (b"\xce\xa9\r\n", "Ω\r\n")


def test_a_pipe_a_device_and_a_folder_are_no_files_and_nothing_is_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    for path in (tmp_path / "pipe", tmp_path / "zero"):
        with pytest.raises(OSError, match="is not a plain file"):
            read_bytes(path)
    with pytest.raises(OSError, match="is a directory"):
        read_bytes(tmp_path)


def test_a_file_larger_than_such_files_are_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "holes"
    path.touch()
    os.truncate(path, 3_000_000_000_000)
    with pytest.raises(OSError, match="3000000 MB are too large for such a file"):
        read_bytes(path)


def test_no_descriptor_is_left_open(tmp_path: Path) -> None:
    def opened() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    before = opened()
    for path in (tmp_path, tmp_path / "missing"):
        with pytest.raises(OSError, match="directory"):
            read_bytes(path)
    assert opened() == before


@pytest.mark.parametrize(
    "words",
    [
        ("check", "{}"),
        ("check", "demo", "--motor", "{}"),
        ("import", "{}", "log.csv", "--out", "made"),
        ("campaign", "{}", "--out", "table"),
        ("compare", "{}/recording", "--model", "{}.json"),
        ("estimate", "{}/recording"),
    ],
    ids=lambda words: "-".join(word for word in words if word.isalpha()),
)
@pytest.mark.parametrize("kind", ["pipe", "zero"])
def test_what_is_no_plain_file_is_refused_in_one_line(tmp_path: Path, words: tuple[str, ...], kind: str) -> None:
    def put(path: Path) -> None:
        os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")

    name = "here/recording" if words[0] in ("compare", "estimate") else "here"
    (tmp_path / name).parent.mkdir(exist_ok=True)
    if name == "here":
        put(tmp_path / "here")
    else:
        (tmp_path / name).mkdir()
        put(tmp_path / name / "recording.json")
    done = called(*(word.replace("{}", str(tmp_path / "here")) for word in words), cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "not a plain file" in done.stderr
