"""`model.json` is a model: evaluated without a refit, extended, reduced, and held against another recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.diagnosis import add_effects, compare_recording, flux_map_of, remove_effect
from orchestrator.diagnosis.reporting.motor_model import magnetics_of
from orchestrator.recording import Recording, read_model, write_model
from plugins.effects.frame import RotorMisalignment
from plugins.effects.inverter import DeviceDrop, VoltageBias
from protocols import Effect, FluxMap, GivenMap, MotorModel, Nameplate, PluginError, RecordingError, Saturated

LIBRARY: list[Effect] = [DeviceDrop(), VoltageBias(), RotorMisalignment()]
SAME = 1e-9
"""Relative: the same computation on what went through a file."""
REFITTED = 3e-3
"""Relative: a fit ends a little before its noise model has followed it to the end."""


@pytest.mark.slow
def test_the_kept_model_holds_every_parameter_of_its_effects(kept: Path) -> None:
    (effect,) = read_model(kept).effects
    assert set(effect.parameters) == {p.name for p in DeviceDrop.Parameters.declared()}
    voltage, unfitted = effect.parameters["voltage_v"], [p for p in effect.parameters.values() if not p.fitted]
    assert voltage.fitted
    assert voltage.low is not None
    assert voltage.high is not None
    assert voltage.low < 0.8 < voltage.high
    assert all(p.low is None and p.high is None for p in unfitted)


def test_a_comparison_fits_nothing(with_dead_time: Recording, kept: Path, tmp_path: Path) -> None:
    model = read_model(kept)
    off = model.model_copy(update={"r_s_ohm": 1.02 * model.r_s_ohm})
    own, report = (compare_recording(with_dead_time, LIBRARY, model=m) for m in (model, off))
    assert own.chi2 is not None
    assert report.chi2 is not None
    assert report.chi2 > 10.0 * own.chi2


@pytest.mark.slow
def test_an_added_effect_grows_the_ladder_from_where_the_model_stands(
    with_dead_time: Recording, kept: Path, tmp_path: Path
) -> None:
    (tmp_path / "model.json").write_bytes((kept / "model.json").read_bytes())
    before = read_model(tmp_path).ladder
    after = add_effects(with_dead_time, ["voltage_bias"], LIBRARY, out=tmp_path).ladder
    assert [r.added for r in after] == [None, "device_drop", "voltage_bias"]
    assert after[0] == before[0]
    assert after[1].chi2 == pytest.approx(before[1].chi2, rel=REFITTED)
    left = remove_effect(with_dead_time, "device_drop", LIBRARY, out=tmp_path)
    assert [r.added for r in left.ladder] == [None, "voltage_bias"]
    assert left.ladder[0].chi2 == pytest.approx(before[0].chi2, rel=SAME)
    assert [e.name for e in read_model(tmp_path).effects] == ["voltage_bias"]


@pytest.mark.slow
def test_an_effect_without_a_rung_of_its_own_is_taken_out_and_stays_beside_others(
    with_dead_time: Recording, kept: Path, tmp_path: Path
) -> None:
    (tmp_path / "model.json").write_bytes((kept / "model.json").read_bytes())
    add_effects(with_dead_time, ["voltage_bias"], LIBRARY, out=tmp_path)
    both = read_model(tmp_path)
    ladder = (both.ladder[0], both.ladder[2].model_copy(update={"added": "device_drop"}))
    beside = both.model_copy(update={"ladder": ladder})
    write_model(tmp_path, beside)
    left = remove_effect(with_dead_time, "voltage_bias", LIBRARY, out=tmp_path)
    assert [r.added for r in left.ladder] == [None, "device_drop"]
    assert [e.name for e in read_model(tmp_path).effects] == ["device_drop"]
    write_model(tmp_path, beside)
    remove_effect(with_dead_time, "device_drop", LIBRARY, out=tmp_path)
    assert [e.name for e in read_model(tmp_path).effects] == ["voltage_bias"]


@pytest.mark.slow
def test_the_map_is_let_go_and_held_again(with_dead_time: Recording, tmp_path: Path) -> None:
    add_effects(with_dead_time, ["device_drop"], LIBRARY, model="linear", out=tmp_path)
    grown = add_effects(with_dead_time, ["saturation"], LIBRARY, out=tmp_path)
    assert [r.added for r in grown.ladder] == [None, "device_drop", "saturation"]
    assert read_model(tmp_path).baseline == Nameplate(freed=("saturation",))
    chi2 = [r.chi2 or 0.0 for r in grown.ladder]
    assert chi2[2] < 0.5 * chi2[1]
    back = remove_effect(with_dead_time, "saturation", LIBRARY, out=tmp_path)
    assert read_model(tmp_path).baseline == Nameplate()
    assert back.ladder[-1].chi2 == pytest.approx(chi2[1], rel=0.01)


@pytest.mark.slow
def test_a_map_of_one_s_own_stays_the_baseline(with_dead_time: Recording, kept: Path, tmp_path: Path) -> None:
    own = flux_map_of(read_model(kept)).model_copy(update={"method": "mine"})
    add_effects(with_dead_time, [], LIBRARY, model=own, out=tmp_path)
    coefficients = read_model(tmp_path).magnetics.coefficients_j
    add_effects(with_dead_time, ["device_drop"], LIBRARY, out=tmp_path)
    model = read_model(tmp_path)
    assert model.baseline == GivenMap(method="mine")
    assert model.title == "map:mine + device_drop"
    assert model.magnetics.coefficients_j == coefficients
    chi2 = compare_recording(with_dead_time, LIBRARY, out=tmp_path).chi2
    assert chi2 is not None
    assert chi2 < 1.5


@pytest.mark.slow
def test_a_model_is_held_against_another_recording_of_the_motor(clean: Recording, kept: Path, tmp_path: Path) -> None:
    model = read_model(kept)
    report = compare_recording(clean, LIBRARY, model=model)
    assert any("fitted to" in note for note in report.notes)
    bare = compare_recording(clean, LIBRARY, model=model.model_copy(update={"effects": ()}))
    # The other recording's inverter loses nothing, and the motor is the same.
    assert bare.chi2 is not None
    assert report.chi2 is not None
    assert bare.chi2 < 2.0 < report.chi2
    refitted = add_effects(clean, [], LIBRARY, model=model, out=tmp_path)
    assert [r.added for r in refitted.ladder] == [None, "device_drop"]
    assert refitted.effects[0].parameters["voltage_v"].value == pytest.approx(0.0, abs=0.005)
    assert read_model(tmp_path).baseline == GivenMap(method=f"model of {model.recording}")


def test_an_effect_that_is_not_installed_is_named(with_dead_time: Recording, kept: Path) -> None:
    with pytest.raises(PluginError, match="device_drop: in the model, but not installed"):
        compare_recording(with_dead_time, [VoltageBias()], out=kept)


def test_the_exported_map_is_the_model_s_where_it_was_measured(kept: Path) -> None:
    model = read_model(kept)
    flux_map = flux_map_of(model)
    assert isinstance(flux_map, FluxMap)
    d, q = int(np.argmin(np.abs(flux_map.i_d))), int(np.argmin(np.abs(flux_map.i_q)))
    assert flux_map.psi_q[d, q] == pytest.approx(0.0, abs=1e-4 * float(np.nanmax(flux_map.psi_q)))
    corners = np.array(model.magnetics.measured_hull_a)
    outside = np.abs(flux_map.i_q)[None, :] > np.abs(corners[:, 1]).max() + 1e-6
    assert np.isnan(flux_map.psi_d[np.broadcast_to(outside, flux_map.psi_d.shape)]).all()
    assert 0.2 < np.isfinite(flux_map.psi_d).mean() < 1.0
    # Slopes of the flux are the inductances: central differences over a fine enough grid.
    slope = np.gradient(flux_map.psi_d, flux_map.i_d, axis=0)
    inner = np.isfinite(slope)
    assert np.abs(slope - flux_map.l_dd)[inner].max() < 0.1 * float(np.nanmax(flux_map.l_dd))


def test_what_is_kept_is_what_is_read(kept: Path) -> None:
    model = read_model(kept)
    assert isinstance(model.baseline, Saturated)
    assert MotorModel.model_validate_json(model.model_dump_json()) == model


def test_coefficients_that_do_not_fit_the_grid_are_refused(kept: Path, tmp_path: Path) -> None:
    content = json.loads((kept / "model.json").read_text())
    content["magnetics"]["d_intervals"] += 1
    (tmp_path / "model.json").write_text(json.dumps(content))
    with pytest.raises(RecordingError, match=r"magnetics: expected \d+ coefficients_j"):
        read_model(tmp_path)


def test_the_page_evaluates_the_map_as_the_diagnosis_does(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[4] / "docs" / "model.md").read_text(encoding="utf-8")
    monkeypatch.chdir(kept)
    shown: dict[str, Any] = {}
    exec(page.split("```python\n")[1].split("```")[0], shown)
    model = read_model(kept)
    magnetics = magnetics_of(model.magnetics)
    psi = magnetics.flux_and_inductance(np.array([[1.0, 1.0], [0.0, 0.0]]))[0]
    expected = psi[0] - psi[1] + np.array([model.pm_flux_wb, 0.0])
    assert np.array([shown["psi_d"], shown["psi_q"]]) == pytest.approx(expected, rel=1e-9)
