"""A campaign's file: what it multiplies out to, and what is wrong with it in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.campaign import load_campaign, runs_of
from protocols import InputError

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


def test_files_are_looked_for_beside_it(tmp_path: Path) -> None:
    motor = Path("docs/motors/servo-48v.yaml").read_text()
    (tmp_path / "servo.yaml").write_text(motor)
    plan = load_campaign(written(tmp_path, HEAD + "motors: [null, servo.yaml]\nhidden: [{}]\n"))
    assert [run.condition.motor for run in runs_of(plan)] == ["400 W test PMSM", "servo"]


@pytest.mark.parametrize(
    ("text", "told"),
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
def test_what_is_wrong_is_one_line(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(InputError) as raised:
        list(runs_of(load_campaign(written(tmp_path, text))))
    assert told in str(raised.value)
    assert "\n" not in str(raised.value)
