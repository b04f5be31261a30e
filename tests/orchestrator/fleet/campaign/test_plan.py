"""A campaign's file: what it multiplies out to, and what is wrong with it in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.fleet.campaign import check_runs, load_campaign, runs_of
from protocols import FluxbenchError, InputError

HEAD = "format: fluxbench-campaign\nversion: 1\nname: power\nprocedures: [quick]\n"
WHOLE = (
    HEAD
    + """
hidden:
  - {}
  - dead_time: {voltage_v: [0.1, 1.0], threshold_a: 0.08}
    voltage_delay: {delay_s: [1e-5, 2e-5, 3e-5]}
seeds: 4
plant: {sensors: {noise_a: 0.01}}
settings: {limits.current_a: 4.0}
"""
)


def written(folder: Path, text: str) -> Path:
    file = folder / "campaign.yaml"
    file.write_text(text)
    return file


def test_lists_are_multiplied_out_and_seeds_come_last(tmp_path: Path) -> None:
    plan = load_campaign(written(tmp_path, WHOLE))
    runs = list(runs_of(plan))
    assert len(runs) == plan.runs() == 4 * (1 + 2 * 3)
    assert [run.condition.seed for run in runs[:7]] == [1] * 7
    assert runs[0].condition.label == "quick, 400 W test PMSM, nothing hidden"
    assert runs[6].condition.hidden == {
        "dead_time": {"voltage_v": 1.0, "threshold_a": 0.08},
        "voltage_delay": {"delay_s": 3e-5},
    }
    options = runs[6].procedure.drive.options
    assert options["plant"]["effects"] == runs[6].condition.hidden
    assert options["plant"]["sensors"] == {"noise_a": 0.01}
    assert options["plant"]["magnetics"] == {"kind": "nameplate"}
    assert runs[6].procedure.limits.current_a == 4.0
    assert runs[6].procedure.seed == 1
    assert runs[-1].procedure.seed == 4


def test_a_key_tells_runs_apart_and_is_the_same_tomorrow(tmp_path: Path) -> None:
    plan = load_campaign(written(tmp_path, WHOLE))
    keys = [run.key(plan.analysis(), "1") for run in runs_of(plan)]
    assert len(set(keys)) == len(keys)
    assert keys == [run.key(plan.analysis(), "1") for run in runs_of(load_campaign(tmp_path / "campaign.yaml"))]
    assert not set(keys) & {run.key(plan.analysis(), "2") for run in runs_of(plan)}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("hidden: [{ded_time: {voltage_v: 1.0}}]", "did you mean 'dead_time'"),
        ("hidden: [{}, {dead_time: {voltage: [0.1, 1.0]}}]", "did you mean 'voltage_v'"),
        ("hidden: [{}]\nplant: {sensor: {noise_a: 0.01}}", "did you mean 'sensors'"),
    ],
)
def test_an_option_that_the_drive_lacks_is_refused_before_any_run(tmp_path: Path, wrong: str, message: str) -> None:
    runs = list(runs_of(load_campaign(written(tmp_path, f"{HEAD}{wrong}\n"))))
    with pytest.raises(FluxbenchError) as raised:
        check_runs(runs)
    assert raised.value.exit_code == 2
    assert message in str(raised.value)
    check_runs(runs_of(load_campaign(written(tmp_path, WHOLE))))


def test_variants_are_multiplied_out_and_separated(tmp_path: Path) -> None:
    """A tolerance study: the motor differs from its nameplate, which stays as it is."""
    more = "hidden: [{}]\nvariants: [{}, {drive.plant.resistance_ohm: [4.0, 4.5], limits.current_a: 4.0}]\n"
    runs = list(runs_of(load_campaign(written(tmp_path, HEAD + more))))
    found = [run.procedure.drive.options["plant"].get("resistance_ohm") for run in runs]
    assert found == [None, 4.0, 4.5]
    assert [run.procedure.limits.current_a for run in runs][1:] == [4.0, 4.0]
    assert {run.procedure.motor.stator_resistance_ohm for run in runs} == {4.25}
    assert [run.condition.variant for run in runs[:2]] == [
        "",
        "drive.plant.resistance_ohm=4.0 limits.current_a=4.0",
    ]
    assert runs[1].condition.variant in runs[1].condition.label
    assert len({run.key(load_campaign(tmp_path / "campaign.yaml").analysis(), "1") for run in runs}) == 3
    check_runs(runs)


def test_files_are_looked_for_beside_it(tmp_path: Path) -> None:
    motor = Path("docs/motors/servo-48v.yaml").read_text()
    (tmp_path / "servo.yaml").write_text(motor)
    plan = load_campaign(written(tmp_path, HEAD + "motors: [null, servo.yaml]\nhidden: [{}]\n"))
    assert [run.condition.motor for run in runs_of(plan)] == ["400 W test PMSM", "servo"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD, "hidden"),
        (HEAD + "hidden: [{}]\nsedes: 3\n", "campaign.yaml:6: sedes"),
        (HEAD + "hidden: [{}]\ndo: [export]\n", "got export"),
        (HEAD + "hidden: [{dead_time: {voltage_v: []}}]\n", "voltage_v"),
        (HEAD.replace("quick", "quack") + "hidden: [{}]\n", "quack"),
        (HEAD + "hidden: [{}]\ndo: []\n", "do"),
        (HEAD + "hidden: [{}]\nseeds: 18446744073709551616\n", "seeds"),
        (
            HEAD + f"hidden: [{{dead_time: {{voltage_v: {[1.0] * 2000}, threshold_a: {[1.0] * 2000}}}}}]\n",
            "4000000 runs",
        ),
        (HEAD + "hidden: [{}]\ndrive: {name: 1}\n", "drive.name"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as raised:
        list(runs_of(load_campaign(written(tmp_path, text))))
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)
