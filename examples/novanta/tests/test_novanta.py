"""The drive `novanta` on its maker's virtual drive, whose motor is R and L in both axes; skipped without it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml

pytest.importorskip("virtual_drive", reason="the maker's virtual drive is not installed")

from fluxbench_novanta import NovantaDrive, NovantaOptions
from virtual_drive.constants import R_VALUE
from virtual_drive.core import VirtualDrive
from virtual_drive.resources import VIRTUAL_DRIVE_V2_XDF

from orchestrator.config import load_procedure
from orchestrator.engine import SAFE_BENCH_WORDS, AbsentOperator, Interrupts, RunServices, start_run
from orchestrator.testing import DriveConformance
from protocols import Drive, DriveFault, DriveRefused, DriveSetup, InputError, Motor

MOTOR: dict[str, Any] = {
    "name": "virtual motor",
    "pole_pairs": 1,
    "rated_current_rms_a": 5.0,
    "stator_resistance_ohm": 1.1,
}


@pytest.fixture(scope="module")
def drive() -> Iterator[Any]:
    virtual = VirtualDrive(dictionary_path=VIRTUAL_DRIVE_V2_XDF)
    virtual.start()
    yield virtual
    virtual.stop()


def setup_at(virtual: Any, motor: dict[str, Any] = MOTOR) -> DriveSetup:
    options = NovantaOptions(host="127.0.0.1", port=virtual.port, dictionary=Path(VIRTUAL_DRIVE_V2_XDF))
    return DriveSetup(motor=Motor(**motor), options=options, seed=1)


class TestNovanta(DriveConformance):
    """Everything that is checked of a drive that claims `hold`."""

    virtual: ClassVar[Any]

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _running(cls) -> Iterator[None]:
        cls.virtual = VirtualDrive(dictionary_path=VIRTUAL_DRIVE_V2_XDF)
        cls.virtual.start()
        yield
        cls.virtual.stop()

    def make_drive(self, setup: DriveSetup) -> Drive:
        return NovantaDrive(setup)

    def setup(self) -> DriveSetup:
        return setup_at(self.virtual)


def test_a_procedure_finds_the_resistance(drive: Any, tmp_path: Path) -> None:
    options = {"host": "127.0.0.1", "port": drive.port, "dictionary": str(VIRTUAL_DRIVE_V2_XDF)}
    points = [[6, 0], [-2, 0], [0, 4], [-6, 0], [0, 2], [-4, 0]]
    document = {
        "format": "fluxbench-procedure",
        "version": 1,
        "name": "resistance",
        "motor": MOTOR,
        "drive": {"name": "novanta", **options},
        "limits": {"current_a": 8.0, "voltage_v": 20.0},
        "accept_no_watchdog": "I stand beside the drive and can cut its power",
        "stages": [
            {"kind": "resistance", "points_a": points, "settle_s": 0.2, "duration_s": 0.2},
            {"kind": "estimate"},
        ],
    }
    file = tmp_path / "procedure.yaml"
    file.write_text(yaml.safe_dump(document), encoding="utf-8")
    result = start_run(
        load_procedure(str(file)), tmp_path / "run", RunServices(AbsentOperator(SAFE_BENCH_WORDS), Interrupts())
    )
    assert result.outcome.ending == "finished", result.outcome.reason
    found = json.loads((tmp_path / "run" / "results" / "estimates.json").read_text())
    assert found["resistance"]["value_ohm"] == pytest.approx(R_VALUE, rel=0.01)


def test_what_does_not_fit_is_refused(drive: Any) -> None:
    other = NovantaDrive(setup_at(drive, {**MOTOR, "pole_pairs": 4}))
    with pytest.raises(DriveRefused, match="MOT_PAIR_POLES is 1"):
        other.connect()
    other.close()


def test_nobody_there_and_no_dictionary_are_told(drive: Any, tmp_path: Path) -> None:
    setup = setup_at(drive)
    nowhere = setup.options.model_copy(update={"dictionary": tmp_path / "none.xdf"})
    with pytest.raises(InputError, match="no file"):
        NovantaDrive(setup.model_copy(update={"options": nowhere})).connect()
    nobody = setup.options.model_copy(update={"port": 9})
    with pytest.raises(DriveFault, match="Novanta drive at 127"):
        NovantaDrive(setup.model_copy(update={"options": nobody})).connect()
