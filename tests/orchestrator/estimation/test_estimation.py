"""The pass over a recording, with estimators that are made up."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
import xarray as xr

from orchestrator.estimation import estimate_recording
from protocols import (
    AxisPercent,
    DriveRecord,
    Estimate,
    EstimationContext,
    EstimationReport,
    FluxMapEstimate,
    FluxPoints,
    Manifest,
    MapChecks,
    Motor,
    NotMeasuredError,
    PluginError,
    RecordingReader,
    Remark,
    ResistanceEstimate,
    ResistanceReading,
)
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.orchestrator.analysis.test_checks_and_files import exact_map

RECORDING = MemoryRecording(
    Manifest(
        format="fluxbench-recording",
        version=1,
        name="made up",
        created="2026-01-01",
        motor=Motor(name="m", pole_pairs=2, rated_current_rms_a=1.66),
        drive=DriveRecord(name="d", sampling_frequency_hz=1e4, dc_bus_voltage_v=540.0),
        segments=(),
    ),
    {},
)
R_S = ResistanceEstimate(
    value_ohm=4.0,
    low=3.9,
    high=4.1,
    first_ohm=4.0,
    last_ohm=4.2,
    readings=(
        ResistanceReading(start_s=1.0, value_ohm=4.0, std_ohm=0.01),
        ResistanceReading(start_s=9.0, value_ohm=4.2, std_ohm=0.01),
    ),
)


class Resistance:
    name: ClassVar[str] = "resistance"
    summary: ClassVar[str] = "made up"
    produces: ClassVar[Literal["resistance", "flux_map"]] = "resistance"

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
        return R_S


class Mapper:
    summary: ClassVar[str] = "made up"
    produces: ClassVar[Literal["resistance", "flux_map"]] = "flux_map"

    def __init__(self, name: str, checks: MapChecks | None = None, missing: bool = False, factor: float = 1.0) -> None:
        self.name = name  # type: ignore[misc]
        self.checks, self.missing, self.factor = checks or MapChecks(), missing, factor
        self.saw: EstimationContext | None = None

    name: ClassVar[str] = ""

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
        self.saw = context
        if self.missing:
            raise NotMeasuredError("made up", "segments", f"no {self.name} here")
        points = FluxPoints(i_dq=np.zeros((1, 2)), psi_dq=np.zeros((1, 2)), segment=("a",))
        exact = exact_map(self.name)
        scaled = {"psi_d": 0.3 + self.factor * (exact.psi_d - 0.3), "psi_q": self.factor * exact.psi_q}
        said = (Remark(code="noted", text="a note"),)
        return FluxMapEstimate(map=exact.model_copy(update=scaled), points=points, checks=self.checks, remarks=said)


def numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [n for v in value.values() for n in numbers(v)]
    if isinstance(value, list):
        return [n for v in value for n in numbers(v)]
    return [value] if isinstance(value, float) else []


def test_resistance_comes_first_and_the_rest_sees_it(tmp_path: Path) -> None:
    mapper, heard = Mapper("classical"), list[Estimate]()
    estimate_recording(RECORDING, [mapper, Resistance()], tmp_path, on_estimate=heard.append)
    assert mapper.saw is not None
    assert mapper.saw.resistance is R_S
    assert [type(estimate) for estimate in heard] == [ResistanceEstimate, FluxMapEstimate]


def test_injection_is_recommended_and_every_map_has_its_file(tmp_path: Path) -> None:
    report = estimate_recording(RECORDING, [Mapper("other"), Mapper("classical"), Mapper("injection")], tmp_path)
    assert report.method == "injection"
    names = {path.name for path in (tmp_path / "results").iterdir()}
    assert names == {"flux_map.nc", "flux_map_classical.nc", "flux_map_other.nc", "estimates.json"}
    assert {Path(path).name for path in report.files.values()} == names
    assert report.classical_against_injection_percent == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("factor", "method"), [(0.99, "energy"), (0.9, "injection")])
def test_an_energy_is_recommended_where_it_explains_the_measurements(
    factor: float, method: str, tmp_path: Path
) -> None:
    energy = Mapper("energy", factor=factor)
    report = estimate_recording(RECORDING, [energy, Mapper("injection")], tmp_path)
    assert report.method == method
    assert energy.saw is not None
    assert "injection" in energy.saw.maps


@pytest.mark.parametrize(("factor", "words"), [(0.95, "5.0 % less flux"), (1.03, "3.0 % more flux"), (0.995, "")])
def test_a_difference_of_the_methods_is_put_in_words(factor: float, words: str, tmp_path: Path) -> None:
    report = estimate_recording(RECORDING, [Mapper("classical"), Mapper("injection", factor=factor)], tmp_path)
    told = [reason for reason in report.reasons if "injection gives" in reason]
    assert report.usable
    assert len(told) == (1 if words else 0)
    assert all(words in reason for reason in told)
    assert all(("hysteresis" in reason) == (factor < 1.0) for reason in told)


def test_the_file_is_the_report_and_all_its_numbers_are_finite(tmp_path: Path) -> None:
    checks = MapChecks(crossings=AxisPercent(d_percent=1.0, q_percent=None), reciprocity_percent=0.5)
    report = estimate_recording(RECORDING, [Resistance(), Mapper("classical", checks)], tmp_path)
    text = (tmp_path / "results" / "estimates.json").read_text()
    assert EstimationReport.model_validate_json(text) == report
    written = json.loads(text, parse_constant=lambda constant: pytest.fail(constant))
    assert all(math.isfinite(n) for n in numbers(written))
    told = written["resistance"]
    assert {key: told[key] for key in ("value_ohm", "low", "high", "first_ohm", "last_ohm")} == {
        "value_ohm": 4.0,
        "low": 3.9,
        "high": 4.1,
        "first_ohm": 4.0,
        "last_ohm": 4.2,
    }
    assert told["readings"] == [
        {"start_s": 1.0, "value_ohm": 4.0, "std_ohm": 0.01},
        {"start_s": 9.0, "value_ohm": 4.2, "std_ohm": 0.01},
    ]
    rise = told["temperature_rise_k"]
    assert rise["value"] == pytest.approx(0.05 / 0.00393)
    assert rise["low"] < rise["value"] < rise["high"]
    assert written["classical_against_injection_percent"] is None
    assert written["usable"] is True


def test_what_could_not_be_measured_is_a_reason(tmp_path: Path) -> None:
    report = estimate_recording(RECORDING, [Mapper("injection", missing=True), Mapper("classical")], tmp_path)
    assert report.method == "classical"
    assert report.usable
    assert any("no injection here" in reason for reason in report.reasons)


def test_a_map_that_contradicts_itself_is_not_usable(tmp_path: Path) -> None:
    checks = MapChecks(crossings=AxisPercent(d_percent=1.0, q_percent=12.0))
    report = estimate_recording(RECORDING, [Mapper("injection", checks)], tmp_path)
    assert not report.usable
    assert "psi_q differs by 12.0 %" in report.reasons[0]


def test_nothing_at_all_is_one_clear_line_and_no_file(tmp_path: Path) -> None:
    with pytest.raises(NotMeasuredError, match=r"made up: nothing can be estimated: .*no injection here") as told:
        estimate_recording(RECORDING, [Mapper("injection", missing=True)], tmp_path)
    assert "\n" not in str(told.value)
    assert list(tmp_path.iterdir()) == []


def test_an_estimator_that_returns_something_else_is_named(tmp_path: Path) -> None:
    class Wrong(Resistance):
        name: ClassVar[str] = "wrong"

        def estimate(self, recording: RecordingReader, context: EstimationContext) -> Any:
            return 4.0

    with pytest.raises(PluginError, match="wrong"):
        estimate_recording(RECORDING, [Wrong()], tmp_path)


class Killed(BaseException):
    """Stands for SIGKILL: nothing of the pass is called any more."""


def named(name: str) -> MemoryRecording:
    return MemoryRecording(RECORDING.manifest.model_copy(update={"name": name}), {})


def test_a_second_pass_replaces_the_first_as_a_whole(tmp_path: Path) -> None:
    estimate_recording(named("first"), [Mapper("classical"), Mapper("other")], tmp_path)
    (tmp_path / "results" / "diagnosis.json").write_text("{}")
    estimate_recording(named("second"), [Mapper("injection")], tmp_path)
    left = {path.name for path in (tmp_path / "results").iterdir()}
    assert left == {"flux_map.nc", "estimates.json", "diagnosis.json"}


@pytest.mark.parametrize("step", range(7))
def test_a_kill_leaves_no_report_beside_maps_of_another_pass(
    step: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = [Mapper("classical"), Mapper("injection")]
    estimate_recording(named("first"), first, tmp_path)
    before, steps = (tmp_path / "results" / "estimates.json").read_bytes(), iter(range(100))

    def mortal(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(path: Path, *args: Any, **options: Any) -> Any:
            if path.parent.name == "results" or (args and Path(args[0]).parent.name == "results"):
                here = next(steps)
                if here >= step:
                    raise Killed
            return real(path, *args, **options)

        return call

    for name in ("unlink", "replace"):
        monkeypatch.setattr(Path, name, mortal(getattr(Path, name)))
    second = [Mapper("injection", factor=0.9), Mapper("other")]
    with suppress(Killed):
        estimate_recording(named("second"), second, tmp_path)
    monkeypatch.undo()
    file = tmp_path / "results" / "estimates.json"
    if not file.exists():
        return
    told = EstimationReport.model_validate_json(file.read_bytes())
    is_old = file.read_bytes() == before
    for name, path in told.files.items():
        if name != "estimates":
            with xr.open_dataset(path, engine="h5netcdf") as dataset:
                assert dataset.attrs["recording"] == ("first" if is_old else "second")
    maps = {path.name for path in (tmp_path / "results").glob("flux_map*.nc")}
    assert maps == {Path(path).name for name, path in told.files.items() if name != "estimates"}


def test_a_kill_was_really_tried_at_every_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = list[str]()
    estimate_recording(named("first"), [Mapper("classical"), Mapper("injection")], tmp_path)
    for name in ("unlink", "replace"):
        real = getattr(Path, name)

        def noted(path: Path, *args: Any, real: Callable[..., Any] = real, **options: Any) -> Any:
            if path.parent.name == "results" or (args and Path(args[0]).parent.name == "results"):
                done.append(path.name)
            return real(path, *args, **options)

        monkeypatch.setattr(Path, name, noted)
    estimate_recording(named("second"), [Mapper("injection"), Mapper("other")], tmp_path)
    assert len(done) == 6
    assert done[0] == "estimates.json"
    assert done[-1] == ".estimates.json.partial"
