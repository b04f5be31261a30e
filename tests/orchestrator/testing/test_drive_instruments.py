"""The drive kit sees time and sensors: drives that are wrong in what they cannot know are caught, and why."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from orchestrator.testing._drive_instruments import ClockReading, clock_off
from protocols import Capabilities, Capture, Drive, Excitation, Telemetry
from tests.orchestrator.testing.example_drive import FS, Complex, ExampleDrive
from tests.orchestrator.testing.kit_runner import failures
from tests.orchestrator.testing.test_drive_kit import kit_for


class InRealTime(ExampleDrive):
    """Rows come while they are taken, by an oscillator that may be off."""

    fast: ClassVar[float] = 1.0
    capabilities = ExampleDrive.capabilities.model_copy(update={"clock_is_simulated": False})

    def connect(self) -> Capabilities:
        self.began = time.monotonic()
        return super().connect()

    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        due = time.monotonic() + excitation.settling_s / self.fast
        for block in super().execute(excitation):
            due += len(block) / FS / self.fast
            time.sleep(max(0.0, due - time.monotonic()))
            yield block

    def telemetry(self) -> Telemetry:
        return super().telemetry().model_copy(update={"time_s": self.fast * (time.monotonic() - self.began)})


class OnePerCentSlow(InRealTime):
    fast = 0.99


class TenPerCentFast(InRealTime):
    fast = 1.1


class StampedByTheHost(InRealTime):
    """Its own clock is ten per cent fast; it tells the host's."""

    fast = 1.1

    def telemetry(self) -> Telemetry:
        return super().telemetry().model_copy(update={"time_s": time.monotonic() - self.began})


class HidesThatItIsSimulated(ExampleDrive):
    capabilities = InRealTime.capabilities


class VoltageARowLate(ExampleDrive):
    rows: ClassVar[int] = 1

    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        i, v = super().waveforms(excitation)
        return i, np.roll(v, self.rows)


class VoltageARowEarly(VoltageARowLate):
    rows = -1


class UndeclaredDelay(ExampleDrive):
    """The current follows the voltage by a row and a half, as behind a PWM unit."""

    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        i, v = super().waveforms(excitation)
        return 0.5 * (np.roll(i, 1) + np.roll(i, 2)), v


class DeclaredDelay(UndeclaredDelay):
    capabilities = ExampleDrive.capabilities.model_copy(update={"voltage_delay_samples": 1.5})


class SmoothsItsReadings(ExampleDrive):
    rows: ClassVar[int] = 8

    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        i, v = super().waveforms(excitation)
        ends = np.concatenate([np.repeat(i[:1], self.rows // 2), i, np.repeat(i[-1:], self.rows - self.rows // 2 - 1)])
        return np.convolve(ends, np.ones(self.rows) / self.rows, "valid"), v


class IgnoresThePwmFrequency(ExampleDrive):
    """Takes the number, and does nothing with it; telemetry does not tell."""

    def telemetry(self) -> Telemetry:
        return super().telemetry().model_copy(update={"pwm_frequency_hz": None})


class TellsThatItIgnoresIt(ExampleDrive):
    def telemetry(self) -> Telemetry:
        return super().telemetry().model_copy(update={"pwm_frequency_hz": 10000.0})


class ShowsItByItsDeadTime(IgnoresThePwmFrequency):
    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        i, v = super().waveforms(excitation)
        lost = 8.0 * (excitation.pwm_frequency_hz or 10000.0) / 10000.0
        return i, v + (lost * np.sign(i.real) if excitation.kind == "hold" else 0.0)


class HalfTheBus(ExampleDrive):
    def block(self, excitation: Excitation, i: Complex, v: Complex) -> Capture:
        block = super().block(excitation, i, v)
        return block.model_copy(update={"v_dc": 0.5 * block.v_dc})


class HalfTheBusEverywhere(HalfTheBus):
    def telemetry(self) -> Telemetry:
        return super().telemetry().model_copy(update={"v_dc_v": 270.0})


class OnFromConnecting(ExampleDrive):
    def connect(self) -> Capabilities:
        self.bridge_on = True
        return super().connect()


class FlowsFromConnecting(ExampleDrive):
    """A current that telemetry does not show while the drive is disarmed."""

    unseen: float = 0.5

    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        i, v = super().waveforms(excitation)
        return (i + self.unseen * np.exp(-np.arange(len(i)) / FS / 0.01), v) if excitation.kind == "hold" else (i, v)

    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        yield from super().execute(excitation)
        self.unseen = 0.0


class FlowsOnAfterDisarming(FlowsFromConnecting):
    unseen = 0.0

    def disarm(self) -> None:
        self.unseen = abs(self.current)
        super().disarm()


class ClipsAboveTheKitsCurrents(ExampleDrive):
    scale_a: ClassVar[float] = 1.6

    def block(self, excitation: Excitation, i: Complex, v: Complex) -> Capture:
        block = super().block(excitation, i, v)
        clipped = int(np.count_nonzero(np.abs(block.i_ab).max(axis=1) > self.scale_a)) if len(i) else 0
        return self.count(block.model_copy(update={"i_ab": np.clip(block.i_ab, -self.scale_a, self.scale_a)}), clipped)

    def count(self, block: Capture, clipped: int) -> Capture:
        return block


class SaysThatItClips(ClipsAboveTheKitsCurrents):
    def count(self, block: Capture, clipped: int) -> Capture:
        return block.model_copy(update={"clipped_rows": clipped})


WRONG: list[tuple[type[ExampleDrive], str, str]] = [
    (OnePerCentSlow, "host_s_time", "runs -1.0"),
    (TenPerCentFast, "host_s_time", "rows come faster"),
    (StampedByTheHost, "host_s_time", "rows come faster"),
    (HidesThatItIsSimulated, "host_s_time", "was over after"),
    (VoltageARowLate, "same_row", "t_k + -1.00 Ts"),
    (VoltageARowEarly, "same_row", "t_k + 1.00 Ts"),
    (UndeclaredDelay, "same_row", "t_k + 1.50 Ts"),
    (SmoothsItsReadings, "same_row", "smoothed"),
    (IgnoresThePwmFrequency, "pwm_frequency_is_at_work", "as if there were no dead time"),
    (TellsThatItIgnoresIt, "pwm_frequency_is_at_work", "10000 Hz is at work"),
    (HalfTheBus, "bus_voltage", "telemetry 540.0"),
    (HalfTheBusEverywhere, "bus_voltage", "a scale is wrong"),
    (OnFromConnecting, "bridge_is_on", "connecting switches the power stage on"),
    (FlowsFromConnecting, "unseen", "after connecting"),
    (FlowsOnAfterDisarming, "unseen", "after disarming under current"),
    (ClipsAboveTheKitsCurrents, "read_whole", "clipped below the rated"),
]
RIGHT: list[tuple[type[ExampleDrive], str]] = [
    (InRealTime, "host_s_time"),
    (DeclaredDelay, "same_row"),
    (ShowsItByItsDeadTime, "pwm_frequency_is_at_work"),
    (SaysThatItClips, "read_whole"),
]


def instrumented(drive: type[ExampleDrive]) -> object:
    """The kit with a lamp at the bridge."""

    class Kit(type(kit_for(drive))):  # type: ignore[misc]
        def bridge_is_on(self, drive: Drive) -> bool:
            assert isinstance(drive, ExampleDrive)
            return drive.bridge_on

    return Kit()


@pytest.mark.parametrize(("drive", "check", "why"), WRONG, ids=[d.__name__ for d, _, _ in WRONG])
def test_fails_a_drive_that_is_wrong_and_says_why(
    tmp_path: Path, drive: type[ExampleDrive], check: str, why: str
) -> None:
    found = failures(instrumented(drive), tmp_path, only=check)
    assert why in " ".join(found.values()), found


@pytest.mark.parametrize(("drive", "check"), RIGHT, ids=[d.__name__ for d, _ in RIGHT])
def test_passes_a_drive_that_is_right_in_an_uncommon_way(tmp_path: Path, drive: type[ExampleDrive], check: str) -> None:
    assert failures(instrumented(drive), tmp_path, only=check) == {}


def test_a_busy_host_makes_no_clock_wrong() -> None:
    before = [ClockReading(0.1 * k, 0.1 * k, 0.1 * k + 0.001) for k in range(4)]
    late = [ClockReading(2.0 + 0.1 * k, 2.08 + 0.1 * k, 2.09 + 0.1 * k) for k in range(4)]
    assert clock_off(before, late) == 0.0
    assert clock_off(before, [ClockReading(2.0, 2.04, 2.001)]) == pytest.approx(0.02, rel=0.03)
