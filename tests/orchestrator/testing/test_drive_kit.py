"""The drive kit passes a drive that keeps the contract, and fails each one that breaks it in one way."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from orchestrator.testing import DriveConformance
from orchestrator.testing._drive_bench import MIN_PERIODS_PER_TURN, ROWS_PER_PERIOD, Sizes
from protocols import (
    Capabilities,
    Capture,
    Drive,
    DriveFault,
    DriveSetup,
    DriveState,
    Excitation,
    FaultCause,
    Injection,
    Limits,
    Motor,
    NoOptions,
    Telemetry,
    Trapezoid,
)
from tests.orchestrator.testing.example_drive import FS, Complex, ExampleDrive
from tests.orchestrator.testing.kit_runner import failures


def kit_for(drive: type[ExampleDrive]) -> DriveConformance:
    """The kit, about this class of drive."""

    class Kit(DriveConformance):
        registered = False

        def make_drive(self, setup: DriveSetup) -> Drive:
            return drive(setup)

        def setup(self) -> DriveSetup:
            motor = Motor(name="example", pole_pairs=2, rated_current_rms_a=1.66, d_inductance_h=0.04325)
            return DriveSetup(motor=motor, options=NoOptions(), seed=1)

    return Kit()


def test_passes_a_drive_that_keeps_the_contract(tmp_path: Path) -> None:
    assert failures(kit_for(ExampleDrive), tmp_path) == {}


class NoWatchdog(ExampleDrive):
    capabilities = ExampleDrive.capabilities.model_copy(update={"watchdog_s": None, "watchdog_covers": frozenset()})

    def watch(self) -> None: ...


def test_passes_an_honest_drive_without_a_watchdog(tmp_path: Path) -> None:
    assert failures(kit_for(NoWatchdog), tmp_path) == {}


class OnlyHolds(ExampleDrive):
    capabilities = ExampleDrive.capabilities.model_copy(
        update={"excitations": frozenset({"hold"}), "watchdog_covers": frozenset({"hold"})}
    )

    def check(self, excitation: Excitation) -> None:
        if excitation.kind != "hold":
            from protocols import DriveRefused

            raise DriveRefused("holds only")
        super().check(excitation)


def test_asks_nothing_of_excitations_that_are_not_claimed(tmp_path: Path) -> None:
    assert failures(kit_for(OnlyHolds), tmp_path) == {}


class SamplesSlowly(ExampleDrive):
    capabilities = ExampleDrive.capabilities.model_copy(update={"sampling_frequency_hz": 30.0})


@pytest.mark.parametrize("fs", [1.0, 30.0, 39.9, 40.0, 250.0, FS])
@pytest.mark.parametrize("longest_s", [None, 0.1, 30.0])
def test_an_injection_is_a_whole_number_of_periods_however_slowly_a_drive_samples(
    fs: float, longest_s: float | None
) -> None:
    update = {"sampling_frequency_hz": fs, "longest_capture_s": longest_s}
    motor = Motor(name="example", pole_pairs=2, rated_current_rms_a=1.66)
    sizes = Sizes.of(motor, ExampleDrive.capabilities.model_copy(update=update))
    periods = sizes.injection_s * sizes.frequency_hz
    assert periods == pytest.approx(round(periods))
    assert sizes.rotation_hz * sizes.injection_s == pytest.approx(1.0)
    if longest_s is None:
        assert periods >= MIN_PERIODS_PER_TURN - 1e-9
    else:
        assert sizes.injection_s <= max(longest_s, ROWS_PER_PERIOD / fs) + 1e-9


@pytest.mark.parametrize("waveform", ["square", "sine"])
def test_passes_a_drive_that_samples_slowly(tmp_path: Path, waveform: str) -> None:
    kit = kit_for(SamplesSlowly)
    kit.test_injection_is_found_in_the_captured_voltage(tmp_path, waveform)
    kit.test_injection_ripples_about_its_target(tmp_path)


class WrongPolarity(ExampleDrive):
    """The current sensors are plugged in the wrong way round; the loop is closed on what they say."""

    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        i, v = super().waveforms(excitation)
        return i, -v


class ConjugatedFrame(ExampleDrive):
    """Two phases swapped on the way out."""

    def block(self, excitation: Excitation, i: Complex, v: Complex) -> Capture:
        capture = super().block(excitation, i, v)
        return capture.model_copy(update={"i_ab": capture.i_ab * [1, -1], "v_ab": capture.v_ab * [1, -1]})


class IgnoresRotorAngle(ExampleDrive):
    def block(self, excitation: Excitation, i: Complex, v: Complex) -> Capture:
        return super().block(excitation.model_copy(update={"rotor_angle_rad": 0.0}), i, v)


class TurnsTheWrongWay(ExampleDrive):
    def block(self, excitation: Excitation, i: Complex, v: Complex) -> Capture:
        return super().block(excitation.model_copy(update={"rotor_angle_rad": -excitation.rotor_angle_rad}), i, v)


class IgnoresLimits(ExampleDrive):
    def check(self, excitation: Excitation) -> None: ...


class LimitsEachAxisAlone(ExampleDrive):
    def check(self, excitation: Excitation) -> None:
        assert self.limits is not None
        if excitation.kind == "hold" and max(abs(excitation.current_d_a), abs(excitation.current_q_a)) < (
            self.limits.current_a
        ):
            return
        super().check(excitation)


class LetsNanThrough(ExampleDrive):
    def check(self, excitation: Excitation) -> None:
        if not np.isnan(getattr(excitation, "current_d_a", 0.0)):
            super().check(excitation)


class MovesBeforeRefusing(ExampleDrive):
    def check(self, excitation: Excitation) -> None:
        self.current = 2.0 + 0j
        super().check(excitation)


class AcceptsAnyLimits(ExampleDrive):
    def arm(self, limits: Limits) -> None:
        own = Limits(current_a=self.capabilities.max_current_a, voltage_v=self.capabilities.max_voltage_v)
        super().arm(own)


class GapInTheTimeBase(ExampleDrive):
    def block(self, excitation: Excitation, i: Complex, v: Complex) -> Capture:
        self.clock_s += 1 / FS
        return super().block(excitation, i, v)


class ClockStartsAnew(ExampleDrive):
    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        self.clock_s = 0.0
        return super().execute(excitation)


class WrongRowCount(ExampleDrive):
    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        i, v = super().waveforms(excitation)
        return i[:-1], v[:-1]


class BlocksTooLong(ExampleDrive):
    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        blocks = [block for block in super().execute(excitation) if len(block)]
        yield blocks[0].model_copy(
            update={name: np.concatenate([getattr(b, name) for b in blocks]) for name in ("i_ab", "v_ab", "v_dc")}
        )


class WrongSamplingFrequency(ExampleDrive):
    def block(self, excitation: Excitation, i: Complex, v: Complex) -> Capture:
        return super().block(excitation, i, v).model_copy(update={"sampling_frequency_hz": FS / 2})


class NotFinite(ExampleDrive):
    def block(self, excitation: Excitation, i: Complex, v: Complex) -> Capture:
        return super().block(excitation, np.where(np.arange(len(i)) == 7, np.nan, i), v)


class WrongInjectedFrequency(ExampleDrive):
    def injection(self, excitation: Injection) -> tuple[Complex, Complex]:
        return super().injection(excitation.model_copy(update={"frequency_hz": 0.96 * excitation.frequency_hz}))


class RotatesBackwards(ExampleDrive):
    def injection(self, excitation: Injection) -> tuple[Complex, Complex]:
        return super().injection(excitation.model_copy(update={"rotation_hz": -excitation.rotation_hz}))


class HalfTheAmplitude(ExampleDrive):
    def injection(self, excitation: Injection) -> tuple[Complex, Complex]:
        return super().injection(excitation.model_copy(update={"amplitude_v": 0.5 * excitation.amplitude_v}))


class AlwaysSquare(ExampleDrive):
    def injection(self, excitation: Injection) -> tuple[Complex, Complex]:
        return super().injection(excitation.model_copy(update={"waveform": "square"}))


class InjectionBeginsLate(ExampleDrive):
    """The discarded time is counted from the wrong instant."""

    def injection(self, excitation: Injection) -> tuple[Complex, Complex]:
        return super().injection(excitation.model_copy(update={"discard_s": 0.0}))


class TrapezoidIsATriangle(ExampleDrive):
    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        i, v = super().waveforms(excitation)
        if isinstance(excitation, Trapezoid):
            phase = np.arange(len(i)) / FS / excitation.period_s % 1
            wave = np.interp(phase, [0, 0.25, 0.75, 1], [0, 1, -1, 0]) * excitation.amplitude_a
            i = excitation.held_a + 1j * wave if excitation.swept_axis == "q" else i
        return i, v


class ForgetsTheHeldAxis(ExampleDrive):
    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        if isinstance(excitation, Trapezoid):
            excitation = excitation.model_copy(update={"held_a": 0.0})
        return super().waveforms(excitation)


class CapturesWhileSettling(ExampleDrive):
    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        i, v = super().waveforms(excitation)
        settling = 1 - np.exp(-np.arange(len(i)) / FS / 0.3)
        return (i * settling, v) if excitation.kind == "hold" else (i, v)


class CurrentWithGatesOff(ExampleDrive):
    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        i, v = super().waveforms(excitation)
        return (i + 0.5, v) if excitation.kind == "gates_off" else (i, v)


class VoltageWithGatesOff(ExampleDrive):
    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        i, v = super().waveforms(excitation)
        return (i, v + 1.0) if excitation.kind == "gates_off" else (i, v)


class EnergisedOnConnecting(ExampleDrive):
    def connect(self) -> Capabilities:
        self.state = DriveState.ARMED
        self.limits = Limits(current_a=5.0, voltage_v=300.0)
        self.heartbeat()
        return self.capabilities


class ExecutesWithoutArming(ExampleDrive):
    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        if self.state is DriveState.DISARMED:
            self.arm(Limits(current_a=5.0, voltage_v=300.0))
        return super().execute(excitation)


class NoRampDown(ExampleDrive):
    def ramp_down(self) -> None: ...


class DisarmsOnlyOnce(ExampleDrive):
    def disarm(self) -> None:
        if self.state is DriveState.DISARMED:
            raise RuntimeError("not armed")
        super().disarm()


class StaysArmed(ExampleDrive):
    def disarm(self) -> None:
        self.current = 0j


class LetsGoOfTheOperatingPoint(ExampleDrive):
    def rests_at(self, excitation: Excitation) -> complex:
        return 0j


class IgnoresWatchdog(ExampleDrive):
    def watch(self) -> None: ...


class WatchdogNeverFed(ExampleDrive):
    def heartbeat(self) -> None:
        if self.state is DriveState.DISARMED:
            super().heartbeat()


class WatchdogSleepsInTrapezoids(ExampleDrive):
    kind: ClassVar[str] = ""

    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        self.kind = excitation.kind  # type: ignore[misc]
        return super().execute(excitation)

    def watch(self) -> None:
        if self.kind != "trapezoid":
            super().watch()


class WrongCause(ExampleDrive):
    def watch(self) -> None:
        try:
            super().watch()
        except DriveFault as fault:
            raise DriveFault(FaultCause.INTERNAL, "something") from fault


class FaultIsNotLatched(ExampleDrive):
    def arm(self, limits: Limits) -> None:
        self.clear_fault()
        super().arm(limits)


class HeartbeatClearsTheFault(ExampleDrive):
    def heartbeat(self) -> None:
        super().heartbeat()
        if self.state is DriveState.FAULTED:
            self.clear_fault()


class DisarmClearsTheFault(ExampleDrive):
    def disarm(self) -> None:
        super().disarm()
        self.clear_fault()


class ClearingArms(ExampleDrive):
    def clear_fault(self) -> None:
        super().clear_fault()
        self.state = DriveState.ARMED


class HeartbeatBlocks(ExampleDrive):
    def heartbeat(self) -> None:
        time.sleep(0.1)
        super().heartbeat()


class IncoherentCapabilities(ExampleDrive):
    capabilities = ExampleDrive.capabilities.model_copy(update={"pwm_frequencies_hz": (5000.0,)})


class ClaimsAWatchdogOverNothing(ExampleDrive):
    capabilities = ExampleDrive.capabilities.model_copy(update={"watchdog_covers": frozenset()})


class AcceptsAnyPwmFrequency(ExampleDrive):
    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        return super().execute(excitation.model_copy(update={"pwm_frequency_hz": None}))


class SealsWhatIsNotThere(ExampleDrive):
    sealed_options = frozenset({"truth"})


class PretendsToHaveABrake(ExampleDrive):
    def set_brake(self, engaged: bool) -> None: ...


class TelemetryClockStandsStill(ExampleDrive):
    def telemetry(self) -> Telemetry:
        return super().telemetry().model_copy(update={"time_s": 0.0})


class ForgetsItsHeat(ExampleDrive):
    def restore(self, point_id: str, start_s: float) -> None:
        self.clock_s = start_s


class SetsItsClockBack(ExampleDrive):
    def restore(self, point_id: str, start_s: float) -> None:
        super().restore(point_id, 0.0)


MUTATIONS: list[tuple[type[ExampleDrive], str]] = [
    (WrongPolarity, "voltage_that_points_there"),
    (ConjugatedFrame, "hold_reaches_its_target"),
    (IgnoresRotorAngle, "turn_with_the_rotor_angle"),
    (TurnsTheWrongWay, "turn_with_the_rotor_angle"),
    (IgnoresLimits, "past_the_limits"),
    (LimitsEachAxisAlone, "past_the_limits"),
    (LetsNanThrough, "is_no_number"),
    (MovesBeforeRefusing, "past_the_limits"),
    (AcceptsAnyLimits, "limits_above"),
    (GapInTheTimeBase, "trapezoid_follows"),
    (ClockStartsAnew, "clock_only_goes_forward"),
    (WrongRowCount, "hold_reaches_its_target"),
    (BlocksTooLong, "trapezoid_follows"),
    (WrongSamplingFrequency, "hold_reaches_its_target"),
    (NotFinite, "hold_reaches_its_target"),
    (WrongInjectedFrequency, "injection_is_found"),
    (RotatesBackwards, "injection_is_found"),
    (HalfTheAmplitude, "injection_is_found"),
    (AlwaysSquare, "injection_is_found"),
    (InjectionBeginsLate, "injection_is_found"),
    (TrapezoidIsATriangle, "trapezoid_follows"),
    (ForgetsTheHeldAxis, "trapezoid_follows"),
    (CapturesWhileSettling, "hold_reaches_its_target"),
    (CurrentWithGatesOff, "gates_off_shows"),
    (VoltageWithGatesOff, "gates_off_shows"),
    (EnergisedOnConnecting, "connecting_energises_nothing"),
    (ExecutesWithoutArming, "before_arming_is_refused"),
    (NoRampDown, "until_it_is_ramped_down"),
    (NoRampDown, "left_early"),
    (DisarmsOnlyOnce, "may_be_repeated"),
    (StaysArmed, "show_in_the_state"),
    (LetsGoOfTheOperatingPoint, "goes_on_holding"),
    (IgnoresWatchdog, "silent_host"),
    (WatchdogNeverFed, "beating_heart"),
    (WatchdogSleepsInTrapezoids, "silent_host"),
    (WrongCause, "silent_host"),
    (FaultIsNotLatched, "silent_host"),
    (HeartbeatClearsTheFault, "silent_host"),
    (DisarmClearsTheFault, "silent_host"),
    (ClearingArms, "silent_host"),
    (HeartbeatBlocks, "heartbeat_returns_at_once"),
    (IncoherentCapabilities, "capabilities_are_coherent"),
    (ClaimsAWatchdogOverNothing, "capabilities_are_coherent"),
    (AcceptsAnyPwmFrequency, "unclaimed_pwm_frequency"),
    (SealsWhatIsNotThere, "class_keeps_the_contract"),
    (PretendsToHaveABrake, "brake_is_moved_or_refused"),
    (TelemetryClockStandsStill, "clock_only_goes_forward"),
    (ForgetsItsHeat, "taken_up_again"),
    (SetsItsClockBack, "taken_up_again"),
]


@pytest.mark.parametrize(("drive", "check"), MUTATIONS, ids=[f"{d.__name__}-{c}" for d, c in MUTATIONS])
def test_fails_a_drive_that_breaks_the_contract(tmp_path: Path, drive: type[ExampleDrive], check: str) -> None:
    found = failures(kit_for(drive), tmp_path, only=check)
    assert found, f"{drive.__name__} passes {check}"
    assert all(text.split(": ", 1)[1].strip() for text in found.values()), "a check failed without saying why"


def test_a_tolerance_cannot_be_widened_until_nothing_is_checked(tmp_path: Path) -> None:
    kit = kit_for(ExampleDrive)
    type(kit).current_tolerance = 5.0
    assert "widened" in failures(kit, tmp_path, only="until_it_is_ramped_down").popitem()[1]


def test_wants_an_entry_point_under_the_drive_s_own_name(tmp_path: Path) -> None:
    kit = kit_for(ExampleDrive)
    type(kit).registered = True
    assert "no entry point 'example'" in failures(kit, tmp_path, only="entry_point").popitem()[1]
