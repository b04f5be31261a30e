"""The estimators on whole runs of the simulated drive: motors of other sizes and kinds, against the plant's truth.

The truth comes from the plant's own options; the estimators see the recording alone.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from orchestrator.analysis import rated_flux_wb
from orchestrator.config import load_procedure
from orchestrator.engine import AbsentOperator, Interrupts, RunServices, start_run
from orchestrator.recording import open_recording
from plugins.drives.simulated import SimulatedOptions, TrueMagnetics, map_motor, true_flux
from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.energy import EnergyEstimator
from plugins.estimators.injection import InjectionEstimator
from plugins.estimators.resistance import ResistanceEstimator
from protocols import EstimationContext, FluxMap, FluxMapEstimate, Motor, Procedure, ResistanceEstimate

MOTORS = Path(__file__).parents[3] / "docs" / "motors"


def run(folder: Path, overrides: tuple[str, ...] = (), motor: Path | None = None) -> Procedure:
    """Run the demo, without its own estimates, into `folder`."""
    procedure = load_procedure("demo", overrides=overrides, motor=motor)
    stages = tuple(stage for stage in procedure.stages if stage.kind not in ("estimate", "diagnose"))
    procedure = procedure.model_copy(update={"stages": stages})
    start_run(procedure, folder, RunServices(AbsentOperator(), Interrupts()))
    return procedure


def estimated(folder: Path) -> tuple[ResistanceEstimate, dict[str, FluxMapEstimate]]:
    recording = open_recording(folder)
    resistance = ResistanceEstimator().estimate(recording, EstimationContext())
    maps: dict[str, FluxMapEstimate] = {}
    for estimator in (ClassicalEstimator(), InjectionEstimator(), EnergyEstimator()):
        maps[estimator.name] = estimator.estimate(recording, EstimationContext((resistance, *maps.values())))
    return resistance, maps


def truth_of(procedure: Procedure) -> TrueMagnetics:
    return true_flux(SimulatedOptions.model_validate(procedure.drive.options), procedure.motor)


def errors(flux_map: FluxMap, truth: TrueMagnetics, motor: Motor) -> tuple[np.ndarray, np.ndarray]:
    """Flux errors and their stated standard deviations where the map is known, (n, 2) each, in % of the rated flux."""
    grid = np.stack(np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij"), axis=-1).reshape(-1, 2)
    psi = np.column_stack([flux_map.psi_d.ravel() - (motor.pm_flux_wb or 0.0), flux_map.psi_q.ravel()])
    std = np.column_stack([flux_map.psi_d_std.ravel(), flux_map.psi_q_std.ravel()])
    known = np.isfinite(psi).all(axis=1)
    zero = truth.flux(np.zeros((1, 2)))
    rated = float(np.linalg.norm(truth.flux(np.array([[0.0, motor.rated_current_a or 0.0]])) - zero))
    off = psi[known] - (truth.flux(grid[known].astype(np.float64)) - zero)
    return 100.0 / rated * off, 100.0 / rated * std[known]


def rms(off: np.ndarray) -> float:
    return float(np.sqrt((off**2).sum(axis=1).mean()))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["servo-48v", "interior-magnet-28kw"])
def test_motors_of_other_sizes_are_right_to_two_thousandths(name: str, tmp_path: Path) -> None:
    procedure = run(tmp_path / "run", motor=MOTORS / f"{name}.yaml")
    truth = truth_of(procedure)
    _, maps = estimated(tmp_path / "run")
    assert rms(errors(maps["injection"].map, truth, procedure.motor)[0]) < 0.3
    assert rms(errors(maps["energy"].map, truth, procedure.motor)[0]) < 0.2
    assert rms(errors(maps["classical"].map, truth, procedure.motor)[0]) < 1.5


@pytest.mark.slow
def test_a_measured_and_violently_saturated_map_is_right_to_half_a_percent(tmp_path: Path) -> None:
    motor = map_motor("baldor-5k6").model_dump(exclude_none=True)
    overlay = tmp_path / "baldor.yaml"
    overlay.write_text(
        yaml.safe_dump(
            {
                "motor": motor,
                "limits": {"current_a": 16.0, "voltage_v": 450.0, "duration_s": 300.0, "energy_j": 1e6},
                "drive": {"name": "simulated", "plant": {"magnetics": {"kind": "map", "name": "baldor-5k6"}}},
            }
        )
    )
    procedure = run(tmp_path / "run", motor=overlay)
    _, maps = estimated(tmp_path / "run")
    assert rms(errors(maps["energy"].map, truth_of(procedure), procedure.motor)[0]) < 0.5


@pytest.mark.slow
def test_iron_that_bends_between_two_points_gets_points_there(tmp_path: Path) -> None:
    """A machine whose bridges saturate within a tenth of the grid's step: by injection alone, with and without."""
    name = "ipm-femm-60c"
    motor = map_motor(name).model_dump(exclude_none=True)
    overlay = tmp_path / "motor.yaml"
    limits = {"current_a": 178.0, "voltage_v": 160.0, "duration_s": 900.0, "energy_j": 1e8}
    plant = {"magnetics": {"kind": "map", "name": name}, "sensors": {"noise_a": 0.25}}
    drive = {"name": "simulated", "plant": plant}
    overlay.write_text(yaml.safe_dump({"motor": motor, "limits": limits, "drive": drive}, allow_unicode=True))
    found = {}
    for most in (0, 24):
        folder = tmp_path / f"run-{most}"
        procedure = run(folder, (f"stages.8.most_between={most}",), motor=overlay)
        _, maps = estimated(folder)
        truth = truth_of(procedure)
        found[most] = {by: rms(errors(maps[by].map, truth, procedure.motor)[0]) for by in ("injection", "energy")}
    assert found[0]["injection"] > 5.0
    assert found[24]["injection"] < 1.0
    assert found[24]["energy"] < min(1.0, 0.2 * found[0]["energy"])


@pytest.mark.slow
def test_resistance_does_not_move_the_injections_map(tmp_path: Path) -> None:
    found = []
    for ohm in (4.25, 5.1):
        folder = tmp_path / str(ohm)
        run(folder, (f"drive.plant.resistance_ohm={ohm}", "drive.plant.sensors.noise_a=0.0"))
        found.append(InjectionEstimator().estimate(open_recording(folder), EstimationContext()).map)
    common = [np.isin(getattr(found[0], axis).round(9), getattr(found[1], axis).round(9)) for axis in ("i_d", "i_q")]
    assert all(mask.all() for mask in common)
    off = np.stack([getattr(found[0], name) - getattr(found[1], name) for name in ("psi_d", "psi_q")], axis=-1)
    rated = rated_flux_wb(found[0], 2.35)
    assert rated is not None
    assert 100.0 / rated * np.sqrt(np.nanmean((off**2).sum(axis=-1))) < 0.05


@pytest.mark.slow
def test_intervals_hold_over_forty_runs(tmp_path: Path) -> None:
    """Motors that saturate differently, behind different dead times, cold (R_s is then one number)."""
    random = np.random.default_rng(11)
    inside_flux: list[np.ndarray] = []
    inside_ohm = []
    for seed in range(40):
        d_fall, q_fall, cross = random.uniform((0.1, 0.1, 0.02), (0.5, 0.5, 0.15))
        folder = tmp_path / str(seed)
        procedure = run(
            folder,
            (
                f"seed={seed + 1}",
                f"drive.plant.magnetics.d_fall={d_fall:.3f}",
                f"drive.plant.magnetics.q_fall={q_fall:.3f}",
                f"drive.plant.magnetics.cross={cross:.3f}",
                f"drive.plant.effects.dead_time.voltage_v={random.uniform(0.0, 1.2):.3f}",
                "drive.plant.effects.winding_heating.rise_per_watt=0.0",
            ),
        )
        resistance, maps = estimated(folder)
        off, std = errors(maps["energy"].map, truth_of(procedure), procedure.motor)
        uncertain = std[:, 0] > 1e-6
        inside_flux.append((np.abs(off) < 1.96 * std)[uncertain].mean(axis=0))
        inside_ohm.append(resistance.low < 4.25 < resistance.high)
    flux = np.mean(inside_flux, axis=0)
    assert (flux > 0.88).all(), flux
    assert (flux < 0.995).all(), flux
    assert np.mean(inside_ohm) > 0.87
