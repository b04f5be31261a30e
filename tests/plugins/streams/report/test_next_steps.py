"""The page begins with what to do, and has the currents for a torque."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from orchestrator.diagnosis import SavedDiagnosis
from orchestrator.formatting.deciding import NOTHING_TO_DECIDE, experiment_to_decide
from orchestrator.formatting.quantities import quantity
from orchestrator.runs import RunRecord
from plugins.streams.report._collect import Material, Paths
from plugins.streams.report._motor_content import torque_rows
from plugins.streams.report._next_steps import next_steps
from protocols import (
    DiagnosisWords,
    DriveRecord,
    EstimationReport,
    FluxMap,
    Manifest,
    Motor,
    NextExperiment,
    Remark,
    ResistanceEstimate,
)
from tests.plugins.streams.report.example_diagnosis import WORDS, a_diagnosis

MANIFEST = Manifest(
    format="fluxbench-recording",
    version=1,
    name="m",
    created="2026-01-01T00:00:00Z",
    motor=Motor(name="m", pole_pairs=2),
    drive=DriveRecord(name="d", sampling_frequency_hz=1e4, pwm_frequency_hz=1e4, dc_bus_voltage_v=540.0),
    segments=(),
)
DECIDED = WORDS.model_copy(update={"to_decide": NOTHING_TO_DECIDE})


def an_estimate(**change: object) -> EstimationReport:
    given: dict[str, object] = {
        "resistance": None, "method": "model", "crossings": None, "parity": None, "reciprocity_percent": None,
        "classical_against_injection_percent": None, "usable": True, "reasons": [],
        "files": {"flux_map": "flux_map.nc"},
    }  # fmt: skip
    return EstimationReport.model_validate({**given, **change})


@pytest.mark.parametrize(
    ("estimates", "text"),
    [
        (None, "none yet: `fluxbench estimate runs/first` makes"),
        (
            an_estimate(),
            "use `results/flux_map.nc`; `fluxbench export runs/first` writes it for other tools, `fluxbench tune "
            "runs/first` computes",
        ),
        (an_estimate(usable=False, reasons=["the rotor turned"]), "do not rely on it: the rotor turned."),
    ],
)
def test_the_first_line_is_about_the_map(estimates: EstimationReport | None, text: str) -> None:
    about_map, about_model = next_steps(Material(Path("runs/first"), None, None, (), estimates, {}, Paths(), None, ()))
    assert about_map.text.startswith(text)
    assert about_model.text.startswith("not diagnosed: `fluxbench diagnose runs/first` names")


def test_a_run_elsewhere_is_named_without_its_place(tmp_path: Path) -> None:
    _, about_model = next_steps(Material(tmp_path / "a run", None, None, (), None, {}, Paths(), None, ()))
    assert about_model.text.startswith("not diagnosed: `fluxbench diagnose 'a run'` names")


@pytest.mark.parametrize(
    ("causes", "advice", "sizes"),
    [
        (
            ["dead_time"],
            "compensate dead time in the drive, or use model.json, which includes that.",
            ("dead time: voltage 400 mV",),
        ),
        (["hysteresis"], "use model.json for hysteresis, which few drives compensate.", ()),
        (
            ["current_offset", "rotor_misalignment", "skin_effect"],
            "compensate current offset and rotor misalignment in the drive, and use model.json for skin effect, which "
            "few drives compensate.",
            (
                "current offset: voltage 400 mV; subtract it from the readings of each sensor",
                "rotor misalignment: voltage 400 mV; add it to the angle that the drive believes, such as the "
                "encoder's offset",
                "skin effect: voltage 400 mV, sharpness −15·10⁶; to check it, measure resistance and inductance with "
                "a bridge at two frequencies, below and above the corner",
            ),
        ),
    ],
)
def test_only_what_a_drive_can_compensate_is_advised_to_be_compensated(
    causes: list[str], advice: str, sizes: tuple[str, ...]
) -> None:
    found = a_diagnosis().effects[0]
    effects = [found.model_copy(update={"name": name, "twins": ()}) for name in causes]
    saved = SavedDiagnosis(a_diagnosis(effects=effects, next_experiment=None), DECIDED, ())
    lines = next_steps(Material(Path("run"), None, None, (), an_estimate(), {}, Paths(), saved, ()))
    assert lines[-1].text == advice
    assert lines[-1].items == sizes


@pytest.mark.parametrize(
    ("change", "words", "advice"),
    [
        (
            {"twins": ("device_drop",)},
            WORDS,
            f"{WORDS.to_decide}; compensate nothing until it is known whether it is dead time or device drop",
        ),
        (
            {"twins": (), "material": False},
            DECIDED,
            "no effect is large enough to be compensated",
        ),
    ],
)
def test_twins_and_immaterial_effects_are_not_to_be_compensated(
    change: dict[str, object], words: DiagnosisWords, advice: str
) -> None:
    effect = a_diagnosis().effects[0].model_copy(update={"name": "dead_time", **change})
    saved = SavedDiagnosis(a_diagnosis(effects=[effect], next_experiment=None), words, ())
    lines = next_steps(Material(Path("run"), None, None, (), an_estimate(), {}, Paths(), saved, ()))
    assert lines[-1].text.startswith(advice)


def test_a_named_effect_that_is_too_small_to_matter_is_said_to_be() -> None:
    found = a_diagnosis().effects[0].model_copy(update={"twins": ()})
    small = found.model_copy(update={"name": "current_gain_mismatch", "material": False})
    saved = SavedDiagnosis(a_diagnosis(effects=[found, small], next_experiment=None), DECIDED, ())
    lines = next_steps(Material(Path("run"), None, None, (), an_estimate(), {}, Paths(), saved, ()))
    assert lines[-1].text.endswith("; current gain mismatch, named too, is too small to matter.")


def test_a_usable_map_has_its_accuracy_beside_it_and_what_no_run_shows() -> None:
    r_s = {"value_ohm": 2.0, "low": 1.99, "high": 2.01, "first_ohm": 2.0, "last_ohm": 2.0}
    known = an_estimate(resistance=ResistanceEstimate.model_validate(r_s), classical_against_injection_percent=0.16)
    about_map, accuracy, _ = next_steps(Material(Path("r"), None, None, (), known, {}, Paths(), None, ()))
    assert about_map.text.startswith("use ")
    assert "R_s ±0.5 %, 95 % and of the readings' noise alone" in accuracy.text
    assert "differ by 0.16 % of the rated flux" in accuracy.text
    assert "sensors' gain and the bus voltage's error, which no run shows, come on top" in accuracy.text


def test_the_diagnosis_of_a_sealed_motor_is_said_to_give_it_away(tmp_path: Path) -> None:
    run = Material(tmp_path, None, None, (), None, {}, Paths(), None, ())
    assert "away" not in next_steps(run)[-1].text
    sealed = cast("RunRecord", SimpleNamespace(sealed=("plant",)))
    assert "and gives most of what is hidden in this motor away" in next_steps(replace(run, record=sealed))[-1].text


def test_what_is_entered_as_compensation_is_never_a_value_for_the_inverter_s_own_dead_time() -> None:
    found = a_diagnosis().effects[0].model_dump()
    effect = {
        **found,
        "twins": (),
        "derived": {"dead_time": {"value": 2.03e-7, "low": None, "high": None, "unit": "s"}},
    }
    saved = SavedDiagnosis(a_diagnosis(effects=[effect], next_experiment=None), WORDS, ())
    advice = "dead time: enter 203 ns as compensation, or voltage 400 mV{}; leave the inverter's own dead time as it is"
    for manifest, where in ((None, ""), (MANIFEST, " at 10 kHz and 540 V")):
        lines = next_steps(Material(Path("run"), manifest, None, (), an_estimate(), {}, Paths(), saved, ()))
        assert lines[-1].items == (advice.format(where),)


def test_nothing_is_compensated_while_another_effect_fits_better_in_place() -> None:
    effect = a_diagnosis().effects[0].model_copy(update={"twins": ()})
    doubt = Remark(code="fits_better_in_place", text="device drop fits better")
    report = a_diagnosis(effects=[effect], next_experiment=None).model_copy(update={"remarks": (doubt,)})
    lines = next_steps(
        Material(Path("run"), None, None, (), an_estimate(), {}, Paths(), SavedDiagnosis(report, WORDS, ()), ())
    )
    assert lines[-1].text.endswith("; compensate nothing until then.")


@pytest.mark.parametrize(
    "verdict",
    ["explained", "explained_in_another_form", "mostly_explained", "unknown_remains", "cannot_tell"],
)
def test_what_the_diagnosis_leaves_to_decide_is_what_to_do_now(verdict: str) -> None:
    words = WORDS.model_copy(update={"to_decide": "`fluxbench diagnose RUN --without skin_effect`: hysteresis fits"})
    effects = [a_diagnosis().effects[0].model_copy(update={"twins": ()})]
    saved = SavedDiagnosis(a_diagnosis(verdict=verdict, effects=effects, next_experiment=None), words, ())
    lines = next_steps(Material(Path("run"), None, None, (), an_estimate(), {}, Paths(), saved, ()))
    assert lines[-1].text.startswith("`fluxbench diagnose run --without skin_effect`: hysteresis fits")


def test_the_proposed_experiment_is_the_command_that_makes_it_unless_something_comes_first() -> None:
    stage = {"kind": "resistance"}
    proposal = NextExperiment.model_validate({"stage": stage, "separates": ["dead_time", "device_drop"], "minutes": 1})
    for to_decide, text in (
        (experiment_to_decide(proposal), "`fluxbench run --from run` measures 60 s more, to tell dead time from"),
        ("threshold of dead_time: at its bound", "threshold of dead_time: at its bound; "),
    ):
        words = WORDS.model_copy(update={"to_decide": to_decide})
        saved = SavedDiagnosis(a_diagnosis(next_experiment=proposal.model_dump()), words, ())
        lines = next_steps(Material(Path("run"), None, None, (), an_estimate(), {}, Paths(), saved, ()))
        assert lines[-1].text.startswith(text)


def test_a_model_that_was_changed_since_the_diagnosis_is_reported() -> None:
    saved, changes = SavedDiagnosis(a_diagnosis(), WORDS, ()), ("+ dead time (does not help)",)
    lines = next_steps(Material(Path("run"), None, None, (), an_estimate(), {}, Paths(), saved, (), changes))
    assert [line.label for line in lines] == ["The map", "Changed", "The model"]
    assert "since the diagnosis: + dead time (does not help). R_s and the map are of model.json" in lines[1].text


def test_each_torque_has_its_shortest_current() -> None:
    i_d, i_q = np.linspace(-4.0, 4.0, 33), np.linspace(-4.0, 4.0, 33)
    d, q = np.meshgrid(i_d, i_q, indexing="ij")
    none = np.full(d.shape, np.nan)
    found = FluxMap(
        method="ideal", i_d=i_d, i_q=i_q, psi_d=0.3 + 0.04 * d, psi_q=0.04 * q, l_dd=none, l_dq=none, l_qq=none,
        psi_d_std=none, psi_q_std=none, l_dd_std=none, l_dq_std=none, l_qq_std=none,
    )  # fmt: skip
    motor = Motor(name="m", pole_pairs=2, pm_flux_wb=0.3)
    rows = torque_rows(found, motor)
    torques_nm = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5]
    assert [row[0] for row in rows] == [quantity(torque_nm, "Nm") for torque_nm in torques_nm]
    lengths_a = [float(row[3].removesuffix(" A")) for row in rows]
    assert lengths_a == pytest.approx([torque_nm / (1.5 * 2 * 0.3) for torque_nm in torques_nm], abs=0.01)
    assert all(abs(float(row[4].removesuffix("°").replace("−", "-")) - 90.0) < 2.0 for row in rows)  # no reluctance
    assert torque_rows(found, motor.model_copy(update={"pm_flux_wb": None})) == []


def test_the_experiment_is_measured_before_the_drive_compensates_what_is_certain() -> None:
    found = a_diagnosis().effects[0]
    angle = {"angle_rad": {"value": 0.0454, "low": 0.04, "high": 0.05, "unit": "rad"}}
    turned = found.model_dump() | {"name": "rotor_misalignment", "twins": (), "parameters": angle}
    report = a_diagnosis(effects=[found, turned])
    proposed = report.next_experiment
    assert proposed is not None
    words = WORDS.model_copy(update={"to_decide": experiment_to_decide(proposed)})
    saved = SavedDiagnosis(report, words, ())
    line = next_steps(Material(Path("run"), None, None, (), an_estimate(), {}, Paths(), saved, ()))[-1]
    assert line.text.startswith("`fluxbench run --from run` measures")
    assert "; then compensate rotor misalignment in the drive" in line.text
    assert [item.partition("; add it to the angle")[0] for item in line.items] == [
        "rotor misalignment: angle 45.4 mrad (2.6°)"
    ]
