"""A recording written in any frame, unit, scaling and file, and imported, is the recording it was."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.importing import import_files
from orchestrator.recording import Recording, open_recording
from tests.orchestrator.importing.benches import MOTOR, Bench, Numbers, in_phases, write_table
from tests.support.close import assert_close

REDUCED = Path(__file__).parents[2] / "data" / "pm400-reduced"

CURRENT_UNITS = {"A": 1.0, "mA": 1e3, "uA": 1e6, "kA": 1e-3}
VOLTAGE_UNITS = {"V": 1.0, "mV": 1e3, "uV": 1e6, "kV": 1e-3}
TIME_UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "min": 1.0 / 60.0}
ANGLE_UNITS = {"rad": 1.0, "deg": 180.0 / np.pi, "turn": 0.5 / np.pi}
SCALINGS = {"amplitude_invariant": 1.0, "power_invariant": np.sqrt(1.5), "rms": np.sqrt(0.5)}


@st.composite
def forms(draw: st.DrawFn) -> dict[str, Any]:
    """A way of writing one signal down."""
    frame = draw(st.sampled_from(["abc", "alpha_beta", "dq"]))
    names = {"abc": "abc", "alpha_beta": ("alpha", "beta"), "dq": "dq"}[frame]
    axes = list(names)
    if frame == "abc" and draw(st.booleans()):
        axes.remove(draw(st.sampled_from("abc")))
    scalings = [None, "amplitude_invariant", "rms"] if frame == "abc" else list(SCALINGS)
    return {
        "frame": frame,
        "axes": axes,
        "scaling": draw(st.sampled_from(scalings)),
        "factor": draw(st.sampled_from([1.0, -1.0, 100.0, 0.25])),
        "angle": draw(st.sampled_from(["rotor", "value", "column"])),
        "angle_unit": draw(st.sampled_from(list(ANGLE_UNITS))),
    }


def written(form: dict[str, Any], x_ab: Numbers, unit: float, angle: Numbers) -> dict[str, Numbers]:
    """The signal's values by axis."""
    vectors = x_ab * unit * SCALINGS[form["scaling"] or "amplitude_invariant"] / form["factor"]
    if form["frame"] == "abc":
        by_axis = dict(zip("abc", in_phases(vectors).T, strict=True))
    elif form["frame"] == "alpha_beta":
        by_axis = dict(zip(("alpha", "beta"), vectors.T, strict=True))
    else:
        turned = (vectors[:, 0] + 1j * vectors[:, 1]) * np.exp(-1j * angle)
        by_axis = {"d": turned.real, "q": turned.imag}
    return {axis: by_axis[axis] for axis in form["axes"]}


def described(form: dict[str, Any], prefix: str, unit: str, theta: float) -> dict[str, Any]:
    """The signal's section of the mapping."""
    section: dict[str, Any] = {
        "frame": form["frame"],
        "columns": {axis: f"{prefix}_{axis}" for axis in form["axes"]},
        "unit": unit,
        "factor": form["factor"],
    }
    if form["scaling"] is not None:
        section["scaling"] = form["scaling"]
    if form["frame"] == "dq" and form["angle"] != "rotor":
        given = {"value": theta * ANGLE_UNITS[form["angle_unit"]]} if form["angle"] == "value" else {"column": "theta"}
        section["angle"] = {**given, "unit": form["angle_unit"] if form["angle"] == "value" else "rad"}
    return section


def write_file(path: Path, columns: dict[str, Numbers]) -> Path:
    """Columns in the form that the name asks for."""
    if path.name == "v5.mat":
        scipy.io.savemat(path, columns)
    elif path.name == "v73.mat":
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, values in columns.items():
                file[name] = values[None, :]  # MATLAB keeps an n x 1 vector as 1 x n
    else:
        write_table(path, columns)
    return path


@given(data=st.data(), seed=st.integers(0, 2**31), theta=st.floats(-3.0, 3.0), n=st.integers(10, 300))
def test_waveforms_come_back_from_any_frame_unit_scaling_and_file(
    data: st.DataObject, seed: int, theta: float, n: int
) -> None:
    rng = np.random.default_rng(seed)
    direction = np.array([np.cos(theta), np.sin(theta)])
    i_ab = (2.0 * direction + 0.1 * rng.normal(size=(n, 2))).astype("f4").astype(float)
    v_ab = (8.5 * direction + rng.normal(size=(n, 2))).astype("f4").astype(float)
    v_dc = rng.uniform(500.0, 560.0, n).astype("f4").astype(float)
    rate = data.draw(st.sampled_from([4e3, 1e4, 12_500.0, 44_100.0]))
    start_s = data.draw(st.floats(0.0, 100.0))
    current, voltage = data.draw(forms()), data.draw(forms())
    units = {
        kind: data.draw(st.sampled_from(list(table)))
        for kind, table in (("i", CURRENT_UNITS), ("v", VOLTAGE_UNITS), ("bus", VOLTAGE_UNITS), ("t", TIME_UNITS))
    }
    angle = np.full(n, theta)
    columns: dict[str, Numbers] = {"t": (start_s + np.arange(n) / rate) * TIME_UNITS[units["t"]], "theta": angle}
    columns |= {f"i_{a}": x for a, x in written(current, i_ab, CURRENT_UNITS[units["i"]], angle).items()}
    columns |= {f"v_{a}": x for a, x in written(voltage, v_ab, VOLTAGE_UNITS[units["v"]], angle).items()}
    columns["udc"] = v_dc * VOLTAGE_UNITS[units["bus"]]
    mapping = {
        "format": "fluxbench-import",
        "version": 1,
        "name": "round trip",
        "motor": MOTOR,
        "drive": {"name": "d", "dc_bus_voltage_v": 540.0},
        "time": {"column": "t", "unit": units["t"]},
        "sampling_frequency_hz": rate,
        "current": described(current, "i", units["i"], theta),
        "voltage": described(voltage, "v", units["v"], theta),
        "bus": {"column": "udc", "unit": units["bus"]},
        "rotor_angle": {"value": theta, "unit": "rad"},
        "segments": [{"stage": "classical"}],
    }
    name = data.draw(st.sampled_from(["log.csv", "log.parquet", "v5.mat", "v73.mat"]))
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), columns, mapping)
        path = write_file(bench.folder / name, columns)
        report = import_files(bench.write_mapping(), [path], bench.folder / "recording")
        (capture,) = bench.captures()
    assert report.notes == ()
    assert capture.start_s == pytest.approx(start_s, abs=1e-9)
    np.testing.assert_allclose(capture.i_ab, i_ab, rtol=0, atol=3 * 2.0**-24 * np.abs(i_ab).max())
    np.testing.assert_allclose(capture.v_ab, v_ab, rtol=0, atol=3 * 2.0**-24 * np.abs(v_ab).max())
    np.testing.assert_allclose(capture.v_dc, v_dc, rtol=3 * 2.0**-24)


def exported(recording: Recording, bench: Bench) -> None:
    """Every segment of a recording as a CSV file of its own: phases, rms scaling, mA, a time column in ms."""
    rules: list[dict[str, Any]] = []
    for segment in recording.segments():
        capture = recording.load(segment)
        time_ms = (segment.start_s + np.arange(len(capture)) / 1e4) * 1e3
        columns: dict[str, Any] = {"time": time_ms, "udc": capture.v_dc}
        phases = in_phases(capture.i_ab.astype(float)) * 1e3 / np.sqrt(2.0)
        columns |= dict(zip(("ia", "ib", "ic"), phases.T, strict=True))
        volts = in_phases(capture.v_ab.astype(float)) / np.sqrt(2.0)
        columns |= dict(zip(("va", "vb", "vc"), volts.T, strict=True))
        bench.files[f"{segment.id}.csv"] = columns
        rules.append(
            {"file": f"{segment.id}.csv", "stage": segment.stage.value, "id": segment.id, "settings": segment.settings}
        )
    bench.mapping |= {
        "motor": recording.manifest.motor.model_dump(exclude_none=True),
        "time": {"column": "time", "unit": "ms"},
        "current": {"frame": "abc", "columns": {"a": "ia", "b": "ib", "c": "ic"}, "unit": "mA", "scaling": "rms"},
        "voltage": {"frame": "abc", "columns": {"a": "va", "b": "vb", "c": "vc"}, "unit": "V", "scaling": "rms"},
        "bus": {"column": "udc", "unit": "V"},
        "segments": rules,
    }


def test_a_real_recording_comes_back_from_rms_phases_in_csv(bench: Bench) -> None:
    original = open_recording(REDUCED)
    exported(original, bench)
    report = bench.run()
    assert report.notes == ()
    back = open_recording(bench.folder / "recording")
    assert len(back.segments()) == len(original.segments())
    for segment, again in zip(original.segments(), back.segments(), strict=True):
        assert (again.id, again.stage, again.settings) == (segment.id, segment.stage, segment.settings)
        assert again.start_s == pytest.approx(segment.start_s, abs=1e-9)
        before, after = original.load(segment), back.load(again)
        assert_close(after.i_ab, before.i_ab, 2.0**-22)
        assert_close(after.v_ab, before.v_ab, 2.0**-22)
        np.testing.assert_array_equal(after.v_dc, before.v_dc)
