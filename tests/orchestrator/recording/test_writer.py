"""Writing: whole and durable under its name, or not there at all."""

from __future__ import annotations

import gc
import json
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from orchestrator.recording import (
    SegmentWriter,
    WrittenSegment,
    capture_path,
    open_recording,
    remove_partial_files,
    replace_file,
    write_manifest,
)
from protocols import Capture, DriveFault, FaultCause, RealArray, StorageError

Make = Callable[..., Capture]


def files_in(directory: Path) -> list[str]:
    return sorted(path.name for path in directory.rglob("*") if path.is_file())


def changed(capture: Capture, **fields: object) -> Capture:
    return Capture(**{**{name: getattr(capture, name) for name in Capture.model_fields}, **fields})


def write(directory: Path, segment_id: str, *blocks: Capture) -> WrittenSegment:
    with SegmentWriter(directory, segment_id) as writer:
        for block in blocks:
            writer.append(block)
        return writer.finish()


@pytest.fixture
def small_disk() -> Iterator[None]:
    """No file may grow past 100 kB: the operating system refuses like a full disk."""
    import resource

    old_limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    old_handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, old_limit[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, old_limit)
    signal.signal(signal.SIGXFSZ, old_handler)


def test_blocks_become_one_file_with_its_checksum(
    tmp_path: Path, make_capture: Make, sha256_of: Callable[[Path, str], str]
) -> None:
    blocks = [make_capture(start_s=2.0 + k * 0.01, seed=k) for k in range(3)]
    with SegmentWriter(tmp_path, "injection-000") as writer:
        for block in blocks:
            writer.append(block)
        assert writer.samples == 300
        written = writer.finish()
    assert (written.start_s, written.samples) == (2.0, 300)
    assert written.sha256 == sha256_of(tmp_path, "injection-000")
    table = pq.read_table(capture_path(tmp_path, "injection-000"))
    assert table.column_names == ["v_alpha", "v_beta", "i_alpha", "i_beta", "v_dc"]
    np.testing.assert_array_equal(table["i_beta"].to_numpy(), np.concatenate([b.i_ab[:, 1] for b in blocks]))


def test_more_rows_than_a_row_group_are_streamed(tmp_path: Path, make_capture: Make) -> None:
    blocks = [make_capture(start_s=k * 5.0, n=50_000, seed=k) for k in range(3)]
    with SegmentWriter(tmp_path, "a") as writer:
        for block in blocks:
            writer.append(block)
        writer.finish()
    file = pq.ParquetFile(capture_path(tmp_path, "a"))
    assert file.metadata.num_rows == 150_000
    assert file.metadata.num_row_groups == 3
    assert file.metadata.row_group(0).column(0).compression == "ZSTD"
    np.testing.assert_array_equal(
        file.read()["v_alpha"].to_numpy(), np.concatenate([block.v_ab[:, 0] for block in blocks])
    )


def test_a_buffer_that_the_drive_uses_again_does_no_harm(tmp_path: Path, make_capture: Make) -> None:
    block = make_capture()
    expected = block.i_ab[:, 0].copy()
    with SegmentWriter(tmp_path, "a") as writer:
        writer.append(block)
        block.i_ab[:] = 0.0
        writer.finish()
    np.testing.assert_array_equal(pq.read_table(capture_path(tmp_path, "a"))["i_alpha"].to_numpy(), expected)


def test_nothing_has_its_name_before_it_is_finished(tmp_path: Path, make_capture: Make) -> None:
    with SegmentWriter(tmp_path, "a") as writer:
        writer.append(make_capture())
        assert not capture_path(tmp_path, "a").exists()
        writer.finish()
        assert files_in(tmp_path) == ["a.parquet"]


def test_an_exception_leaves_nothing_behind(tmp_path: Path, make_capture: Make) -> None:
    def interrupted() -> None:
        with SegmentWriter(tmp_path, "a") as writer:
            writer.append(make_capture(n=70_000))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        interrupted()
    gc.collect()
    assert files_in(tmp_path) == []


def test_leaving_without_finish_leaves_nothing_behind(tmp_path: Path, make_capture: Make) -> None:
    with SegmentWriter(tmp_path, "a") as writer:
        writer.append(make_capture())
    assert files_in(tmp_path) == []


def test_an_abandoned_point_keeps_the_file_from_before(tmp_path: Path, make_capture: Make) -> None:
    write(tmp_path, "a", make_capture())
    before = capture_path(tmp_path, "a").read_bytes()
    with SegmentWriter(tmp_path, "a") as writer:
        writer.append(make_capture(seed=1))
    assert capture_path(tmp_path, "a").read_bytes() == before
    write(tmp_path, "a", make_capture(seed=1))
    assert capture_path(tmp_path, "a").read_bytes() != before


def test_what_a_killed_process_left_is_removed(tmp_path: Path, make_capture: Make) -> None:
    writer = SegmentWriter(tmp_path, "a").__enter__()
    writer.append(make_capture(n=70_000))
    (left,) = files_in(tmp_path)
    assert left.startswith(".")
    remove_partial_files(tmp_path / "captures")
    assert files_in(tmp_path) == []
    writer.__exit__(None, None, None)


def spoilt(array: RealArray, row: int) -> RealArray:
    copy = array.copy()
    copy[row] = np.nan
    return copy


@pytest.mark.parametrize(
    ("spoil", "problem"),
    [
        (lambda c: changed(c, i_ab=spoilt(c.i_ab, 3)), "i_alpha is nan at sample 103"),
        (lambda c: changed(c, v_dc=spoilt(c.v_dc, 99)), "v_dc is nan at sample 199"),
        (lambda c: changed(c, start_s=c.start_s + 0.6e-4), "starts at"),
        (lambda c: changed(c, start_s=c.start_s - 1e-4), "starts at"),
        (lambda c: changed(c, start_s=float("nan")), "starts at"),
        (lambda c: changed(c, sampling_frequency_hz=2e4), "sampling frequency changes"),
        (lambda c: changed(c, temperature_c=c.v_dc), "columns change"),
    ],
    ids=["nan current", "nan bus", "gap", "overlap", "no time", "rate", "columns"],
)
def test_wrong_data_is_the_drives_fault(
    tmp_path: Path, make_capture: Make, spoil: Callable[[Capture], Capture], problem: str
) -> None:
    with pytest.raises(DriveFault, match=problem) as caught:
        write(tmp_path, "injection-007", make_capture(), spoil(make_capture(start_s=0.01)))
    assert caught.value.cause is FaultCause.WRONG_DATA
    assert "injection-007" in str(caught.value)
    assert files_in(tmp_path) == []


def test_time_may_be_off_by_less_than_half_a_sample(tmp_path: Path, make_capture: Make) -> None:
    assert write(tmp_path, "a", make_capture(), make_capture(start_s=0.01 + 0.4e-4)).samples == 200


@pytest.mark.parametrize(("start_s", "rate"), [(np.inf, 1e4), (0.0, 0.0), (0.0, np.nan), (0.0, -1.0)])
def test_a_first_block_without_a_time_base_is_the_drives_fault(
    tmp_path: Path, make_capture: Make, start_s: float, rate: float
) -> None:
    with pytest.raises(DriveFault, match="starts at"):
        write(tmp_path, "a", changed(make_capture(), start_s=start_s, sampling_frequency_hz=rate))


def test_a_segment_without_samples_is_the_drives_fault(tmp_path: Path, make_capture: Make) -> None:
    with pytest.raises(DriveFault, match="no sample"):
        write(tmp_path, "a", make_capture(n=0))
    with pytest.raises(DriveFault, match="no sample"):
        write(tmp_path, "b")


@pytest.mark.posix
@pytest.mark.usefixtures("small_disk")
def test_a_full_disk_is_a_storage_error_and_leaves_nothing(tmp_path: Path, make_capture: Make) -> None:
    with pytest.raises(StorageError, match="cannot be written") as caught:
        write(tmp_path, "a", make_capture(n=70_000))
    gc.collect()
    assert str(capture_path(tmp_path, "a")) in str(caught.value)
    assert files_in(tmp_path) == []


@pytest.mark.posix
@pytest.mark.usefixtures("small_disk")
def test_a_full_disk_does_not_harm_the_file_from_before(tmp_path: Path) -> None:
    replace_file(tmp_path / "x", b"old")
    with pytest.raises(StorageError, match="cannot be written"):
        replace_file(tmp_path / "x", b"n" * 200_000)
    assert (tmp_path / "x").read_bytes() == b"old"
    assert files_in(tmp_path) == ["x"]


def test_a_folder_that_is_gone_is_a_storage_error(tmp_path: Path, make_capture: Make) -> None:
    (tmp_path / "captures").touch()
    with pytest.raises(StorageError, match="cannot be written"):
        write(tmp_path, "a", make_capture())
    with pytest.raises(StorageError, match="cannot be written"):
        replace_file(tmp_path / "nowhere" / "x", b"")


@pytest.mark.posix
def test_a_segment_is_synced_before_it_gets_its_name(
    tmp_path: Path, make_capture: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def watched_fsync(descriptor: int) -> None:
        order.append("fsync")
        fsync(descriptor)

    def watched_replace(self: Path, target: Path) -> Path:
        order.append("rename")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", watched_fsync)
    monkeypatch.setattr(Path, "replace", watched_replace)
    write(tmp_path, "a", make_capture())
    assert order == ["fsync", "rename", "fsync"]


def test_the_manifest_comes_back_and_is_plain_json(make_recording: Callable[..., Path]) -> None:
    directory = make_recording()
    manifest = open_recording(directory).manifest
    write_manifest(directory, manifest)
    assert open_recording(directory).manifest == manifest
    assert json.loads((directory / "recording.json").read_text())["format"] == "fluxbench-recording"


def test_several_may_replace_one_file_at_once(tmp_path: Path) -> None:
    file, contents = tmp_path / "x", [bytes([97 + k]) * 50_000 for k in range(4)]

    def replace(content: bytes) -> None:
        for _ in range(25):
            replace_file(file, content)
            assert file.read_bytes() in contents

    with ThreadPoolExecutor(len(contents)) as executor:
        list(executor.map(replace, contents))
    assert list(tmp_path.iterdir()) == [file]
