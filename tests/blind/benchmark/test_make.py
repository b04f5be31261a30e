"""The set is made from seeds: the same bits, the same truths, and no truth among the recordings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from orchestrator.benchmark import Row, data_sha256, frozen_rows
from orchestrator.benchmark.scorer import read_truths
from orchestrator.importing import import_files
from orchestrator.recording import open_recording
from tests.blind.benchmark import plants
from tests.blind.benchmark.make import make_one, make_set
from tests.blind.campaign import Campaign
from tests.blind.foreign.cases import draw_case

TINY = Campaign(
    second_pwm=False,
    classical=False,
    second_amplitude=False,
    anchors=False,
    injection=False,
    dwell_s=0.01,
    short_s=0.01,
)
ROW = Row("r900", "single", "blind", "single", 5, 1, "servo_48v", "tiny", "", False)


@pytest.fixture(autouse=True)
def _tiny_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(plants.CAMPAIGNS, "tiny", TINY)


def test_a_recording_made_twice_is_the_same_bit_by_bit(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    assert make_set([ROW], first) == make_set([ROW], second) == []
    assert (first / "benchmark.json").read_bytes() == (second / "benchmark.json").read_bytes()
    for file in sorted(path.relative_to(first) for path in first.rglob("*.*") if path.is_file()):
        assert (first / file).read_bytes() == (second / file).read_bytes(), file
    manifest, truths = read_truths(first / "truth")
    assert truths["r900"]["effects"][0]["name"] == "current_gain_mismatch"
    assert "current_gain_mismatch" not in json.dumps(manifest["recordings"])
    assert "gain" not in (first / "recordings" / "r900" / "recording.json").read_text()


def test_what_differs_from_the_frozen_hashes_is_named(tmp_path: Path) -> None:
    (remark,) = make_set([replace(ROW, data_sha256="0" * 64)], tmp_path)
    assert remark == "r900: data differs from that of version 1"


def test_a_recording_that_was_changed_since_is_noticed(tmp_path: Path) -> None:
    assert make_set([ROW], tmp_path) == []
    entry = json.loads((tmp_path / "benchmark.json").read_text())["recordings"][0]
    frozen = replace(ROW, data_sha256=entry["data_sha256"], truth_sha256=entry["truth_sha256"])
    assert make_set([frozen], tmp_path) == []
    file = tmp_path / "recordings" / "r900" / "recording.json"
    file.write_text(file.read_text().replace("48 V servo", "49 V servo"))
    assert make_set([frozen], tmp_path) == ["r900: data differs from that of version 1"]


def test_a_log_is_imported_as_the_recording_that_it_was_made_from(tmp_path: Path) -> None:
    for name in ("recordings", "truth"):
        (tmp_path / name).mkdir()
    make_one(ROW, tmp_path)
    make_one(replace(ROW, id="r901", log=True), tmp_path)
    log = tmp_path / "recordings" / "r901"
    import_files(log / "mapping.yaml", [log / "log.csv"], tmp_path / "imported")
    made, imported = open_recording(tmp_path / "recordings" / "r900"), open_recording(tmp_path / "imported")
    assert [s.samples for s in made.manifest.segments] == [s.samples for s in imported.manifest.segments]
    assert made.manifest.motor == imported.manifest.motor
    for one, other in zip(made.manifest.segments, imported.manifest.segments, strict=True):
        assert abs(made.load(one).i_ab - imported.load(other).i_ab).max() < 1e-5
        assert abs(made.load(one).v_ab - imported.load(other).v_ab).max() < 1e-3


@pytest.mark.slow
def test_the_table_says_whose_motor_a_drawn_case_has() -> None:
    rows = [row for row in frozen_rows() if row.plant == "foreign"]
    assert all(draw_case(row.case, row.index, row.seed).family == row.motor for row in rows[::6])


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["blind", "foreign", "motulator"])
def test_the_first_recordings_of_each_plant_are_the_frozen_ones(plant: str, tmp_path: Path) -> None:
    if plant == "motulator":
        pytest.importorskip("motulator")
    rows = [row for row in frozen_rows() if row.plant == plant][:2]
    assert make_set(rows, tmp_path) == []
    assert data_sha256(tmp_path / "recordings" / rows[0].id) == rows[0].data_sha256
