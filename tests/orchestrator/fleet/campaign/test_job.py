"""Virtual commissionings: simulated, analysed, and the truth laid beside the answer when that is in."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.fleet import FleetTable
from orchestrator.fleet.campaign import CampaignJob, load_campaign, runs_of
from protocols.fleet import FleetRow
from tests.support.processes import called
from tests.support.tiny import tiny_file

RESTS = [
    {"kind": "gates_off", "duration_s": 0.02},
    {"kind": "resistance", "points_a": [[1.0, 0.0], [-1.0, 0.0], [2.0, 0.0]], "settle_s": 0.1, "duration_s": 0.05},
]
CAMPAIGN = """
format: fluxbench-campaign
version: 1
name: power
procedures: [{procedure}]
hidden: [{{}}, {{dead_time: {{voltage_v: 2.5}}}}]
do: [estimate]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    procedure = tiny_file(tmp_path, stages=RESTS)
    path = tmp_path / "campaign.yaml"
    path.write_text(CAMPAIGN.format(procedure=procedure.name))
    return path


def done(file: Path, table: Path, folder: Path, keep: bool) -> list[FleetRow]:
    plan = load_campaign(file)
    runs = list(runs_of(plan))
    with FleetTable.opened(table) as held:
        job = CampaignJob(runs, held, plan.analysis(), folder, keep=keep)
        rows = list(job.rows())
        assert not CampaignJob(runs, held, plan.analysis(), folder).todo
    return rows


def test_the_truth_is_in_the_table_and_nowhere_beside_the_recordings(file: Path, tmp_path: Path) -> None:
    rows = done(file, tmp_path / "table", tmp_path / "kept", keep=True)
    assert [row.failed for row in rows] == [None, None]
    hidden = {row.key: [(t.name, t.parameter, t.size) for t in row.hidden or ()] for row in rows}
    assert sorted(hidden.values()) == [[], [("dead_time", "voltage_v", 2.5)]]
    assert all(row.R_s_ohm is not None for row in rows)
    assert all(row.started_at is None for row in rows)
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == sorted(hidden)
    for path in (tmp_path / "kept").rglob("*"):
        assert path.is_dir() or b"dead_time" not in path.read_bytes()
    assert done(file, tmp_path / "table", tmp_path / "kept", keep=True) == []


def test_a_variant_is_a_batch_and_what_is_the_same_twice_is_run_once(file: Path, tmp_path: Path) -> None:
    """A tolerance study: the truth is another than the nameplate's, and that is found."""
    base = file.read_text().replace("hidden: [{}, {dead_time: {voltage_v: 2.5}}]", "hidden: [{}, {}]")
    file.write_text(f"{base}variants: [{{drive.plant.resistance_ohm: [4.0, 4.5]}}]\n")
    rows = done(file, tmp_path / "table", tmp_path / "kept", keep=False)
    found = {row.batch: row.R_s_ohm for row in rows}
    assert found == {
        "drive.plant.resistance_ohm=4.0": pytest.approx(4.0, rel=0.01),
        "drive.plant.resistance_ohm=4.5": pytest.approx(4.5, rel=0.01),
    }
    assert len(rows) == 2


@pytest.mark.slow
def test_one_command_is_the_whole_campaign(file: Path, tmp_path: Path) -> None:
    words = ("campaign", file, "--out", tmp_path / "table", "--jobs", "1")
    first = called(*words)
    assert (first.returncode, first.stderr) == (0, "")
    assert "2 of 2 virtual commissionings" in first.stdout
    assert list((tmp_path / "table" / ".recordings").iterdir()) == []
    again = called(*words, "--json")
    assert '"runs": 2' in again.stdout
