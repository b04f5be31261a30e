"""The report opens with the motor, and its pictures are of the delivered map."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orchestrator.diagnosis import SavedDiagnosis
from orchestrator.flux_maps.exporting import mtpa, mtpv
from orchestrator.formatting.quantities import quantity
from orchestrator.numerics.tables import cubic_value_at
from orchestrator.runs import RunDirectory
from plugins.streams.report._collect import Material, Paths, collect
from plugins.streams.report._motor_content import COPPER_COEFFICIENT_PER_K, motor_lines, resistance_rows, torque_rows
from plugins.streams.report._page import render
from protocols import About, Remark
from tests.plugins.streams.example_run import a_run_directory
from tests.plugins.streams.report.example_diagnosis import WORDS, a_diagnosis, some_steps


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return a_run_directory(tmp_path_factory.mktemp("motor") / "run")


@pytest.fixture
def material(run: Path, monkeypatch: pytest.MonkeyPatch) -> Material:
    for module in ("_figures", "_diagnosis_figures"):
        monkeypatch.setattr(f"plugins.streams.report.{module}.uri", lambda figure: "data:image/svg+xml;base64,")
    return collect(run)


def lines(material: Material) -> dict[str, str]:
    return {line.label: line.text for line in motor_lines(material)}


def test_the_page_opens_with_the_motor_and_says_where_what_is(material: Material) -> None:
    page = render(material)
    assert (
        0
        < page.index("<nav")
        < page.index("What to do now")
        < page.index("<h2>Summary</h2>")
        < page.index('id="in-short"')
    )
    for target in re.findall(r'<a href="#([a-z-]+)">', page):
        assert f'id="{target}"' in page, target
    titles = re.findall(r"<h3>([^<]+)</h3>", page)
    assert {"Torque", "ψ_d over the current plane", "ψ_q over the current plane", "Saliency angle"} <= set(titles)


def test_the_torque_picture_names_the_curves_that_it_draws(material: Material) -> None:
    shown = next(iter(material.maps.values()))
    caption = re.search(r"In Nm[^<]*", render(material))
    assert caption is not None
    for name, curve in (("MTPA", mtpa(shown, 4)), ("MTPV", mtpv(shown, 4))):
        assert (name in caption[0]) == bool(curve.interior.any())


def test_torque_is_the_map_s_at_the_best_angle_of_the_rated_current(material: Material) -> None:
    manifest = material.manifest
    assert manifest is not None
    motor = manifest.motor
    assert motor.rated_current_a
    assert motor.pm_flux_wb
    torque = lines(material)["Torque at rated current"]
    found = float(torque.split(" Nm")[0])
    # Magnet alone, all of the current on q: reluctance adds a little to that, or nothing.
    magnet = 1.5 * motor.pole_pairs * motor.pm_flux_wb * motor.rated_current_a
    assert 0.95 * magnet < found < 1.3 * magnet
    assert {"R_s", "L_dd, L_qq at no current", "Saliency", "ψ of the magnet"} <= set(lines(material))


def test_incremental_and_apparent_inductances_are_told_apart(material: Material) -> None:
    shown = lines(material)
    assert shown["L_dd, L_qq at rated i_q"].endswith("incremental (∂ψ/∂i)")
    manifest = material.manifest
    assert manifest is not None
    rated_a = manifest.motor.rated_current_a
    assert rated_a
    grid = next(iter(material.maps.values()))
    fluxes = (cubic_value_at((grid.i_d, grid.i_q), grid.psi_q, 0.0, i_q) for i_q in (0.0, rated_a))
    at_rest, flux = (float(value) for value in fluxes if value is not None)
    assert f"L_q {quantity((flux - at_rest) / rated_a, 'H', 4)} at i_q" in shown["Apparent"]


def test_the_model_s_resistance_says_when_it_holds(material: Material) -> None:
    assert "by the model" not in lines(material)["R_s"]
    estimates = material.estimates
    assert estimates is not None
    assert estimates.resistance is not None
    remark = Remark(code="model.of_the_model", text="model: R_s is that of the whole model")
    of_model = estimates.resistance.model_copy(update={"remarks": (remark,)})
    changed = replace(material, estimates=estimates.model_copy(update={"resistance": of_model}))
    assert " at 0 s, by the model; nameplate 4.25 Ω" in lines(changed)["R_s"]


def test_other_values_of_the_resistance_say_why_they_differ(material: Material) -> None:
    estimates = material.estimates
    assert estimates is not None
    assert estimates.resistance is not None
    assert [row[1] for row in resistance_rows(material)] == ["the readings at constant current"]
    remark = Remark(code="model.of_the_model", text="model: R_s is that of the whole model")
    of_model = estimates.resistance.model_copy(update={"remarks": (remark,), "last_ohm": 1.7})
    diagnosed = estimates.model_copy(update={"resistance": of_model, "estimators": estimates})
    before, after = some_steps()
    assert before.resistance is not None
    larger = before.resistance.model_copy(update={"model_ohm": 1.1 * before.resistance.model_ohm})
    steps = (before.model_copy(update={"resistance": larger}), after)
    changed = replace(material, estimates=diagnosed, diagnosis=SavedDiagnosis(a_diagnosis(), WORDS, steps))
    rows = resistance_rows(changed)
    assert rows[0] == resistance_rows(material)[0]  # the readings, not the model at their times
    assert [row[1] for row in rows] == [
        "the readings at constant current",
        "the estimators, all readings together",
        "the model before any effect was added",
    ]
    assert all(why for *_, why in rows)


def test_currents_beyond_the_rating_are_marked(material: Material) -> None:
    assert material.manifest is not None
    grid, motor = next(iter(material.maps.values())), material.manifest.motor
    rows = torque_rows(grid, motor.model_copy(update={"rated_torque_nm": 1.2}))
    assert [row[-1] for row in rows if float(row[0].split()[0]) in (1.0, 1.5)] == [
        "",
        "beyond the rated torque of 1.2 Nm",
    ]
    slow = motor.model_copy(update={"rated_torque_nm": None, "rated_current_rms_a": 1.0})
    assert torque_rows(grid, slow)[-1][-1] == "beyond the rated current of 1.41 A"


def test_the_resistance_at_20_c_needs_to_know_how_warm_the_room_was(material: Material, run: Path) -> None:
    assert "assuming 20 °C when the run began, as its temperature is not known" in lines(material)["R_s at 20 °C"]
    record = RunDirectory.open(run).record
    procedure = record.procedure.model_copy(update={"about": About(ambient_c=45.0)})
    warm = Material(**{**vars(material), "record": record.model_copy(update={"procedure": procedure})})
    assert material.estimates is not None
    read = material.estimates.resistance
    assert read is not None
    assert not read.is_of_model
    to_20_c = 1.0 / (1.0 + 25.0 * COPPER_COEFFICIENT_PER_K)
    assert lines(warm)["R_s at 20 °C"].startswith(f"{read.first_ohm * to_20_c:.4g} Ω")
    # A model's R_s is that of the cold winding; by the first reading a current has warmed it.
    remark = Remark.of("model.of_the_model", "by the model")
    of_model = read.model_copy(update={"value_ohm": 0.99 * read.first_ohm, "remarks": (remark,)})
    fitted = replace(warm, estimates=material.estimates.model_copy(update={"resistance": of_model}))
    assert lines(fitted)["R_s at 20 °C"].startswith(f"{0.99 * read.first_ohm * to_20_c:.4g} Ω")


@pytest.mark.slow
def test_a_recorded_temperature_is_drawn_over_time(material: Material) -> None:
    assert "Temperature over the run" not in render(material)
    warm = Paths(temperature_c=np.array([[0.0, 21.0], [60.0, 24.0]]))
    assert "Temperature over the run" in render(Material(**{**vars(material), "paths": warm}))


def test_a_rotor_that_turned_says_its_magnet(material: Material) -> None:
    assert material.estimates is not None
    assert "a locked rotor does not show it" in lines(material)["ψ of the magnet"]
    remark = Remark.of("spin.magnet_flux", "psi_M = {flux_wb} Wb (+-{std_wb})", flux_wb=0.2876, std_wb=0.0001)
    turned = material.estimates.model_copy(update={"remarks": (*material.estimates.remarks, remark)})
    line = lines(Material(**{**vars(material), "estimates": turned}))["ψ of the magnet"]
    assert line.startswith("287.6 mWb ± 196 µWb (95 %), by the back-EMF; nameplate 300 mWb")


@pytest.mark.slow
def test_voltage_steps_and_a_turning_rotor_are_drawn_where_their_currents_were(material: Material) -> None:
    paths = Paths(steps=(np.array([[0.0, 0.0], [1.0, 0.5]]),) * 3, spin=np.array([[-1.0, 1.0], [0.0, 1.0]]))
    page = render(Material(**{**vars(material), "paths": paths}))
    assert "3 captures of voltage steps and 2 points of a rotor that turns, as measured." in page
    assert "Not drawn: neither sweeps, steps" in render(Material(**{**vars(material), "paths": Paths()}))


def test_a_logged_temperature_gives_the_resistance_at_20_c(material: Material) -> None:
    logged = replace(material.paths, temperature_c=np.array([[0.0, 45.0], [10.0, 60.0]]))
    text = lines(replace(material, record=None, paths=logged))["R_s at 20 °C"]
    assert text.endswith("by the first logged temperature, 45.0 °C")
    assert "`temperature` in the import's mapping" in lines(replace(material, record=None))["R_s at 20 °C"]
