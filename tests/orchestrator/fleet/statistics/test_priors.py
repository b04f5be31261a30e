"""What a fleet lets expect of its next motor."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from orchestrator.fleet.statistics import fleet_of, priors_of
from orchestrator.recording import read_json
from protocols import InputError, RecordingError
from protocols.fleet_priors import FleetPriors
from tests.orchestrator.fleet.statistics.example_fleet import Fleet, effect, table_of, written
from tests.support.processes import called

IMBALANCE = "phase_resistance_imbalance"


def priors(fleet: Fleet, motor: str | None = None) -> FleetPriors:
    return priors_of(fleet_of(table_of(fleet.rows()), "line"), motor)


def without_effects(row: dict[str, Any]) -> None:
    row["effects"] = ()


def faulty(row: dict[str, Any]) -> None:
    row["effects"] = (effect(IMBALANCE, "extra_b_ohm", 1.5, 0.004, "ohm"),)


def unexplained(row: dict[str, Any]) -> None:
    row["verdict"] = "unknown_remains"
    row["effects"] = (effect("dead_time", "voltage_v", 2.0, 0.2, "V"),)


def test_sizes_spreads_and_frequencies_are_those_of_the_fleet() -> None:
    prior = priors(Fleet(100, changes=dict.fromkeys(range(0, 100, 4), without_effects)))
    one = prior.effects[IMBALANCE]
    assert (one.found, one.asked) == (75, 100)
    assert one.probability == pytest.approx(76 / 102)
    size = one.sizes["extra_b_ohm"]
    assert size.mean == pytest.approx(0.020, abs=0.003)
    assert size.std == pytest.approx(0.010, rel=0.25)
    assert size.unit == "ohm"
    assert prior.resistance is not None
    assert prior.resistance.mean == pytest.approx(4.285, rel=0.004)
    assert prior.d_inductance is not None
    assert prior.d_inductance.std == pytest.approx(0.01 * 0.0433, rel=0.25)
    assert (prior.motor, prior.recordings, prior.diagnosed) == ("pm400", 100, 100)


def test_faults_and_unexplained_recordings_are_no_property_of_the_kind() -> None:
    changes = {**dict.fromkeys(range(5), faulty), **dict.fromkeys(range(5, 20), unexplained)}
    prior = priors(Fleet(100, changes=changes))
    assert prior.diagnosed == 85
    assert set(prior.effects) == {IMBALANCE}
    size = prior.effects[IMBALANCE].sizes["extra_b_ohm"]
    assert size.recordings == 80
    assert size.std < 0.015


def test_one_kind_of_motor_is_chosen_where_there_are_several() -> None:
    def other(row: dict[str, Any]) -> None:
        row["motor"] = "pm750"

    fleet = Fleet(40, changes=dict.fromkeys(range(0, 40, 2), other))
    with pytest.raises(InputError, match="2 kinds of motor: choose one by --motor") as error:
        priors(fleet)
    assert error.value.choices == ("pm400", "pm750")
    assert priors(fleet, "pm750").recordings == 20
    with pytest.raises(InputError, match="no 'pm75'; did you mean 'pm750'"):
        priors(fleet, "pm75")


def test_too_few_say_so() -> None:
    with pytest.raises(InputError, match=r"5 diagnosed and explained recordings of one kind.*expected 8"):
        priors(Fleet(5))


def test_the_file_is_written_and_read_strictly(tmp_path: Path) -> None:
    table, out = written(Fleet(30).rows(), tmp_path / "fleet.parquet"), tmp_path / "priors.json"
    done = called("fleet", "priors", table, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "phase resistance imbalance: extra b  30 of 30  0.969" in done.stdout
    prior = read_json(out, FleetPriors)
    assert prior == priors_of(fleet_of(table_of(Fleet(30).rows()), str(table)))
    raw = json.loads(out.read_text())
    raw["effects"][IMBALANCE]["sizes"]["extra_b_ohm"]["std"] = -1.0
    out.write_text(json.dumps(raw))
    with pytest.raises(RecordingError, match=r"sizes.extra_b_ohm.std: .*greater than 0"):
        read_json(out, FleetPriors)
    done = called("diagnose", tmp_path, "--priors", out)
    assert done.returncode == 2
