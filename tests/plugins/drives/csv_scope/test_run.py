"""A whole run through a folder, and what its player says has gone wrong."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

from orchestrator.config import load_procedure
from orchestrator.engine import AbsentOperator, Interrupts, RunResult, RunServices, start_run
from orchestrator.recording import open_recording
from plugins.drives.csv_scope._tables import COLUMNS, table_of
from protocols import DriveFault, FaultCause, Injection, Motor, SegmentStage, Trapezoid
from tests.plugins.drives.csv_scope.player import Player
from tests.plugins.drives.csv_scope.test_conformance import options_for
from tests.support.tiny import MOTOR, STAGES, tiny_document


@pytest.fixture
def player(tmp_path: Path) -> Iterator[Player]:
    folder = tmp_path / "exchange"
    folder.mkdir()
    with Player(folder, Motor(**MOTOR)) as playing:
        yield playing


def run(folder: Path, player: Player, *kinds: str) -> RunResult:
    options = {name: str(x) if isinstance(x, Path) else x for name, x in options_for(player).items()}
    stages = [stage for stage in STAGES if stage["kind"] in kinds]
    document = tiny_document(drive={"name": "csv_scope", **options}, stages=stages)
    document["accept_no_watchdog"] = "I stand beside the drive and can cut its power"
    (folder / "procedure.yaml").write_text(yaml.safe_dump(document), encoding="utf-8")
    return start_run(
        load_procedure(str(folder / "procedure.yaml")), folder / "run", RunServices(AbsentOperator(), Interrupts())
    )


def test_a_procedure_is_measured_file_by_file(tmp_path: Path, player: Player) -> None:
    result = run(tmp_path, player, "gates_off", "resistance", "injection")
    assert result.outcome.ending == "finished", result.outcome
    recording = open_recording(result.path)
    assert len(recording.segments()) == 1 + 4 + 6
    first = recording.load(recording.segments(SegmentStage.RESISTANCE)[0])
    np.testing.assert_allclose(first.i_ab.mean(axis=0), (-1.0, 0.0), atol=0.02)
    starts = [segment.start_s for segment in recording.segments()]
    assert starts == sorted(starts)
    assert (player.folder / "0002.table.csv").read_text(encoding="utf-8").startswith(",".join(COLUMNS))


def test_what_the_player_says_is_wrong_ends_the_run(tmp_path: Path, player: Player) -> None:
    player.faults["0003"] = "overcurrent: the inverter tripped\n"
    error = run(tmp_path, player, "resistance").outcome.error
    assert isinstance(error, DriveFault)
    assert error.cause is FaultCause.OVERCURRENT
    assert "the inverter tripped" in error.detail


def test_tables_say_what_is_to_be_played_row_by_row() -> None:
    sweep = Trapezoid(swept_axis="q", held_a=1.0, amplitude_a=2.0, period_s=0.8, periods=1, settle_s=0.1)
    table = table_of(sweep, 1000.0)
    assert table.shape == (900, len(COLUMNS))
    np.testing.assert_allclose(table[[0, 100, 200, 399], 3:5], [(1, 0), (1, 0), (1, 2), (1, 2)], atol=0.02)
    injection = Injection(
        target_d_a=1.0,
        target_q_a=0.0,
        settle_s=0.1,
        discard_s=0.02,
        duration_s=0.1,
        amplitude_v=10.0,
        frequency_hz=100.0,
        rotation_hz=0.0,
    )
    table = table_of(injection, 1000.0)
    assert table[:, 2].tolist() == [1.0] * 100 + [0.0] * 120
    assert table[100:110, 5].tolist() == [10.0] * 5 + [-10.0] * 5
    assert table[:, 7].sum() == 100
