"""A mapping guessed from a file says why, imports, and gives the measurement; an ambiguous file is refused."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import scipy.signal

from orchestrator.importing import import_files
from orchestrator.importing.guessing import guess_mapping
from orchestrator.importing.guessing._roles import roles_of
from orchestrator.importing.guessing._units import names_and_units
from orchestrator.interface.cli._running import run_app
from orchestrator.recording import open_recording
from protocols import InputError
from tests.orchestrator.importing.benches import Numbers
from tests.orchestrator.importing.strangers import PLATE, Log, log_of
from tests.support.cases import few

LOG = log_of(("gates_off-000", "resistance-000", "resistance-014", "classical-005", "injection-012"))
SOME = LOG.rows(slice(5000, 15000))


def columns(log: Log, amps: float = 1.0) -> list[Numbers]:
    return [*(amps * x for x in log.phases.values()), *log.volts.values()]


def text(path: Path, head: str, rows: Sequence[Numbers], delimiter: str = ",", decimal: str = ".") -> Path:
    lines = (delimiter.join(f"{x:.9g}".replace(".", decimal) for x in row) for row in zip(*rows, strict=True))
    path.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def german(path: Path) -> Path:
    names = "Zeit;i_u;i_v;i_w;u_u;u_v;u_w;u_dc\nms;mA;mA;mA;V;V;V;V\n"
    return text(
        path, f"Messung 7;;;\nDatum;23.11.2026\n\n{names}", [1e3 * SOME.t, *columns(SOME, 1e3), SOME.dc], ";", ","
    )


def plecs(path: Path) -> Path:
    head = '"Time / s","Ia / A","Ib / A","Ic / A","Va / V","Vb / V","Vc / V"\n'
    return text(path, head, [SOME.t, *columns(SOME)])


def data_inspector(path: Path) -> Path:
    units = ",".join(["Unit: s", *3 * ["Unit: A"], *3 * ["Unit: V"]])
    names = "time,ia,ib,ic,va_ref,vb_ref,vc_ref"
    return text(path, f"{names}\n{units}\nInterp: zoh,,,,,,\n", [SOME.t, *columns(SOME)])


def rigol(path: Path) -> Path:
    head = "X,ia,ib,ic,va,vb,vc,Start,Increment,\nSequence,A,A,A,V,V,V,0,1.000000e-04,\n"
    return text(path, head, [np.arange(SOME.t.size, dtype=float), *columns(SOME)])


def keysight(path: Path) -> Path:
    head = "x-axis,Ia,Ib,Ic,Va,Vb,Vc\nsecond,Ampere,Ampere,Ampere,Volt,Volt,Volt\n"
    return text(path, head, [SOME.t, *columns(SOME)])


def tektronix(path: Path) -> Path:
    head = (
        "Model,MSO54\nFirmware Version,1.28\nSample Interval,1E-4\n\nLabels,ia,ib,ic,va,vb,vc\nTIME,ia,ib,ic,va,vb,vc\n"
    )
    return text(path, head, [SOME.t, *columns(SOME)])


@few("write", [german, plecs, data_inspector, rigol, keysight, tektronix], fast=3)
def test_texts_of_common_loggers_are_guessed(tmp_path: Path, write: Any) -> None:
    path = write(tmp_path / "log.csv")
    guessed = guess_mapping(path)
    (tmp_path / "m.yaml").write_text(guessed.text)
    report = import_files(tmp_path / "m.yaml", [path], tmp_path / "out")
    assert (report.samples, report.sampling_frequency_hz) == (SOME.t.size, 1e4)
    recording = open_recording(tmp_path / "out")
    (segment,) = recording.segments()
    assert segment.stage == "classical"
    capture = recording.load(segment)
    np.testing.assert_allclose(capture.i_ab, SOME.i, atol=1e-5)
    np.testing.assert_allclose(capture.v_ab, SOME.v, atol=1e-4)


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name, x in {"t": LOG.t, **LOG.phases, **LOG.volts}.items():
            file[f"bench/{name}"] = x


def matlab(path: Path) -> None:
    amps = {"i_alpha": LOG.i[:, 0], "i_beta": LOG.i[:, 1]}
    scipy.io.savemat(path, {"log": {"t": LOG.t, **amps, "u_alpha": LOG.v[:, 0], "u_beta": LOG.v[:, 1]}})


def parquet(path: Path) -> None:
    points = [{"gates_off": "A", "resistance": "B", "classical": "C", "injection": "D"}[stage] for stage in LOG.stage]
    pq.write_table(pa.table({"t": LOG.t, **LOG.phases, **LOG.volts, "point": points}), path)


def dspace(path: Path) -> None:
    """As ControlDesk writes a recording: the time in X, each signal in Y with its name."""
    signals = {**LOG.phases, **LOG.volts, "u_dc": LOG.dc, "Counter": np.arange(LOG.t.size, dtype=float)}
    held = np.empty((1, len(signals)), dtype=[(x, object) for x in ("Name", "Type", "Data", "Unit", "XIndex")])
    for k, (name, x) in enumerate(signals.items()):
        held[0, k] = (f"Model Root/{name}", 4.0, x, "", 1.0)
    scipy.io.savemat(path, {"rec_001": {"X": {"Name": "", "Data": LOG.t}, "Y": held, "Description": {"x": 1.0}}})


@pytest.mark.parametrize(
    ("name", "write"), [("log.h5", hdf5), ("log.mat", matlab), ("rec.mat", dspace), ("log.parquet", parquet)]
)
def test_stages_are_reported_from_the_waveforms(tmp_path: Path, name: str, write: Any) -> None:
    write(tmp_path / name)
    guessed = guess_mapping(tmp_path / name)
    (tmp_path / "m.yaml").write_text(guessed.text)
    import_files(tmp_path / "m.yaml", [tmp_path / name], tmp_path / "out")
    recording = open_recording(tmp_path / "out")
    stages = [segment.stage.value for segment in recording.segments() for _ in range(segment.samples)]
    assert stages == LOG.stage


def test_each_line_says_why_and_what_to_look_at(tmp_path: Path) -> None:
    guessed = guess_mapping(german(tmp_path / "log.csv"))
    assert all("#" in line or line == "segments:" for line in guessed.text.splitlines())
    assert any(doubt.startswith("motor: not in the file") for doubt in guessed.doubts)


@pytest.mark.parametrize("axes", ["UVW", "ABC", "rst"])
def test_a_phase_is_no_unit_and_unused_columns_are_named(tmp_path: Path, axes: str) -> None:
    names = [f"{quantity}_{axis}" for quantity in "IU" for axis in axes]
    units = "s;mA;mA;mA;V;V;V;degC;-;-"
    head = f"t;{';'.join(names)};temperature;rpm;counter\n{units}\n"
    others = [np.full(SOME.t.size, 21.5), SOME.t, SOME.t]
    guessed = guess_mapping(text(tmp_path / "log.csv", head, [SOME.t, *columns(SOME, 1e3), *others], ";"))
    a, b, c = list(axes)
    assert f"columns: {{a: I_{a}, b: I_{b}, c: I_{c}}}, unit: mA" in guessed.text
    assert f"columns: {{a: U_{a}, b: U_{b}, c: U_{c}}}, unit: V" in guessed.text
    assert "temperature: {column: temperature, unit: degC}" in guessed.text
    assert "not used: rpm, counter" in guessed.doubts
    assert "no rotor_angle in the mapping: 0 is assumed" in guessed.doubts


def test_the_pwm_frequency_is_requested_with_what_it_is_good_for(tmp_path: Path) -> None:
    guessed = guess_mapping(german(tmp_path / "log.csv"))
    requested = "drive: pwm_frequency_hz: not in the file; state it, and a dead time comes in seconds too"
    assert any(doubt.startswith(requested) for doubt in guessed.doubts)
    assert any("settings: {pwm_frequency_hz: 20000}" in doubt for doubt in guessed.doubts)
    assert "pwm_frequency_hz: null}" in guessed.text


def test_a_stretch_begins_between_two_rows_at_a_round_time_and_holds_that_return_are_questioned(tmp_path: Path) -> None:
    holds = np.repeat([1.0, 2.0], 5000)
    amps = np.concatenate([holds, 2.0 * np.sin(np.arange(20000) / 2e4 * 2.0 * np.pi + 0.5 * np.pi), holds])
    amps += np.random.default_rng(0).normal(scale=1e-4, size=amps.size)
    log = {"ia": amps, "ib": -0.5 * amps, "va": 4.0 * amps, "vb": -2.0 * amps}
    path = text(tmp_path / "log.csv", f"t,{','.join(log)}\n", [np.arange(amps.size) / 1e4, *log.values()])
    guessed = guess_mapping(path)
    starts = [float(x) for x in re.findall(r"from_s: ([\d.]+)", guessed.text)]
    for start in starts:
        assert 0.25 - 1e-6 <= start * 1e4 % 1.0 <= 0.75 + 1e-6
        assert len(f"{start:.9f}".rstrip("0").partition(".")[2]) <= 5
    (asked,) = [doubt for doubt in guessed.doubts if doubt.startswith("segments: currents are held again")]
    assert "from_s: 2." in asked or "from_s: 3." in asked
    assert "one PWM frequency is assumed" in asked


def spoilt_text(tmp_path: Path, names: str, rows: Sequence[Numbers]) -> Path:
    return text(tmp_path / "log.csv", names + "\n", rows)


@pytest.mark.parametrize(
    ("names", "rows", "message"),
    [
        (
            "LECROYWaveRunner\u00ff,20113,Waveform\nSegments,1,SegmentSize,10000\nSegment,TrigTime,TimeSinceSegment1\n"
            "#1,14-May-2019 13:29:30,0                 \nTime,Ampl",
            [SOME.t, columns(SOME)[0]],
            "one file per channel (LeCroy): add the other files",
        ),
        ("TIME,CH1,CH2,CH3", [SOME.t, *columns(SOME)[:3]], "no column names identify the currents"),
        ("t,ia,ib,ic", [SOME.t, *columns(SOME)[:3]], "has currents and no voltages: log the drive's commanded"),
        (
            "t,ia,ib,ic,CH4,CH5",
            [SOME.t, *columns(SOME)[:3], *columns(SOME)[:2]],
            "no column names identify the voltages (va, vb, vc, vd, vq",
        ),
        (
            "t,ia,ib,ic,va,vb,vc",
            [np.roll(SOME.t, 200), *columns(SOME)],
            " s comes 43.7 s; sort the rows",
        ),
        ("ia,ib,ic,va,vb,vc", columns(SOME), "no column of time, and no sampling frequency in the file"),
        ("t,ia,ib,ic,va,vb,vc", [np.arange(SOME.t.size), *columns(SOME)], "t: steps of 1 may be ms or us; the unit"),
        (
            "t,ia,ib,va,vb,vc",
            [SOME.t, *(np.rint(1e3 * x) for x in columns(SOME)[:2]), *columns(SOME)[3:]],
            "ia, ib: whole numbers up to",
        ),
        (
            "t,ia,ib,ic,da,db,dc",
            [SOME.t, *columns(SOME)[:3], *(0.5 + x / 540 for x in columns(SOME)[3:])],
            "duties with",
        ),
        (
            "t,ia,ib,ic,va,vb,vc",
            [SOME.t, *columns(SOME)[:3], *(-x for x in columns(SOME)[3:])],
            "the guessed mapping cannot be imported: voltage and current are 180 degrees apart",
        ),
        (
            "t,ia,ib,va,vb",
            [
                SOME.t,
                *(2 * np.cos(300 * SOME.t - k) for k in (0, 2.0944)),
                *(9 * np.cos(300 * SOME.t - k) for k in (0, 2.09)),
            ],
            "the current turns 48 times at 47.67 Hz, and no column is the rotor's angle",
        ),
    ],
)
def test_an_ambiguous_file_is_refused_with_one_line(
    tmp_path: Path, names: str, rows: Sequence[Numbers], message: str
) -> None:
    with pytest.raises(InputError) as raised:
        guess_mapping(spoilt_text(tmp_path, names, rows))
    assert message in str(raised.value)
    assert len(str(raised.value).splitlines()) == 1


def test_the_command_writes_a_mapping_that_imports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    keysight(Path("log.csv"))
    Path("plate.yaml").write_text(PLATE)
    assert run_app(["import", "--guess", "log.csv", "--motor", "plate.yaml"]) == 0
    assert "fluxbench import log.yaml log.csv --out DIR" in capsys.readouterr().out
    assert run_app(["import", "log.yaml", "log.csv", "--out", "recording"]) == 0
    assert run_app(["import", "--guess", "log.csv"]) == 2
    assert "log.yaml: exists already" in capsys.readouterr().err
    assert run_app(["import", "--guess", "plate.yaml", "--out", "x.yaml"]) == 2
    assert not Path("x.yaml").exists()
    assert run_app(["import", "log.yaml"]) == 2


@few("hz", [20.0, 4.0, 100.0])
def test_slow_square_waves_about_held_currents_are_injections(tmp_path: Path, hz: float) -> None:
    ohm, henry, rate = 0.4, 1e-3, 1e4
    points = [(2.0, 0.0), (0.0, 5.0), (0.0, 0.0)]
    rows = int(8 * rate / hz)
    sign = np.where(np.arange(rows) // int(0.5 * rate / hz) % 2 == 0, 0.5, -0.5)[:, None]
    waves = [ohm * np.array(point) + sign * axis for point in points for axis in np.eye(2)]
    v = np.concatenate([np.zeros((5000, 2)), *(np.tile(ohm * np.array(p), (6000, 1)) for p in points[:2]), *waves])
    i = scipy.signal.lfilter(
        [0.0, 1.0 / ohm * (1.0 - (decay := np.exp(-ohm / henry / rate)))], [1.0, -decay], v, axis=0
    )
    i += 3e-3 * np.random.default_rng(3).normal(size=i.shape)
    names = [f"{x}_{axis}" for x in ("i", "u") for axis in ("alpha", "beta")]
    path = text(tmp_path / "log.csv", "t," + ",".join(names) + "\n", [np.arange(len(i)) / rate, *i.T, *v.T])
    (tmp_path / "m.yaml").write_text(guess_mapping(path).text)
    import_files(tmp_path / "m.yaml", [path], tmp_path / "out")
    segments = open_recording(tmp_path / "out").segments()
    assert [s.stage.value for s in segments] == ["gates_off", "resistance", "resistance", *["injection"] * 6]
    starts = [0.0, 0.5, 1.1, *(1.7 + k * 8 / hz for k in range(6))]
    assert [s.start_s for s in segments] == pytest.approx(starts, abs=1.5 / rate)


def test_the_drive_of_a_motor_file_is_the_mappings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    plecs(Path("log.csv"))
    Path("plate.yaml").write_text(PLATE.replace("voltage_delay_samples: 0", "port: COM3"))
    assert run_app(["import", "--guess", "log.csv", "--motor", "plate.yaml"]) == 0
    mapping = Path("log.yaml").read_text()
    assert "drive: {name: bench, dc_bus_voltage_v: 540.0, pwm_frequency_hz: 10000.0}  # as given" in mapping
    Path("plate.yaml").write_text(PLATE.replace("540", "plenty"))
    assert run_app(["import", "--guess", "log.csv", "--motor", "plate.yaml", "--out", "m.yaml"]) == 2


def test_a_unit_that_is_not_in_the_file_follows_from_nameplate_and_bus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text(
        Path("log.csv"),
        "t,ia,ib,ic,va,vb,vc\n",
        [SOME.t, *columns(SOME, 1e3)[:3], *(1e3 * x for x in SOME.volts.values())],
    )
    Path("plate.yaml").write_text(PLATE)
    assert run_app(["import", "--guess", "log.csv", "--motor", "plate.yaml"]) == 0
    mapping = Path("log.yaml").read_text()
    assert "unit: mA}" in mapping
    assert "unit: mV}" in mapping


def test_holds_and_injections_of_one_log_are_reported_by_their_currents(tmp_path: Path) -> None:
    levels = [(1.0, 0.0), (-1.0, 0.5), (2.0, 0.0), (0.0, 2.0)]
    held = np.repeat(np.array(levels), 2500, axis=0)
    held += 1e-3 * np.random.default_rng(5).normal(size=held.shape)
    n = np.arange(len(held))
    wave = np.where(n // 10 % 2 == 0, 40.0, -40.0)[:, None] * np.column_stack([np.cos(n / 1500), np.sin(n / 1500)])
    ripple = np.where(n[:, None] // 10 % 2 == 0, 0.02, -0.02)
    i = np.concatenate([held, held + ripple])
    v = np.concatenate([4.0 * held, 4.0 * held + wave])
    names = [f"{x}_{axis}" for x in ("i", "u") for axis in ("alpha", "beta")]
    path = text(tmp_path / "log.csv", "t," + ",".join(names) + "\n", [np.arange(len(i)) / 1e4, *i.T, *v.T])
    (tmp_path / "m.yaml").write_text(guess_mapping(path).text)
    import_files(tmp_path / "m.yaml", [path], tmp_path / "out")
    recording = open_recording(tmp_path / "out")
    found = [
        (s.stage.value, *recording.load(s).i_ab[s.samples // 2 :].mean(axis=0).round(1)) for s in recording.segments()
    ]
    assert found == [(stage, *level) for stage in ("resistance", "injection") for level in levels]


def test_a_voltage_that_drives_the_current_to_and_fro_is_no_injection(tmp_path: Path) -> None:
    rate, ohm, henry, volts, limit = 2e4, 0.2, 3e-4, 6.0, 10.0
    i, v, sign = [0.0], list[float](), 1.0
    for k in range(20_000):
        now = i[-1]
        sign = -1.0 if now > limit else 1.0 if now < -limit else sign
        v.append(sign * volts if 4000 <= k < 12_000 else 0.0)
        i.append(now + (v[-1] - ohm * now) / henry / rate)
    read = 5e-3 * np.random.default_rng(6).normal(size=(2, len(v)))
    log = [np.arange(len(v)) / rate, read[0] + i[:-1], read[1], np.array(v), np.zeros(len(v))]
    path = text(tmp_path / "log.csv", "t,i_alpha,i_beta,u_alpha,u_beta\n", log)
    (tmp_path / "m.yaml").write_text(guess_mapping(path).text)
    import_files(tmp_path / "m.yaml", [path], tmp_path / "out")
    found = [(s.stage.value, round(s.samples / rate, 1)) for s in open_recording(tmp_path / "out").segments()]
    assert found == [("gates_off", 0.2), ("steps", 0.4), ("gates_off", 0.4)]


def test_effective_values_are_reported_by_their_unit(tmp_path: Path) -> None:
    names = "Time [ms];Id_act [Arms];Iq_act [Arms];Ud_ref [V];Uq_ref [V]"
    rows = [1e3 * SOME.t, *(x / np.sqrt(2.0) for x in SOME.i.T), *SOME.v.T]
    path = text(tmp_path / "log.csv", names + "\n", rows, ";", ",")
    guessed = guess_mapping(path)
    (tmp_path / "m.yaml").write_text(guessed.text)
    import_files(tmp_path / "m.yaml", [path], tmp_path / "out")
    recording = open_recording(tmp_path / "out")
    read = np.concatenate([recording.load(segment).i_ab for segment in recording.segments()])
    np.testing.assert_allclose(read, SOME.i, atol=1e-5)
    assert not any(doubt.startswith("current: scaling") for doubt in guessed.doubts)


def test_labels_of_each_point_make_a_rule_for_each_kind(tmp_path: Path) -> None:
    points = np.repeat(np.arange(60), 300)
    names = [f"hold-{k:02d}" if k < 50 else f"ripple-{k:02d}" for k in points]
    n = np.arange(points.size)
    held = np.where(points < 50, (points - 25.5) / 25.0, 0.5)
    wave = np.where((points >= 50) & (n // 10 % 2 == 0), 40.0, np.where(points >= 50, -40.0, 0.0))
    noise = 1e-3 * np.random.default_rng(7).normal(size=(2, n.size))
    log = {"t": n / 1e4, "i_alpha": held + noise[0], "i_beta": noise[1]}
    log |= {"u_alpha": 4.0 * held + wave, "u_beta": 0.0 * held}
    pq.write_table(pa.table(log | {"point": names}), tmp_path / "log.parquet")
    guessed = guess_mapping(tmp_path / "log.parquet")
    assert "{label: hold-*, stage: resistance}  # 50 labels: currents that stand still" in guessed.text
    assert "{label: ripple-*, stage: injection}  # 10 labels" in guessed.text
    (tmp_path / "m.yaml").write_text(guessed.text)
    import_files(tmp_path / "m.yaml", [tmp_path / "log.parquet"], tmp_path / "out")
    assert len(open_recording(tmp_path / "out").segments()) == 60


def holds(count: int, pause_s: float) -> dict[str, Numbers]:
    """Holds of 0.3 s at currents that go down and up again."""
    points = np.repeat(np.arange(count), 600)
    held = 0.1 + np.abs(points - count // 2) / count
    t = np.arange(points.size) / 2e3 + pause_s * points
    noise = 1e-3 * np.random.default_rng(8).normal(size=(2, t.size))
    return {"t": t, "i_alpha": held + noise[0], "i_beta": noise[1], "u_alpha": 4.0 * held, "u_beta": 0.0 * held}


@few("pause_s", [0.0, 1.0])
def test_many_holds_without_labels_are_found_one_by_one(tmp_path: Path, pause_s: float) -> None:
    log = holds(25, pause_s)
    many = {name: np.concatenate([x, x]) for name, x in log.items()}
    many["t"][log["t"].size :] += log["t"][-1] + pause_s + 1.0
    pq.write_table(pa.table(many), tmp_path / "log.parquet")
    (tmp_path / "m.yaml").write_text(guess_mapping(tmp_path / "log.parquet").text)
    report = import_files(tmp_path / "m.yaml", [tmp_path / "log.parquet"], tmp_path / "out")
    assert [report.segments, report.samples] == [50, many["t"].size]


def test_numbers_that_are_no_labels_are_not_taken_for_them(tmp_path: Path) -> None:
    log = holds(10, 1.0)
    pq.write_table(pa.table(log | {"state": np.arange(log["t"].size)}), tmp_path / "log.parquet")
    guessed = guess_mapping(tmp_path / "log.parquet")
    assert "segment_column" not in guessed.text
    assert any("6000 different values are no labels of experiments" in doubt for doubt in guessed.doubts)


def test_a_log_that_changes_all_the_time_wants_a_label_for_each_kind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.importing.guessing._guessing.MAX_RULES", 5)
    pq.write_table(pa.table(holds(10, 1.0)), tmp_path / "log.parquet")
    with pytest.raises(InputError, match="one label for each kind of experiment \\(holds, sweeps, injections\\)"):
        guess_mapping(tmp_path / "log.parquet")


def test_a_millisecond_without_a_unit_is_in_seconds_and_doubted(tmp_path: Path) -> None:
    log = holds(10, 0.0)
    log["t"] = 2.0 * log["t"]
    pq.write_table(pa.table(log), tmp_path / "log.parquet")
    guessed = guess_mapping(tmp_path / "log.parquet")
    assert "time: {column: t, unit: s}" in guessed.text
    assert "time: steps of 0.001: 1000 Hz in s; not in the file" in guessed.doubts


def flux_table(path: Path) -> Path:
    path.write_text("i_d_A,i_q_A,psi_d_Vs,psi_q_Vs\n0,0,0.1,0\n1,0,0.2,0\n")
    return path


def flux_arrays(path: Path) -> Path:
    scipy.io.savemat(path, {"Id_Peak": np.eye(3), "Iq_Peak": np.eye(3), "Flux_D": np.eye(3), "Flux_Q": np.eye(3)})
    return path


def flux_over_angles(path: Path) -> Path:
    scipy.io.savemat(
        path, {"id": np.arange(3.0), "iq": np.arange(3.0), "psid": np.ones((3, 3, 4)), "psiq": np.ones((3, 3, 4))}
    )
    return path


@pytest.mark.parametrize(
    ("name", "write"), [("m.csv", flux_table), ("m.mat", flux_arrays), ("angles.mat", flux_over_angles)]
)
def test_a_flux_map_is_known_and_audit_named(tmp_path: Path, name: str, write: Any) -> None:
    with pytest.raises(InputError, match=f"holds a flux map instead of waveforms: `fluxbench audit {name}`"):
        guess_mapping(write(tmp_path / name))


def test_a_kind_of_file_that_holds_maps_only_names_audit(tmp_path: Path) -> None:
    np.savez(tmp_path / "m.npz", psi=np.zeros(3))
    with pytest.raises(InputError, match=r"`fluxbench audit m\.npz` checks a flux map"):
        guess_mapping(tmp_path / "m.npz")


def test_the_mapping_of_a_map_is_not_imported(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text("format: fluxbench-map\nversion: 1\n")
    with pytest.raises(InputError, match="the mapping of a flux map, not of waveforms: `fluxbench audit` reads it"):
        import_files(tmp_path / "m.yaml", [flux_table(tmp_path / "m.csv")], tmp_path / "out")


@pytest.mark.parametrize("names", ["CH1 Ia (A),CH2 Ib (A),CH3 Van (V),CH4 Vbn (V),CH5 Vcn (V)", "ia,ib,va,vb,vc"])
def test_a_scope_s_channel_before_a_name_does_not_hide_it(names: str) -> None:
    found = roles_of(names.split(","), {})
    assert found.current is not None
    assert found.voltage is not None
    assert sorted(found.current.columns) == ["a", "b"]
    assert sorted(found.voltage.columns) == ["a", "b", "c"]


def test_variables_of_many_columns_are_listed_once(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "m.mat", {"x": np.ones((5, 40)), "t": np.arange(5.0)})
    with pytest.raises(InputError, match="no column names identify the currents") as caught:
        guess_mapping(tmp_path / "m.mat")
    assert list(caught.value.choices) == ["x", "t"]


@pytest.mark.parametrize("names", ["Zeit;Strom_U;Strom_V;Soll_Ud;Soll_Uq;ZK", "t;cmd_vd;cmd_vq;iu;iv;vdc"])
def test_a_command_before_a_name_is_that_of_the_voltages(names: str) -> None:
    roles = roles_of(names.split(";"), {})
    assert roles.voltage is not None
    assert roles.voltage.frame == "dq"
    assert set(roles.voltage.columns) == {"d", "q"}
    assert roles.current is not None
    assert "bus" in roles.one


@pytest.mark.parametrize(
    ("names", "current", "voltage"),
    [
        ("t,i_a,i_b,i_c,u_a,u_b,u_c", "i_a,i_b,i_c", "u_a,u_b,u_c"),
        ("t,i_a,i_c,v_a,v_c", "i_a,i_c", "v_a,v_c"),
        ("time_s,CH1 I_A,CH2 I_B,CH3 V_A,CH4 V_B", "CH1 I_A,CH2 I_B", "CH3 V_A,CH4 V_B"),
        ("time_s,i_a_a,i_b_a,i_c_a,v_a_v,v_b_v,v_c_v,v_dc_v", "i_a_a,i_b_a,i_c_a", "v_a_v,v_b_v,v_c_v"),
        ("time_s,i_u_a,i_v_a,i_w_a,v_u_v,v_v_v,v_w_v", "i_u_a,i_v_a,i_w_a", "v_u_v,v_v_v,v_w_v"),
        ("time_s,i_d_a,i_q_a,v_d_v,v_q_v,v_dc_v", "i_d_a,i_q_a", "v_d_v,v_q_v"),
        ("t,iu,iv,iw,vu,vv,vw", "iu,iv,iw", "vu,vv,vw"),
        ("t,i_u,i_v,u_u_v,u_v_w,u_w_u", "i_u,i_v", "u_u_v,u_v_w,u_w_u"),
    ],
)
def test_a_suffix_is_a_phase_beside_its_like_and_else_a_unit(names: str, current: str, voltage: str) -> None:
    roles = roles_of(names.split(","), {})
    assert roles.current is not None
    assert roles.voltage is not None
    assert ",".join(roles.current.columns.values()) == current
    assert ",".join(roles.voltage.columns.values()) == voltage


def test_a_unit_in_lower_case_is_of_a_current_or_a_voltage_that_has_an_axis() -> None:
    names = ["i_a", "i_d_a", "v_dc_v", "sector_a", "i_u", "v_u_v"]
    assert [unit for _, unit in names_and_units(names).values()] == [None, "A", "V", None, None, "V"]


@pytest.mark.parametrize("name", ["f_pwm", "fsw_kHz", "PWM_freq", "switching_frequency_hz"])
def test_a_column_of_the_pwm_frequency_is_known_by_its_name(name: str) -> None:
    assert roles_of(["t", "ia", "ib", "va", "vb", name], {}).one["pwm_frequency"] == name
