"""A pass's files are one set, whenever it is killed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

from orchestrator.estimation import estimate_recording
from protocols import EstimationReport
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.orchestrator.estimation.made_up import RECORDING, Mapper, Ripples, Sweeps
from tests.support.cases import few


class Killed(BaseException):
    """Stands for SIGKILL: nothing of the pass is called any more."""


def named(name: str) -> MemoryRecording:
    return MemoryRecording(RECORDING.manifest.model_copy(update={"name": name}), {})


def test_a_second_pass_replaces_the_first_as_a_whole(tmp_path: Path) -> None:
    estimate_recording(named("first"), [Sweeps(), Mapper("other")], tmp_path)
    (tmp_path / "results" / "diagnosis.json").write_text("{}")
    estimate_recording(named("second"), [Ripples()], tmp_path)
    left = {path.name for path in (tmp_path / "results").iterdir()}
    assert left == {"flux_map.nc", "estimates.json", "diagnosis.json"}


def test_a_pass_that_finds_the_same_leaves_the_files_as_old_as_they_are(tmp_path: Path) -> None:
    results = tmp_path / "results"

    def ages() -> dict[str, int]:
        return {path.name: path.stat().st_mtime_ns for path in results.iterdir()}

    first = estimate_recording(named("first"), [Sweeps(), Ripples()], tmp_path)
    before = ages()
    assert estimate_recording(named("first"), [Sweeps(), Ripples()], tmp_path) == first
    assert ages() == before
    estimate_recording(named("first"), [Sweeps(), Ripples(factor=0.9)], tmp_path)
    assert all(age > before[name] for name, age in ages().items())
    changed = ages()
    (results / "flux_map_stray.nc").write_bytes(b"of another pass")
    estimate_recording(named("first"), [Sweeps(), Ripples(factor=0.9)], tmp_path)
    assert set(ages()) == set(changed)


@few("step", range(7), fast=3)
def test_a_kill_leaves_no_report_beside_maps_of_another_pass(
    step: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = [Sweeps(), Ripples()]
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
    second = [Ripples(factor=0.9), Mapper("other")]
    with suppress(Killed):
        estimate_recording(named("second"), second, tmp_path)
    monkeypatch.undo()
    file = tmp_path / "results" / "estimates.json"
    if not file.exists():
        return
    reported = EstimationReport.model_validate_json(file.read_bytes())
    is_old = file.read_bytes() == before
    for name, path in reported.files.items():
        if name != "estimates":
            with xr.open_dataset(tmp_path / "results" / path, engine="h5netcdf") as dataset:
                assert dataset.attrs["recording"] == ("first" if is_old else "second")
    maps = {path.name for path in (tmp_path / "results").glob("flux_map*.nc")}
    assert maps == {Path(path).name for name, path in reported.files.items() if name != "estimates"}


def test_a_kill_was_really_tried_at_every_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = list[str]()
    estimate_recording(named("first"), [Sweeps(), Ripples()], tmp_path)
    for name in ("unlink", "replace"):
        real = getattr(Path, name)

        def noted(path: Path, *args: Any, real: Callable[..., Any] = real, **options: Any) -> Any:
            if path.parent.name == "results" or (args and Path(args[0]).parent.name == "results"):
                done.append(path.name)
            return real(path, *args, **options)

        monkeypatch.setattr(Path, name, noted)
    estimate_recording(named("second"), [Ripples(), Mapper("other")], tmp_path)
    assert len(done) == 6
    assert done[0] == "estimates.json"
    assert done[-1].startswith(".estimates.json.")
