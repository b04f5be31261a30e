"""The drive `xcp` under the kit: pyxcp, our routine in an ECU of our own, a motor in software."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Literal

import pytest

from orchestrator.testing import DriveConformance

pytest.importorskip("pyxcp", reason="the XCP master is an optional extra")

from plugins.drives.xcp import XcpDrive
from protocols import Drive, DriveSetup, Motor
from tests.plugins.drives.xcp.built import Ecu, build, running
from tests.support.tiny import MOTOR


class OnAnEcu(DriveConformance):
    """An ECU for all checks."""

    protocol: ClassVar[Literal["udp", "tcp"]]
    ecu: ClassVar[Ecu]

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _running(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        folder = tmp_path_factory.mktemp("ecu")
        with running(build(folder), folder, cls.protocol) as cls.ecu:
            yield

    def make_drive(self, setup: DriveSetup) -> Drive:
        return XcpDrive(setup)

    def setup(self) -> DriveSetup:
        return DriveSetup(motor=Motor(**MOTOR), options=self.ecu.options, seed=1)

    def bridge_is_on(self, drive: Drive) -> bool:
        return self.ecu.gates_are_on


@pytest.mark.slow
class TestXcpOverUdp(OnAnEcu):
    protocol = "udp"


@pytest.mark.slow
class TestXcpOverTcp(OnAnEcu):
    protocol = "tcp"
