"""Recordings of a machine on paper, made once a session."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from orchestrator.diagnosis import add_effects
from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, fit_baseline
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.recording import Recording, open_recording
from plugins.drives.simulated import map_motor
from plugins.effects.inverter import DeviceDrop
from tests.support.tiny import run_tiny


def _plant() -> ModuleType:
    # importlib import mode gives tests no package: the helper beside this file is loaded by its path.
    name = "diagnosis_test_plant"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name("plant.py"))
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


def _recording(tmp_path_factory: pytest.TempPathFactory, name: str, **flaws: float) -> Recording:
    plant = _plant()
    made = plant.record(tmp_path_factory.mktemp("recordings") / name, plant.Flaws(**flaws))
    assert isinstance(made, Recording)
    return made


@pytest.fixture(scope="session")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _recording(tmp_path_factory, "clean")


@pytest.fixture(scope="session")
def with_dead_time(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _recording(tmp_path_factory, "dead-time", dead_time_v=0.8)


@pytest.fixture(scope="session")
def at_two_pwm_frequencies(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _recording(tmp_path_factory, "two-pwm", dead_time_v=0.8, second_pwm=True)


@pytest.fixture(scope="session")
def misaligned(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _recording(tmp_path_factory, "misaligned", misalignment_rad=-0.03)


@pytest.fixture(scope="session")
def drifting(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _recording(tmp_path_factory, "drifting", drift_a_per_s=0.004)


@pytest.fixture(scope="session")
def wandering(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _recording(tmp_path_factory, "wandering", misalignment_rad=-0.03, offset_scatter_a=0.002)


@pytest.fixture(scope="session")
def of_three_sensors(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _recording(tmp_path_factory, "third", third_gain=0.01)


@pytest.fixture(scope="session")
def first_of_three_sensors(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _recording(tmp_path_factory, "first", first_gain=0.01)


@pytest.fixture(scope="session")
def with_thermometer(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _recording(tmp_path_factory, "thermometer", warming_per_k=0.0035)


@pytest.fixture(scope="session")
def correlated(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _recording(tmp_path_factory, "correlated", noise_correlation=0.6)


@pytest.fixture(scope="session")
def jittering(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return _recording(tmp_path_factory, "jittering", jitter_s=8e-6)


@pytest.fixture(scope="session")
def kept(with_dead_time: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with the model of a recording whose inverter loses voltage; a drop says that too."""
    out = tmp_path_factory.mktemp("model")
    add_effects(with_dead_time, ["device_drop"], [DeviceDrop()], out=out)
    return out


SWEEPS: list[dict[str, Any]] = [
    {"kind": "gates_off", "duration_s": 0.1},
    {
        "kind": "classical",
        "axes": ["q", "d"],
        "held_a": [-80.0, -40.0, 0.0, 40.0, 80.0],
        "amplitude_a": 140.0,
        "period_s": 0.5,
        "periods": 1,
        "settle_s": 0.5,
    },
]


@pytest.fixture(scope="session")
def sharp(tmp_path_factory: pytest.TempPathFactory) -> DiagnosisSetup:
    """Sweeps of a motor whose bridges saturate within some ten amperes along i_q, nothing else the matter with it."""
    name = "ipm-femm-60c"
    motor = map_motor(name).model_dump(exclude_none=True)
    drive = {"plant": {"magnetics": {"kind": "map", "name": name}, "sensors": {"noise_a": 0.2}}}
    limits = {"current_a": 180.0, "voltage_v": 150.0, "energy_j": 1e6}
    run = run_tiny(tmp_path_factory.mktemp("sharp"), drive=drive, motor=motor, limits=limits, stages=SWEEPS)
    assert run.outcome.ending == "finished", run.outcome.reason
    return open_for_diagnosis(open_recording(run.path))


@pytest.fixture(scope="session")
def sharp_fit(sharp: DiagnosisSetup) -> Fit:
    """Its resistance and its map."""
    return fit_baseline(sharp)
