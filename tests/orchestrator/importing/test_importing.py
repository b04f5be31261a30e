"""An import is whole or not there, splits by its mapping, and says what it left out."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from orchestrator.importing import import_files
from orchestrator.recording import open_recording
from protocols import FluxbenchError, InputError, StorageError
from tests.orchestrator.importing.benches import DRIVE, MOTOR, RATE, Bench, held_current, left_in, phase_log
from tests.support.close import assert_close


def test_a_held_current_becomes_one_segment_with_what_the_mapping_says(bench: Bench) -> None:
    report = bench.run()
    recording = open_recording(Path(report.recording))
    (segment,) = recording.segments()
    assert (segment.id, segment.stage, segment.samples) == ("resistance-000", "resistance", 400)
    assert segment.settings == {"current_d_a": 2.0}
    assert recording.manifest.motor.name == MOTOR["name"]
    assert recording.manifest.drive.name == DRIVE["name"]
    assert recording.manifest.drive.sampling_frequency_hz == RATE
    assert (report.segments, report.samples, report.notes) == (1, 400, ())
    np.testing.assert_array_equal(recording.load(segment).v_dc, 540.0)


def test_checksums_of_the_manifest_are_of_the_files(bench: Bench) -> None:
    bench.run()
    assert all(segment.sha256 for segment in open_recording(bench.folder / "recording").manifest.segments)
    assert len(bench.captures()) == 1


def test_all_three_phase_currents_are_kept(bench: Bench) -> None:
    bench.run()
    (capture,) = bench.captures()
    assert capture.i_abc is not None
    np.testing.assert_array_equal(capture.i_abc[:, 0], bench.columns["ia"].astype("f4"))


def test_two_phase_currents_are_enough(bench: Bench) -> None:
    bench.run("three")
    bench.mapping["current"]["columns"] = {"c": "ic", "a": "ia"}
    bench.run("two")
    (three,), (two,) = bench.captures("three"), bench.captures("two")
    assert_close(two.i_ab, three.i_ab, 2.0**-22)
    assert two.i_abc is None


def test_each_file_is_a_segment_placed_after_the_one_before(bench: Bench) -> None:
    bench.files = {"first.csv": bench.columns, "second.parquet": bench.columns}
    report = bench.run()
    first, second = open_recording(bench.folder / "recording").segments()
    assert first.start_s == 0.0
    assert second.start_s == pytest.approx(400 / RATE)
    assert any("time starts anew" in note and "second.parquet" in note for note in report.notes)


def test_a_start_given_in_the_mapping_goes_before_the_time_stamps(bench: Bench) -> None:
    bench.files = {"first.csv": bench.columns, "second.csv": bench.columns}
    bench.mapping["segments"] = [
        {"file": "first*", "stage": "resistance"},
        {"file": "second*", "stage": "classical", "start_s": 12.5, "id": "sweep"},
    ]
    report = bench.run()
    _, second = open_recording(bench.folder / "recording").segments()
    assert (second.id, second.start_s) == ("sweep", 12.5)
    assert report.notes == ()


def test_files_with_one_clock_keep_their_times_in_any_order(bench: Bench) -> None:
    later = bench.columns | {"t": bench.columns["t"] + 3.0}
    bench.files = {"b.csv": later, "a.csv": bench.columns}
    report = bench.run()
    assert [s.start_s for s in open_recording(bench.folder / "recording").segments()] == [0.0, 3.0]
    assert report.notes == ()


def test_a_column_of_labels_splits_and_what_fits_no_rule_is_stated(bench: Bench) -> None:
    bench.columns["what"] = np.repeat(["R1", "idle", "R2", "R1"], 100)
    bench.mapping |= {"segment_column": "what", "segments": [{"label": "R*", "stage": "resistance"}]}
    report = bench.run()
    segments = open_recording(bench.folder / "recording").segments()
    assert [(s.id, s.samples, round(s.start_s, 6)) for s in segments] == [
        ("resistance-000", 100, 0.0),
        ("resistance-001", 100, 0.02),
        ("resistance-002", 100, 0.03),
    ]
    assert report.notes == (
        "100 rows fit no entry of segments and were left out (first: log.csv, row 101, label 'idle')",
    )


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_segment_numbers_are_labels_too(bench: Bench, ending: str) -> None:
    bench.columns["k"] = np.repeat([1, 2], 200)
    rules = [{"label": 2, "stage": "classical"}, {"label": "1", "stage": "resistance", "id": "dc"}]
    bench.mapping |= {"segment_column": "k", "segments": rules}
    bench.files = {f"log.{ending}": bench.columns}
    bench.run()
    assert [s.id for s in open_recording(bench.folder / "recording").segments()] == ["dc", "classical-000"]


def test_ranges_of_time_split_and_end_before_their_end(bench: Bench) -> None:
    bench.mapping["segments"] = [
        {"from_s": 0.01, "to_s": 0.02, "stage": "resistance", "id": "x"},
        {"from_s": 0.03, "stage": "classical", "id": "x"},
    ]
    report = bench.run()
    first, second = open_recording(bench.folder / "recording").segments()
    assert [(s.id, s.samples) for s in (first, second)] == [("x", 100), ("x.2", 100)]
    assert first.start_s == pytest.approx(0.01)
    assert "200 rows fit no entry" in report.notes[0]


def test_a_sampling_frequency_goes_instead_of_time_stamps(bench: Bench) -> None:
    del bench.mapping["time"], bench.columns["t"]
    bench.mapping |= {"sampling_frequency_hz": 8000.0, "segments": [{"from_s": 0.0125, "stage": "resistance"}]}
    report = bench.run()
    (segment,) = open_recording(bench.folder / "recording").segments()
    assert (report.sampling_frequency_hz, segment.samples, segment.start_s) == (8000.0, 300, 0.0125)


def test_segments_go_on_over_the_blocks_of_a_file(bench: Bench) -> None:
    n = 150_000
    bench.columns, _ = phase_log(*held_current(n))
    bench.columns["k"] = np.repeat([1, 2], [100_000, 50_000])
    rules = [{"label": 1, "stage": "resistance"}, {"label": 2, "stage": "classical"}]
    bench.mapping |= {"segment_column": "k", "segments": rules}
    for name in ("log.csv", "log.parquet"):
        bench.files = {name: bench.columns}
        bench.run(f"from {name}")
        first, second = bench.captures(f"from {name}")
        assert (len(first), len(second)) == (100_000, 50_000)
        assert first.i_abc is not None
        np.testing.assert_array_equal(first.i_abc[:, 1], bench.columns["ib"][:100_000].astype("f4"))


def test_the_nameplate_may_be_in_a_file_of_its_own(bench: Bench) -> None:
    (bench.folder / "plate.yaml").write_text("motor: {name: another, pole_pairs: 3}\nlimits: {current_a: 3.0}\n")
    bench.mapping["motor"] = "plate.yaml"
    bench.run()
    assert open_recording(bench.folder / "recording").manifest.motor.name == "another"


def test_the_angle_of_a_segment_goes_into_the_manifest_in_radians(bench: Bench) -> None:
    bench.mapping["segments"][0]["rotor_angle"] = {"value": 90.0, "unit": "deg"}
    bench.run()
    (segment,) = open_recording(bench.folder / "recording").segments()
    assert segment.rotor_angle_rad == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("unit", "reading", "message"),
    [("K", 20.0, "20 K is -253 degC; degC would fit"), ("degC", 293.0, "293 degC is no winding's .*; K would fit")],
)
def test_a_temperature_in_the_wrong_unit_is_refused(bench: Bench, unit: str, reading: float, message: str) -> None:
    bench.columns["Tw"] = np.full(len(bench.columns["t"]), reading)
    bench.mapping |= {"temperature": {"column": "Tw", "unit": unit}}
    with pytest.raises(InputError, match=f"Tw: {message}"):
        bench.run()


def test_a_bus_and_a_temperature_are_taken_over(bench: Bench) -> None:
    bench.columns |= {"udc": np.full(400, 0.55), "kelvin": np.full(400, 300.0)}
    bench.mapping |= {"bus": {"column": "udc", "unit": "kV"}, "temperature": {"column": "kelvin", "unit": "K"}}
    bench.run()
    (capture,) = bench.captures()
    np.testing.assert_allclose(capture.v_dc, 550.0, rtol=1e-6)
    assert capture.temperature_c is not None
    np.testing.assert_allclose(capture.temperature_c, 26.85, rtol=1e-5)


def test_an_error_in_the_second_file_leaves_nothing_behind(bench: Bench) -> None:
    bench.files = {"good.csv": bench.columns, "bad.csv": bench.columns | {"t": bench.columns["t"][::-1]}}
    with pytest.raises(InputError, match=r"bad\.csv: t: time does not increase"):
        bench.run()
    assert left_in(bench.folder) == ["bad.csv", "good.csv"]


def test_an_occupied_directory_is_refused_and_an_empty_one_taken(bench: Bench) -> None:
    out = bench.folder / "recording"
    out.mkdir()
    bench.run()
    with pytest.raises(InputError, match="exists already and is not an empty directory"):
        bench.run()
    assert len(bench.captures()) == 1


def test_a_place_that_cannot_be_written_is_stated(bench: Bench) -> None:
    (bench.folder / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        bench.run("file/recording")


def test_an_interrupted_import_leaves_nothing_behind(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("orchestrator.importing._importing.write_manifest", interrupted)
    with pytest.raises(KeyboardInterrupt):
        bench.run()
    assert left_in(bench.folder) == []


def test_a_rule_that_fits_nothing_is_an_error(bench: Bench) -> None:
    bench.mapping["segments"].append({"stage": "classical", "file": "sweep*"})
    with pytest.raises(InputError, match=r"segments\.1: no row fits it \(file 'sweep\*'\)"):
        bench.run()


def test_a_file_without_a_segment_is_an_error(bench: Bench) -> None:
    bench.mapping["segments"][0] |= {"from_s": 100.0}
    with pytest.raises(InputError, match=r"log\.csv: no segment in it; 400 rows fit no entry of segments"):
        bench.run()


def test_segments_that_overlap_are_an_error(bench: Bench) -> None:
    bench.files = {"a.csv": bench.columns, "b.csv": bench.columns}
    bench.mapping["segments"] = [
        {"file": "a*", "stage": "resistance"},
        {"file": "b*", "stage": "resistance", "start_s": 0.02},
    ]
    with pytest.raises(InputError, match=r"b\.csv: segments\.1: row 1 .* lies within an earlier segment"):
        bench.run()


@pytest.mark.parametrize("names", [[], ["missing.csv"], ["log.csv", "log.csv"], ["log.xyz"], ["."], ["\0"]])
def test_files_that_cannot_be_taken_are_stated(bench: Bench, names: list[str]) -> None:
    for name in ("log.csv", "log.xyz"):
        (bench.folder / name).write_text("t,ia\n0,1\n")
    with pytest.raises(InputError):
        import_files(bench.write_mapping(), [bench.folder / name for name in names], bench.folder / "out")
    assert not (bench.folder / "out").exists()


def test_a_long_segment_is_one_though_it_is_computed_in_parts(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.run("whole")
    monkeypatch.setattr("orchestrator.importing._timing._PART_ROWS", 150)
    bench.run("parts")
    (whole,), (parts,) = bench.captures("whole"), bench.captures("parts")
    np.testing.assert_array_equal(parts.i_ab, whole.i_ab)
    np.testing.assert_array_equal(parts.v_ab, whole.v_ab)


def test_a_segment_larger_than_the_memory_is_refused_while_it_is_read(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.validation.memory.spare_memory", lambda: 10_000)
    with pytest.raises(InputError, match="400 rows in one segment need some 0"):
        bench.run()
    assert not (bench.folder / "recording").exists()


@pytest.mark.slow
def test_memory_holds_one_segment_not_the_file(bench: Bench) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    # Fifty segments of 20,000 rows, 7 columns of doubles: 56 MB in all, 1.1 MB each.
    columns, _ = phase_log(*held_current(20_000))
    bench.mapping |= {"segment_column": "k", "segments": [{"label": "*", "stage": "resistance"}]}
    path = bench.folder / "long.parquet"
    with pq.ParquetWriter(path, pa.table(columns | {"k": np.zeros(20_000, dtype=int)}).schema) as writer:
        for k in range(50):
            part = columns | {"t": columns["t"] + 2.0 * k, "k": np.full(20_000, k)}
            writer.write_table(pa.table(part))
    import tracemalloc

    tracemalloc.start()
    report = import_files(bench.write_mapping(), [path], bench.folder / "out")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert report.segments == 50
    assert peak < 25e6


@pytest.mark.posix
@pytest.mark.slow
def test_ten_million_rows_of_text_take_twenty_seconds_and_a_gigabyte(bench: Bench) -> None:
    """As one segment, the worst that can come."""
    import pyarrow as pa
    import pyarrow.csv

    n, path = 250_000, bench.folder / "log.csv"
    columns, _ = phase_log(*(np.round(x, 4) for x in held_current(n)))
    with pa.csv.CSVWriter(path, pa.table(columns).schema) as writer:
        for k in range(40):
            writer.write(pa.table(columns | {"t": np.round(columns["t"] + k * n / 1e4, 4)}))
    # Of a child the system counts what its parent had before it became another program as well.
    program = (
        "import atexit, re; from orchestrator.interface.cli import main; "
        "atexit.register(lambda: print(re.search(r'VmHWM:\\s*(\\d+)', open('/proc/self/status').read())[1])); main()"
    )
    command = [sys.executable, "-c", program, "import", str(bench.write_mapping()), str(path), "--out", "out"]
    before = os.times()
    ran = subprocess.run(command, cwd=bench.folder, check=True, capture_output=True, text=True)
    after = os.times()
    used_s = after.children_user + after.children_system - before.children_user - before.children_system
    assert used_s < 20.0
    assert int(ran.stdout.split()[-1]) * 1024 < 1e9


def test_errors_are_the_project_s_own_and_one_line(bench: Bench) -> None:
    bench.columns["ia"][7] = np.nan
    with pytest.raises(FluxbenchError) as raised:
        bench.run()
    assert len(str(raised.value).splitlines()) == 1
    assert str(raised.value).startswith(f"{bench.folder}{os.sep}log.csv: ia: row 8 (t = 0.0007 s) has no finite value")
