"""Reading: correct files come back unchanged; errors name file and field."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from orchestrator.operating_system.memory import spare_memory
from orchestrator.recording import capture_path, open_recording
from protocols import Capture, RecordingError, RecordingReader, SegmentStage

REDUCED = Path(__file__).parents[2] / "data" / "pm400-reduced"
FIRST = "resistance-000"

Make = Callable[..., Path]


def edit_manifest(directory: Path, edit: Callable[[Any], None]) -> None:
    file = directory / "recording.json"
    raw = json.loads(file.read_text())
    edit(raw)
    file.write_text(json.dumps(raw))


def rewrite(directory: Path, edit: Callable[[pa.Table], pa.Table]) -> Path:
    path = capture_path(directory, FIRST)
    pq.write_table(edit(pq.read_table(path)), path)
    return path


def replace_column(name: str, values: Any) -> Callable[[pa.Table], pa.Table]:
    return lambda table: table.set_column(table.column_names.index(name), name, values)


def load_first(directory: Path) -> Capture:
    recording = open_recording(directory)
    return recording.load(next(s for s in recording.segments() if s.id == FIRST))


def complaint(call: Callable[[], object]) -> str:
    with pytest.raises(RecordingError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    return text


def expect_one_line(error: RecordingError) -> None:
    assert "\n" not in str(error)


def test_what_was_written_is_read(make_recording: Make, make_capture: Callable[..., Capture]) -> None:
    capture, expected = load_first(make_recording()), make_capture(start_s=1.0, seed=0)
    assert capture.start_s == 1.0
    assert capture.sampling_frequency_hz == 1e4
    for name in ("i_ab", "v_ab", "v_dc"):
        np.testing.assert_array_equal(getattr(capture, name), getattr(expected, name), strict=True)
    assert capture.i_abc is None
    assert capture.i_ab.flags.c_contiguous


@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_phase_currents_and_temperature_come_back_in_their_precision(make_recording: Make, dtype: str) -> None:
    capture = load_first(make_recording(phases=True, dtype=dtype))
    assert capture.i_abc is not None
    assert capture.temperature_c is not None
    assert capture.i_abc.shape == (100, 3)
    assert {a.dtype.str[1:] for a in (capture.i_abc, capture.temperature_c, capture.i_ab, capture.v_dc)} == {dtype}


def test_segments_come_in_order_of_time_and_by_stage(make_recording: Make) -> None:
    recording: RecordingReader = open_recording(make_recording(3))
    assert [s.start_s for s in recording.segments()] == [1.0, 2.0, 3.0]
    assert [s.id for s in recording.segments(SegmentStage.INJECTION)] == ["resistance-001"]
    assert recording.segments(SegmentStage.CLASSICAL) == ()


def test_settings_of_a_segment_are_passed_on(make_recording: Make) -> None:
    segment = open_recording(make_recording()).segments()[0]
    assert segment.settings == {"pwm_frequency_hz": 2e4, "anchor": True}
    assert segment.settings["anchor"] is True


def test_a_recording_of_another_tool_is_read_whole() -> None:
    recording = open_recording(REDUCED)
    assert recording.manifest.drive.name == "laboratory"
    stages = {s.stage for s in recording.segments()}
    others = {SegmentStage.ALIGNMENT, SegmentStage.LOCK_CHECK, SegmentStage.STEPS, SegmentStage.SPIN}
    assert stages == set(SegmentStage) - others
    for segment in recording.segments():
        assert len(recording.load(segment)) == segment.samples


def test_the_manifest_itself_may_be_named(make_recording: Make) -> None:
    directory = make_recording()
    assert open_recording(directory / "recording.json").path == directory


def test_foreign_keys_and_columns_are_passed_over(make_recording: Make) -> None:
    directory = make_recording(with_checksum=False)
    edit_manifest(directory, lambda raw: raw.update(laboratory={"room": 7}))
    edit_manifest(directory, lambda raw: raw["segments"][0].update(torque_nm=1.0))
    rewrite(directory, lambda table: table.append_column("torque", pa.array(["x"] * 100)))
    assert len(load_first(directory)) == 100


def test_single_and_double_precision_may_be_mixed(make_recording: Make) -> None:
    directory = make_recording(with_checksum=False)
    rewrite(directory, replace_column("i_alpha", pa.array(np.full(100, 0.1))))
    capture = load_first(directory)
    assert capture.i_ab.dtype == np.float64
    assert capture.v_ab.dtype == np.float32


def test_a_file_of_many_row_groups_is_one_capture(make_recording: Make) -> None:
    directory = make_recording(with_checksum=False)
    before = load_first(directory)
    path = capture_path(directory, FIRST)
    pq.write_table(pq.read_table(path), path, row_group_size=7)
    np.testing.assert_array_equal(load_first(directory).i_ab, before.i_ab)


@pytest.mark.parametrize(
    ("edit", "field", "problem"),
    [
        (lambda t: t.drop_columns(["i_beta"]), "i_beta", "column missing"),
        (lambda t: t.rename_columns(["v_alpha", "v_beta", "i_alpha", "i_q", "v_dc"]), "i_beta", "column missing"),
        (replace_column("v_dc", pa.array([540] * 100)), "v_dc", "int64"),
        (replace_column("v_dc", pa.array(["540"] * 100)), "v_dc", "string"),
        (replace_column("v_beta", pa.array([None] + [0.0] * 99, pa.float32())), "v_beta", "null"),
        (replace_column("i_alpha", pa.array([0.0] * 41 + [np.nan] * 59)), "i_alpha", "sample 41 is nan"),
        (replace_column("i_alpha", pa.array([np.inf] + [0.0] * 99)), "i_alpha", "sample 0 is inf"),
        (lambda t: t.slice(1), "rows", "99"),
        (lambda t: t.append_column("v_dc", t["v_dc"]), "v_dc", "two columns"),
    ],
    ids=["missing", "renamed", "integer", "text", "null", "nan", "inf", "rows", "doubled"],
)
def test_a_wrong_column_is_named(
    make_recording: Make, edit: Callable[[pa.Table], pa.Table], field: str, problem: str
) -> None:
    directory = make_recording(with_checksum=False)
    path = rewrite(directory, edit)
    text = complaint(lambda: load_first(directory))
    assert text.startswith(f"{path}: {field}: ")
    assert problem in text


def test_columns_and_rows_are_checked_before_anything_is_read(make_recording: Make) -> None:
    directory = make_recording(with_checksum=False)
    rewrite(directory, lambda t: t.drop_columns(["v_dc"]))
    assert "v_dc" in complaint(lambda: open_recording(directory))
    edit_manifest(directory, lambda raw: raw["segments"].pop())
    open_recording(directory)


def test_a_changed_file_does_not_fit_its_checksum(make_recording: Make) -> None:
    directory = make_recording()
    path = rewrite(directory, lambda t: t)
    assert complaint(lambda: load_first(directory)).startswith(f"{path}: sha256: ")


def test_a_missing_capture_is_named(make_recording: Make) -> None:
    directory = make_recording()
    path = capture_path(directory, FIRST)
    path.unlink()
    text = complaint(lambda: open_recording(directory))
    assert str(path) in text
    assert "missing" in text


def test_a_capture_that_goes_away_while_open_is_named(make_recording: Make) -> None:
    directory = make_recording()
    recording = open_recording(directory)
    capture_path(directory, FIRST).unlink()
    assert "cannot be read" in complaint(lambda: recording.load(recording.segments()[0]))


def test_a_disk_that_opens_no_capture_is_named_as_that(make_recording: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "Failed to open local file")

    directory = make_recording()
    monkeypatch.setattr(pq, "ParquetFile", full)
    assert "cannot be read: No space left on device" in complaint(lambda: open_recording(directory))


@pytest.mark.parametrize("kept", [0, 3, 100, -1, -9])
def test_a_truncated_capture_is_named(make_recording: Make, kept: int) -> None:
    directory = make_recording(with_checksum=False)
    path = capture_path(directory, FIRST)
    path.write_bytes(path.read_bytes()[:kept])
    text = complaint(lambda: load_first(directory))
    assert text.startswith(str(path))
    assert "Parquet" in text


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "broken JSON"),
        (b'{"format": "fluxbench-recording",', "broken JSON"),
        (b"\xff\xfe{}", "not UTF-8"),
        (b"[]", "expected a JSON object"),
        (b'{"a": NaN}', "NaN is not a number"),
        (b'{"a": 1e999}', "too large"),
        (b"[" * 100_000, "broken JSON"),
        (b"{}", "format: expected 'fluxbench-recording'"),
        (b'{"format": "fluxbench-recording", "version": 2}', "version: version 1 can be read, got 2"),
        (b'{"format": "fluxbench-recording", "version": 1}', "name: missing"),
    ],
)
def test_a_broken_manifest_is_named(tmp_path: Path, content: bytes, problem: str) -> None:
    (tmp_path / "recording.json").write_bytes(content)
    text = complaint(lambda: open_recording(tmp_path))
    assert text.startswith(str(tmp_path / "recording.json"))
    assert problem in text


@pytest.mark.parametrize(
    ("edit", "field"),
    [
        (lambda raw: raw["segments"][1].update(samples=-1), "segments.1.samples"),
        (lambda raw: raw["segments"][0].update(id="../../etc/passwd"), "segments.0.id"),
        (lambda raw: raw["segments"][0].update(stage="dancing"), "segments.0.stage"),
        (lambda raw: raw["drive"].pop("dc_bus_voltage_v"), "drive.dc_bus_voltage_v"),
        (lambda raw: raw["motor"].update(pole_pairs="two"), "motor.pole_pairs"),
        (lambda raw: raw["segments"][0].update(sha256="f00"), "segments.0.sha256"),
    ],
)
def test_a_wrong_field_of_the_manifest_is_named(make_recording: Make, edit: Callable[[Any], None], field: str) -> None:
    directory = make_recording()
    edit_manifest(directory, edit)
    assert f"recording.json: {field}: " in complaint(lambda: open_recording(directory))


def test_no_recording_at_all_is_stated_so(tmp_path: Path) -> None:
    assert "no such directory" in complaint(lambda: open_recording(tmp_path / "nowhere"))
    assert "neither a run nor a recording: it has no run.json and no recording.json" in complaint(
        lambda: open_recording(tmp_path)
    )


def test_a_run_that_was_cut_short_says_what_makes_its_manifest(make_recording: Make) -> None:
    directory = make_recording()
    manifest = (directory / "recording.json").read_bytes()
    (directory / "recording.json").unlink()
    for name in ("run.json", "journal.jsonl"):
        (directory / name).touch()
    text = complaint(lambda: open_recording(directory))
    assert "fluxbench resume" in text
    assert "fluxbench estimate" in text

    def make_manifest(run: Path) -> None:
        (run / "recording.json").write_bytes(manifest)

    assert len(open_recording(directory, make_manifest=make_manifest).segments()) == 2


fuzzing = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@fuzzing
@given(data=st.data())
def test_damaged_parquet_never_gives_anything_but_the_projects_error(make_recording: Make, data: st.DataObject) -> None:
    directory = make_recording(1, with_checksum=False)
    path = capture_path(directory, FIRST)
    content = bytearray(path.read_bytes())
    places = data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=8))
    for place in places:
        content[place] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(len(content) // 2, len(content)))])
    try:
        capture = load_first(directory)
    except RecordingError as error:
        expect_one_line(error)
    else:
        assert len(capture) == 100
        assert np.isfinite(capture.i_ab).all()


@fuzzing
@given(data=st.data())
def test_a_damaged_manifest_never_gives_anything_but_the_projects_error(
    make_recording: Make, data: st.DataObject
) -> None:
    directory = make_recording()
    file = directory / "recording.json"
    content = bytearray(file.read_bytes())
    for place in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=5)):
        content[place] = data.draw(st.integers(0, 255))
    file.write_bytes(content)
    try:
        recording = open_recording(directory)
        for segment in recording.segments():
            recording.load(segment)
    except RecordingError as error:
        expect_one_line(error)


@fuzzing
@given(
    value=st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
        max_leaves=5,
    ),
    key=st.sampled_from(["format", "version", "name", "created", "motor", "drive", "segments"]),
)
def test_any_value_for_any_field_gives_a_recording_or_the_projects_error(
    make_recording: Make, key: str, value: object
) -> None:
    directory = make_recording()
    edit_manifest(directory, lambda raw: raw.update({key: value}))
    try:
        open_recording(directory)
    except RecordingError as error:
        expect_one_line(error)


def test_more_rows_than_the_machine_holds_are_refused_before_any_is_read(
    make_recording: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = make_recording()
    assert (spare_memory() or 0) > 1e6
    monkeypatch.setattr("orchestrator.validation.memory.spare_memory", lambda: 5000)
    monkeypatch.setattr(pq.ParquetFile, "read", lambda *_: pytest.fail("it was read"))
    message = complaint(lambda: open_recording(directory))
    assert "100 rows need some 0.0 GB of memory, and 0.0 GB are free" in message


@pytest.mark.parametrize("value", [True, False, "1.0"])
@pytest.mark.parametrize(
    ("field", "kind"), [("start_s", "number"), ("samples", "whole number"), ("rotor_angle_rad", "number")]
)
def test_a_number_is_neither_a_boolean_nor_text(make_recording: Make, field: str, kind: str, value: object) -> None:
    directory = make_recording()
    edit_manifest(directory, lambda raw: raw["segments"][0].update({field: value}))
    message = complaint(lambda: open_recording(directory))
    assert f"segments.0.{field}: expected a {kind}" in message
    assert message.endswith(f"got {value!r}")


def test_an_id_that_no_file_system_takes_is_refused(make_recording: Make) -> None:
    directory = make_recording()
    edit_manifest(directory, lambda raw: raw["segments"][0].update(id="a" * 5000))
    assert "segments.0.id: string should have at most 200 characters" in complaint(lambda: open_recording(directory))
