"""The drive kit on interlock inputs: passes a drive that heeds them, and fails each one that does not in one way."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from protocols import Capture, Drive, DriveFault, DriveRefused, DriveState, Excitation, FaultCause, Limits, Telemetry
from tests.orchestrator.testing.example_drive import ExampleDrive
from tests.orchestrator.testing.kit_runner import failures
from tests.orchestrator.testing.test_drive_kit import kit_for


class Guarded(ExampleDrive):
    """Two inputs; those that are open are set from outside."""

    capabilities = ExampleDrive.capabilities.model_copy(update={"interlocks": ("door", "cover")})
    open: tuple[str, ...] = ()

    def arm(self, limits: Limits) -> None:
        if self.open:
            raise DriveRefused(f"open: {self.named()}")
        super().arm(limits)

    def named(self) -> str:
        return ", ".join(self.open)

    def heed(self) -> None:
        if self.open and self.state is DriveState.ARMED:
            self.state, self.faults, self.current, self.bridge_on = DriveState.FAULTED, ("interlock",), 0j, False

    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        for block in super().execute(excitation):
            yield block
            self.heed()
            if self.faults == ("interlock",):
                raise DriveFault(FaultCause.EMERGENCY_STOP, f"open: {self.named()}")

    def telemetry(self) -> Telemetry:
        self.heed()
        return super().telemetry().model_copy(update={"open_interlocks": self.open})


class ArmsBesideAnOpenDoor(Guarded):
    def arm(self, limits: Limits) -> None:
        ExampleDrive.arm(self, limits)


class GoesOnBesideAnOpenDoor(Guarded):
    def heed(self) -> None: ...


class NamesNoInput(Guarded):
    def named(self) -> str:
        return "something"


class SaysNothingInTelemetry(Guarded):
    def telemetry(self) -> Telemetry:
        self.heed()
        return ExampleDrive.telemetry(self)


class LeavesTheBridgeOn(Guarded):
    def heed(self) -> None:
        super().heed()
        self.bridge_on = True


class ForgetsItOnClosing(Guarded):
    def telemetry(self) -> Telemetry:
        if not self.open and self.faults:
            self.clear_fault()
        return super().telemetry()


def guarded(drive: type[ExampleDrive], opens: bool = True) -> object:
    """The kit with somebody at the switches and a lamp at the bridge."""

    class Kit(type(kit_for(drive))):  # type: ignore[misc]
        def open_interlocks(self, drive: Drive, names: tuple[str, ...]) -> bool:
            if opens:
                assert isinstance(drive, Guarded)
                drive.open = names
            return opens

        def bridge_is_on(self, drive: Drive) -> bool:
            assert isinstance(drive, ExampleDrive)
            return drive.bridge_on

    return Kit()


def test_passes_a_drive_that_heeds_its_inputs(tmp_path: Path) -> None:
    assert failures(guarded(Guarded), tmp_path, only="interlock") == {}


@pytest.mark.parametrize(
    ("drive", "check", "why"),
    [
        (ArmsBesideAnOpenDoor, "forbids_arming", "DID NOT RAISE"),
        (NamesNoInput, "forbids_arming", "did not name 'cover'"),
        (SaysNothingInTelemetry, "forbids_arming", "telemetry does not say 'cover'"),
        (GoesOnBesideAnOpenDoor, "while_armed", "DID NOT RAISE"),
        (NamesNoInput, "while_armed", "did not name 'cover'"),
        (LeavesTheBridgeOn, "while_armed", "an instrument says"),
        (ForgetsItOnClosing, "while_armed", "disarmed after an interlock has opened"),
    ],
)
def test_fails_a_drive_that_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, drive: type[ExampleDrive], check: str, why: str
) -> None:
    monkeypatch.setattr("orchestrator.testing._drive_interlocks.MAX_REPORT_DELAY_S", 0.0)
    found = failures(guarded(drive), tmp_path, only=check)
    assert why in " ".join(found.values()), found


@pytest.mark.parametrize(("drive", "opens"), [(ExampleDrive, True), (ArmsBesideAnOpenDoor, False)])
def test_asks_nothing_where_there_is_no_input_or_nobody_to_open_it(
    tmp_path: Path, drive: type[ExampleDrive], opens: bool
) -> None:
    assert failures(guarded(drive, opens), tmp_path, only="interlock") == {}
