"""The benches whose motor time is measured, and the tables of it; the runs themselves take too long."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.config import check_plan, make_plan
from plugins.drives.simulated import SimulatedDrive, SimulatedOptions
from protocols import DriveSetup
from tests.motor_time.measuring import BENCHES, PLANS, Bench, Known, procedure_on
from tests.motor_time.picture import course, draw, table
from tests.support.cases import few

KNOWN = {
    "a motor": [
        Known("demo", 81.0, 25, 0.03, 0.06, "model"),
        Known("paper", 5115.0, 915, 0.016, 0.029, "energy"),
        *(Known("on the way", 8.0 + n, 9 + 4 * n, 0.2 / (n + 1), 0.4, "stage", (0.5, 0.7)) for n in range(6)),
    ]
}


@few("bench", BENCHES, ids=[bench.words for bench in BENCHES])
def test_every_procedure_fits_every_bench(bench: Bench) -> None:
    for name in (*PLANS, "adaptive"):
        procedure = procedure_on(bench, name)
        options = SimulatedOptions.model_validate(procedure.drive.options)
        drive = SimulatedDrive(DriveSetup(motor=procedure.motor, options=options, seed=1))
        capabilities = drive.connect()
        check_plan(make_plan(procedure, capabilities), capabilities)
        drive.close()
        rated_a = procedure.motor.rated_current_a
        assert rated_a is not None
        held = max(point.excitation.longest_current_a for point in make_plan(procedure, capabilities).points)
        assert 1.2 * rated_a < held < 2.0 * rated_a


def test_tables_are_in_the_order_of_time_and_grow_sparse() -> None:
    assert [line.split("|")[2].strip() for line in table(KNOWN).splitlines()[2:]] == ["demo", "paper"]
    assert [line.split("|")[3].strip() for line in course(KNOWN).splitlines()[2:]] == ["9", "13", "17", "25"]


@pytest.mark.slow
def test_the_picture_is_one(tmp_path: Path) -> None:
    draw(KNOWN, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
