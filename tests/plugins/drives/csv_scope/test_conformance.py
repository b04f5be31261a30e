"""The drive `csv_scope` under the kit: a script plays each file on a simulated motor, and brings one back."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import pytest

from orchestrator.testing import DriveConformance
from plugins.drives.csv_scope import CsvScopeDrive, CsvScopeOptions
from protocols import Drive, DriveSetup, Motor
from tests.plugins.drives.csv_scope.player import Player
from tests.support.tiny import MOTOR


class TestCsvScope(DriveConformance):
    player: ClassVar[Player]

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _played(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        with Player(tmp_path_factory.mktemp("exchange"), Motor(**MOTOR)) as cls.player:
            yield

    def make_drive(self, setup: DriveSetup) -> Drive:
        return CsvScopeDrive(setup)

    def setup(self) -> DriveSetup:
        return DriveSetup(motor=Motor(**MOTOR), options=CsvScopeOptions(**options_for(self.player)), seed=1)

    def bridge_is_on(self, drive: Drive) -> bool:
        return self.player.drive.state.value == "armed"


def options_for(player: Player) -> dict[str, Any]:
    says = player.capabilities
    return {
        "folder": player.folder,
        "mapping": player.folder / "mapping.yaml",
        "sampling_frequency_hz": says.sampling_frequency_hz,
        "dc_bus_voltage_v": says.dc_bus_voltage_v,
        "max_current_a": says.max_current_a,
        "steady_s": 0.0,
    }
