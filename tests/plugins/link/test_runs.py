"""Whole runs on the emulated drive over a line or a bus: they measure what the same run measures in this process."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from orchestrator.engine import SAFE_BENCH_WORDS
from orchestrator.recording import open_recording
from protocols import RunEnded
from tests.support.cases import few
from tests.support.emulator import emulator, free_port, with_interlocks
from tests.support.processes import start_fluxbench, wait_until
from tests.support.tiny import STAGES, messages_of, run_tiny, tiny_file

MEASURING = [stage for stage in STAGES if stage["kind"] != "estimate"]
RATED_A, RATED_V = 2.35, 113.0
GROUP = "239.74.163.92"


@cache
def means(path: Path) -> dict[str, np.ndarray]:
    """Mean current and voltage of each segment as parts of the rated ones, shape (4,)."""
    recording = open_recording(path)
    found = {}
    for segment in recording.segments():
        capture = recording.load(segment)
        i, v = capture.i_ab.mean(axis=0) / RATED_A, capture.v_ab.mean(axis=0) / RATED_V
        found[segment.id] = np.concatenate((i, v))
    return found


@few("capture", ["raw", "demodulated"])
def test_a_run_over_a_serial_line_measures_what_a_run_in_process_does(capture: str, tmp_path: Path) -> None:
    drive = {"name": "serial", "port": str(tmp_path / "line"), "capture": capture}
    # The same plant as behind the simulated drive without options: no effects, no noise.
    plant = ("--set", "plant.effects={}", "--set", "plant.sensors.noise_a=0")
    with emulator(tmp_path, "--speed", "max", *plant) as machine:
        result = run_tiny(tmp_path, drive=drive, stages=MEASURING)
        assert result.outcome.ending == "finished", result.outcome.reason
        assert [event["event"] for event in machine.events("armed", "disarmed")][-1] == "disarmed"
    reference = tmp_path / "reference"
    reference.mkdir()
    run_tiny(reference, stages=MEASURING)
    over_line, in_process = means(tmp_path / "run"), means(reference / "run")
    assert over_line.keys() == in_process.keys()
    for name, expected in in_process.items():
        np.testing.assert_allclose(over_line[name], expected, atol=5e-3, err_msg=name)


@few("capture", ["raw", "demodulated"])
def test_the_drives_thermometer_is_in_the_recording(capture: str, tmp_path: Path) -> None:
    drive = {"name": "serial", "port": str(tmp_path / "line"), "capture": capture}
    heating = ("--set", "plant.effects.winding_heating.rise_per_watt=0.05", "--set", "thermometer=true")
    with emulator(tmp_path, "--speed", "max", *heating):
        result = run_tiny(tmp_path, drive=drive, stages=MEASURING)
        assert result.outcome.ending == "finished", result.outcome.reason
    recording = open_recording(tmp_path / "run")
    found = [recording.load(segment).temperature_c for segment in recording.segments()]
    warmth = np.concatenate([t for t in found if t is not None])
    assert len(warmth) == sum(segment.samples for segment in recording.segments())
    assert warmth[0] == pytest.approx(20.0, abs=0.5)
    assert 20.5 < warmth.max() < 60.0


def maps(path: Path) -> xr.Dataset:
    with xr.open_dataset(path / "results" / "flux_map.nc", engine="h5netcdf") as found:
        return found.load()


def require_same_maps(path: Path, reference: Path, flux: float, inductance: float) -> None:
    """Flux linkages and the inductances on the diagonal agree, as parts of their largest value."""
    expected = maps(reference)
    found = maps(path).interp(i_d=expected.i_d, i_q=expected.i_q)
    for name, allowed in (("psi_d", flux), ("psi_q", flux), ("l_dd", inductance), ("l_qq", inductance)):
        apart = np.abs(found[name] - expected[name]) / float(np.abs(expected[name]).max())
        assert float(apart.max()) <= allowed, f"{name} differs by {float(apart.max()):.2%}"


def run_demo(path: Path, *words: str) -> None:
    """The demo to its end, which takes minutes on a busy machine."""
    process = start_fluxbench("run", "demo", *words, "--out", path, "--quiet")
    _, errors = process.communicate(timeout=280)
    assert process.returncode == 0, errors


@pytest.fixture(scope="module")
def demo_in_process(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("demo") / "run"
    run_demo(path)
    return path


def on_link(link: str, capture: str, folder: Path) -> tuple[list[str], list[str]]:
    """Words for the emulator, and for the run: a line, or a multicast bus that stays on this machine."""
    settings = [f"drive.capture={capture}", "drive.telemetry_period_s=0.15"]
    if link == "serial":
        return ["--speed", "4"], [*settings, f"drive.port={folder / 'line'}"]
    fd, own = link == "can fd", {"port": free_port(), "hop_limit": 0}
    words = [f"udp_multicast:{GROUP}", *(["--fd"] if fd else [])]
    words += [word for key, value in own.items() for word in ("--can-set", f"{key}={value}")]
    settings += ["drive.interface=udp_multicast", f"drive.channel={GROUP}", f"drive.fd={str(fd).lower()}"]
    # A bus on a busy machine is slower than the rows; the emulator that waits for nobody keeps them all.
    return [*words, "--speed", "max"], [*settings, f"drive.settings={json.dumps(own)}"]


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("link", "capture"), [("serial", "raw"), ("can fd", "raw"), ("serial", "demodulated"), ("can", "demodulated")]
)
def test_the_demo_over_a_link_gives_the_same_maps(
    link: str, capture: str, demo_in_process: Path, tmp_path: Path
) -> None:
    if link != "serial":
        pytest.importorskip("msgpack", reason="python-can's udp_multicast needs it")
    words, settings = on_link(link, capture, tmp_path)
    run, plugin = tmp_path / "run", link.partition(" ")[0]
    # Both ends share a machine with everything else that runs: three times the patience that a bench needs.
    with emulator(tmp_path, *words, "--watchdog", "0.6", link=f"--{plugin}"):
        overrides = [word for setting in settings for word in ("--set", setting)]
        run_demo(run, "--drive", plugin, "--unattended", SAFE_BENCH_WORDS, *overrides)
    ended = messages_of(run)[-1]
    assert isinstance(ended, RunEnded)
    require_same_maps(run, demo_in_process, 2e-3, 5e-3)


def test_a_door_that_is_open_ends_a_run_before_anything_is_energised(tmp_path: Path) -> None:
    switches = tmp_path / "switches"
    switches.write_text("door")
    with emulator(tmp_path, "--speed", "max", *with_interlocks(switches)) as machine:
        result = run_tiny(tmp_path, drive={"name": "serial", "port": str(tmp_path / "line")}, stages=MEASURING)
        assert machine.events("armed") == []
    assert result.outcome.ending == "faulted"
    assert "interlock open: door; close it, and resume" in result.outcome.reason


@pytest.mark.slow
def test_a_door_that_opens_ends_a_run_with_its_name_and_closed_again_the_run_goes_on(tmp_path: Path) -> None:
    switches, run = tmp_path / "switches", tmp_path / "run"
    drive = {"name": "serial", "port": str(tmp_path / "line"), "telemetry_period_s": 0.15}
    procedure = tiny_file(tmp_path, drive=drive, stages=MEASURING)
    safe = ("--quiet", "--unattended", SAFE_BENCH_WORDS)
    with emulator(tmp_path, "--speed", "1", "--watchdog", "2", *with_interlocks(switches)) as machine:
        process = start_fluxbench("run", procedure, "--out", run, *safe)
        wait_until(lambda: list((run / "captures").glob("resistance*")) != [])
        switches.write_text("cover")
        _, errors = process.communicate()
        assert process.returncode == 3, errors
        assert sum("interlock open: cover; close it, and resume" in line for line in errors.splitlines()) == 1, errors
        assert machine.events("safe")[-1]["cause"] == "interlock"
        switches.write_text("")
        resumed = start_fluxbench("resume", run, *safe)
        _, errors = resumed.communicate()
        assert resumed.returncode == 0, errors
