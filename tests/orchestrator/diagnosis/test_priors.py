"""A diagnosis with what a fleet lets expect: sharper where the motor is one of it, unmoved where it is not."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from orchestrator.diagnosis import Criteria, diagnose_recording
from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import fit_baseline
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, scaled_library
from orchestrator.diagnosis.fitting.priors import with_priors
from orchestrator.recording import Recording
from plugins.effects.frame import RotorMisalignment
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from plugins.effects.iron import EddyCurrents
from protocols import DiagnosisStep, Effect, FoundEffect, InputError, Manifest
from protocols.fleet_priors import EffectPrior, FleetPriors, NormalPrior

ORIGIN = np.zeros((1, 2))
LIBRARY: list[Effect] = [DeadTime(), VoltageBias(), RotorMisalignment()]


def expecting(
    name: str, sizes: Mapping[str, tuple[float, float, str]], found: int = 50, motor: str | None = None
) -> FleetPriors:
    """What fifty recordings let expect of one effect."""
    reported = {p: NormalPrior(mean=m, std=s, unit=unit, recordings=found) for p, (m, s, unit) in sizes.items()}
    effect = EffectPrior(probability=(found + 1) / 52, found=found, asked=50, sizes=reported)
    return FleetPriors(motor=motor, table="line", recordings=50, diagnosed=50, effects={name: effect})


def half_width(effect: FoundEffect, parameter: str) -> float:
    reported = effect.parameters[parameter]
    assert reported.low is not None
    assert reported.high is not None
    return 0.5 * (reported.high - reported.low)


@pytest.mark.slow
def test_a_motor_of_the_fleet_is_reported_more_sharply_and_the_report_says_by_what(
    with_dead_time: Recording, tmp_path: Path
) -> None:
    plain = diagnose_recording(with_dead_time, LIBRARY, out=tmp_path).report
    # A recording alone tells it to some 0.24 mV: a fleet has to know it better to make a difference.
    priors = expecting("dead_time", {"voltage_v": (0.8, 0.0001, "V")})
    steps: list[DiagnosisStep] = []
    helped = diagnose_recording(with_dead_time, LIBRARY, out=tmp_path, priors=priors, on_step=steps.append).report
    assert [effect.name for effect in helped.effects] == [effect.name for effect in plain.effects] == ["dead_time"]
    assert half_width(helped.effects[0], "voltage_v") < half_width(plain.effects[0], "voltage_v")
    assert [step.chi2 for step in steps] == [rung.chi2 for rung in helped.ladder]
    assert helped.criteria["fleet"] == priors.model_dump(mode="json")
    assert "fleet" in [remark.code for remark in helped.remarks]
    assert "fleet" not in plain.criteria


@pytest.mark.slow
def test_what_is_unlike_the_fleet_is_found_without_it(with_dead_time: Recording, tmp_path: Path) -> None:
    plain = diagnose_recording(with_dead_time, LIBRARY, out=tmp_path).report
    priors = expecting("dead_time", {"voltage_v": (0.5, 0.01, "V")})
    helped = diagnose_recording(with_dead_time, LIBRARY, out=tmp_path, priors=priors).report
    assert [r.values["effect"] for r in helped.remarks if r.code == "unlike_the_fleet"] == ["dead_time"]
    assert helped.effects[0].parameters["voltage_v"].value == pytest.approx(
        plain.effects[0].parameters["voltage_v"].value, rel=1e-3
    )
    assert helped.criteria["fleet"]["effects"]["dead_time"]["sizes"] == {}


def test_what_the_fleet_has_and_this_motor_has_not_is_not_named(clean: Recording, tmp_path: Path) -> None:
    priors = expecting("rotor_misalignment", {"angle_rad": (0.03, 0.003, "rad")})
    report = diagnose_recording(clean, LIBRARY, out=tmp_path, priors=priors).report
    assert report.verdict == "clean"
    assert not report.effects
    assert [r.values["effect"] for r in report.remarks if r.code == "not_found_here"] == ["rotor_misalignment"]
    assert report.criteria["fleet"] == priors.model_dump(mode="json")
    assert "with what 50 recordings of a fleet let expect (line)" in report.notes


def test_a_fleets_resistance_and_inductances_are_believed_as_far_as_they_are_sharp(clean: Recording) -> None:
    plain = fit_baseline(open_for_diagnosis(clean)).model
    at_rest = plain.magnetics.flux_and_inductance(ORIGIN)[1][0]
    priors = FleetPriors(
        motor=None,
        table="line",
        recordings=50,
        diagnosed=50,
        resistance=NormalPrior(mean=plain.r_s + 0.05, std=1e-6, unit="ohm", recordings=50),
        d_inductance=NormalPrior(mean=1.02 * at_rest[0], std=1e-9, unit="H", recordings=50),
        q_inductance=NormalPrior(mean=0.99 * at_rest[2], std=1e-9, unit="H", recordings=50),
    )
    moved = fit_baseline(open_for_diagnosis(clean, fleet=priors)).model
    assert moved.r_s == pytest.approx(plain.r_s + 0.05, abs=1e-4)
    now = moved.magnetics.flux_and_inductance(ORIGIN)[1][0]
    assert now[0] == pytest.approx(1.02 * at_rest[0], rel=1e-4)
    assert now[2] == pytest.approx(0.99 * at_rest[2], rel=1e-4)


def candidates(manifest: Manifest, priors: FleetPriors, *effects: Effect) -> dict[str, CandidateEffect]:
    library = with_priors(scaled_library(effects, manifest), priors, Criteria().selection)
    return {candidate.name: candidate for candidate in library}


def test_a_prior_stands_where_the_fleet_has_it_and_odds_go_to_the_evidence(clean: Recording) -> None:
    priors = expecting("dead_time", {"voltage_v": (0.8, 0.1, "V")}, found=25)
    found = candidates(clean.manifest, priors, DeadTime(), DeviceDrop())
    there = found["dead_time"].absent().moved("voltage_v", 9.0)
    assert there.values["voltage_v"] == pytest.approx(0.9)
    assert there.prior_residual("voltage_v") == pytest.approx(1.0)
    assert found["dead_time"].prior_log_odds == pytest.approx(1.386, abs=0.01)  # from one in five to one in two
    assert not found["dead_time"].included_a_priori
    assert found["device_drop"].prior_log_odds == pytest.approx(-2.55, abs=0.01)  # none of fifty
    assert candidates(clean.manifest, expecting("dead_time", {"voltage_v": (0.8, 0.1, "V")}), DeadTime())[
        "dead_time"
    ].included_a_priori


def test_what_is_strong_when_small_has_its_inverses_prior(clean: Recording) -> None:
    priors = expecting("eddy_currents", {"core_loss_ohm": (2000.0, 100.0, "ohm")})
    candidate = candidates(clean.manifest, priors, EddyCurrents())["eddy_currents"]
    at_mean = candidate.absent().moved("core_loss_ohm", candidate.centres["core_loss_ohm"])
    assert at_mean.values["core_loss_ohm"] == pytest.approx(2000.0)
    above = at_mean.moved("core_loss_ohm", candidate.centres["core_loss_ohm"] - 1.0)
    assert above.values["core_loss_ohm"] == pytest.approx(2100.0, rel=0.01)


def test_priors_of_something_else_are_refused_in_one_line(clean: Recording, tmp_path: Path) -> None:
    for priors, reported in (
        (expecting("dead_time", {"voltage_v": (0.8, 0.1, "V")}, motor="pm750"), "motor: they are of 'pm750'"),
        (expecting("dead_time", {"voltage_v": (0.8, 0.1, "mV")}), "voltage_v.unit: expected V, got mV"),
        (expecting("dead_time", {"threshold_a": (0.1, 0.1, "A")}), "threshold_a: no amplitude of that effect"),
    ):
        with pytest.raises(InputError, match=reported):
            diagnose_recording(clean, LIBRARY, out=tmp_path, priors=priors)
