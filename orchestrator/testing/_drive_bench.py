"""The bench that the drive checks stand on: safe sizes from the nameplate, sessions, heartbeat. No checks."""

from __future__ import annotations

import itertools
import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from orchestrator.stages import injection_voltage_v
from orchestrator.testing._kit import Kit, bounded
from protocols import (
    Capabilities,
    Capture,
    Drive,
    DriveSetup,
    Excitation,
    GatesOff,
    Hold,
    Injection,
    Limits,
    Motor,
    Spin,
    Trapezoid,
    VoltageSteps,
    Waveform,
)

ROWS_PER_PERIOD = 20
"""Rows in one injection period: a whole number, so that the kit's spectra have no leakage."""
DISCARDED_PERIODS = 10
"""Injection periods that the kit discards where the ripple has to be settled."""
MIN_PERIODS_PER_TURN = 5
"""Injection periods in one turn of the injected vector, also on a drive that samples slowly."""


@dataclass(frozen=True)
class Sizes:
    """Excitations that are safe for this motor on this drive, yet large enough to measure."""

    limits: Limits
    rated_a: float
    current_a: float  # of holds and sweeps
    settle_s: float
    duration_s: float
    period_s: float  # of a sweep
    injection_s: float
    injected_at_a: float  # bias current per axis
    late_s: float  # discarded at the start of an injection
    waveform: Waveform
    amplitude_v: float
    step_v: float  # of voltage reversals
    frequency_hz: float
    rotation_hz: float

    @classmethod
    def of(cls, motor: Motor, capabilities: Capabilities) -> Sizes:
        """Two fifths of the rated current; an injection as strong as a procedure's."""
        rated = min(motor.rated_current_a or 0.5 * capabilities.max_current_a, capabilities.max_current_a)
        longest = capabilities.longest_capture_s or math.inf
        row_s = 1.0 / capabilities.sampling_frequency_hz
        frequency = capabilities.sampling_frequency_hz / ROWS_PER_PERIOD
        amplitude = 0.1 * capabilities.max_voltage_v
        if motor.d_inductance_h is not None:
            amplitude = injection_voltage_v(rated, motor.d_inductance_h, frequency)
        periods = max(MIN_PERIODS_PER_TURN, int(0.5 * frequency))
        room_s = min(longest, (capabilities.longest_injection_s or math.inf) - DISCARDED_PERIODS / frequency)
        if room_s < math.inf:
            periods = max(1, min(periods, int(room_s * frequency * (1.0 + 1e-9))))
        injection_s = periods / frequency
        return cls(
            limits=Limits(current_a=min(capabilities.max_current_a, 1.5 * rated), voltage_v=capabilities.max_voltage_v),
            rated_a=rated,
            current_a=0.4 * rated,
            settle_s=0.2,
            duration_s=min(max(0.4, 4.0 * row_s), longest),
            period_s=min(0.6, longest / 2.0),
            injection_s=injection_s,
            injected_at_a=0.0 if capabilities.injects_at_zero_only else 0.2 * rated,
            late_s=min(0.2, (capabilities.longest_injection_s or math.inf) - injection_s),
            waveform="square" if "square" in capabilities.injection_waveforms else "sine",
            amplitude_v=min(amplitude, 0.4 * capabilities.max_voltage_v),
            step_v=min(max(amplitude, 1.2 * rated * (motor.stator_resistance_ohm or 0.0)), capabilities.max_voltage_v),
            frequency_hz=frequency,
            rotation_hz=1.0 / injection_s,
        )

    def hold(self, d: float = 1.0, q: float = 0.5, **changed: Any) -> Hold:
        """A hold at (d, q) times the kit's current."""
        return Hold(
            **{
                "current_d_a": d * self.current_a,
                "current_q_a": q * self.current_a,
                "settle_s": self.settle_s,
                "duration_s": self.duration_s,
                **changed,
            }
        )

    def gates_off(self) -> GatesOff:
        return GatesOff(duration_s=self.duration_s)

    def trapezoid(self, **changed: Any) -> Trapezoid:
        """A period on the q axis at half the kit's current held on d."""
        return Trapezoid(
            **{
                "swept_axis": "q",
                "held_a": 0.5 * self.current_a,
                "amplitude_a": self.current_a,
                "period_s": self.period_s,
                "periods": 1,
                "settle_s": self.settle_s,
                **changed,
            }
        )

    def injection(self, **changed: Any) -> Injection:
        """One turn of the injected vector at (1/2, 1/2) times the kit's current, or at zero where that is all."""
        return Injection(
            **{
                "target_d_a": self.injected_at_a,
                "target_q_a": self.injected_at_a,
                "settle_s": self.settle_s,
                "duration_s": self.injection_s,
                "amplitude_v": self.amplitude_v,
                "frequency_hz": self.frequency_hz,
                "rotation_hz": self.rotation_hz,
                "waveform": self.waveform,
                **changed,
            }
        )

    def voltage_steps(self, **changed: Any) -> VoltageSteps:
        """On d, turned at the kit's current; of the injection's voltage, or three times R_s i."""
        return VoltageSteps(
            **{
                "voltage_d_v": self.step_v,
                "turn_d_a": self.current_a,
                "settle_s": self.settle_s,
                "duration_s": self.duration_s,
                **changed,
            }
        )

    def spin(self, **changed: Any) -> Spin:
        """Two turns and a half without current, bridge on."""
        return Spin(
            **{
                "speed_rad_s": 5.0 * math.pi / self.duration_s,
                "settle_s": self.settle_s,
                "duration_s": self.duration_s,
                **changed,
            }
        )

    def one_of(self, kind: str) -> Excitation:
        """The kit's ordinary excitation of this kind."""
        makers: dict[str, Callable[[], Excitation]] = {
            "gates_off": self.gates_off,
            "hold": self.hold,
            "trapezoid": self.trapezoid,
            "injection": self.injection,
            "steps": self.voltage_steps,
            "spin": self.spin,
        }
        return makers[kind]()


@dataclass(frozen=True)
class Measured:
    """The blocks of one excitation that hold rows, and the same put together."""

    blocks: list[Capture]
    i_ab: NDArray[np.floating]
    v_ab: NDArray[np.floating]

    @property
    def start_s(self) -> float:
        return self.blocks[0].start_s

    @property
    def end_s(self) -> float:
        last = self.blocks[-1]
        return last.start_s + len(last) / last.sampling_frequency_hz


def measure(drive: Drive, excitation: Excitation, sampling_frequency_hz: float | None = None) -> Measured:
    """Run one excitation to its end and check its rows; keepalive blocks (without rows) are skipped."""
    blocks = []
    for block in drive.execute(excitation):
        assert isinstance(block, Capture), f"execute must yield Capture objects, got {type(block).__name__}"
        if len(block):
            blocks.append(block)
    assert blocks, f"{excitation.kind} captured nothing"
    _require_complete_capture(blocks, excitation, sampling_frequency_hz or blocks[0].sampling_frequency_hz)
    return Measured(blocks, np.concatenate([b.i_ab for b in blocks]), np.concatenate([b.v_ab for b in blocks]))


def _require_complete_capture(blocks: list[Capture], excitation: Excitation, fs: float) -> None:
    """Require finite, uniform samples without a gap, as many rows as requested."""
    rows = sum(len(block) for block in blocks)
    request = f"{excitation.kind} of {excitation.captured_s} s at {fs} Hz"
    assert rows == excitation.rows(fs), f"{request} gave {rows} rows"
    for block in blocks:
        assert block.sampling_frequency_hz == fs, "a block's sampling frequency is not the one claimed"
        assert len(block) <= 0.5 * fs + 1, f"a block of {len(block) / fs:.2f} s; half a second at most"
        arrays = (block.i_ab, block.v_ab, block.v_dc)
        assert all(np.isfinite(array).all() for array in arrays), "a sample is not finite"
        assert block.v_dc.min() > 0.0, "v_dc is not positive"
    for earlier, later in itertools.pairwise(blocks):
        gap = (later.start_s - earlier.start_s) * fs - len(earlier)
        assert abs(gap) < 0.01, f"{gap:+.3f} rows between a block and the next"


class HeartbeatThread:
    """Thread that sends a drive's heartbeat while the `with` block lasts, or until `stop`."""

    def __init__(self, drive: Drive, interval_s: float) -> None:
        self._drive, self._interval_s = drive, interval_s
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)

    def __enter__(self) -> HeartbeatThread:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def stop(self) -> None:
        """No beat comes after this returns."""
        self._stopped.set()
        self._thread.join()

    def _beat(self) -> None:
        while not self._stopped.is_set():
            self._drive.heartbeat()
            self._stopped.wait(self._interval_s)


@dataclass(frozen=True)
class Session:
    """A connected drive with its sizes; armed, with a heartbeat, where `heart` is given."""

    drive: Drive
    capabilities: Capabilities
    sizes: Sizes
    heart: HeartbeatThread | None = None

    def requires(self, kind: str) -> None:
        """Skip the check where the drive does not claim this excitation."""
        if kind not in self.capabilities.excitations:
            pytest.skip(f"this drive claims no {kind}")

    def measure(self, excitation: Excitation) -> Measured:
        """Capture of this excitation, within the voltage limit and at the claimed sampling frequency."""
        measured = measure(self.drive, excitation, self.capabilities.sampling_frequency_hz)
        longest = float(np.hypot(*measured.v_ab.T).max())
        assert longest <= self.sizes.limits.voltage_v * 1.001, f"commanded {longest:.1f} V, above the limit"
        return measured

    def current_now(self) -> complex:
        """Current vector d + jq by telemetry [A]."""
        telemetry = self.drive.telemetry()
        return complex(telemetry.i_d_a, telemetry.i_q_a)


class DriveBench(Kit, ABC):
    """Factory of the drive, tolerances, and sessions with it."""

    current_tolerance: ClassVar[float] = 0.05
    """Error of a controlled current, as a part of the kit's test current; at most 0.2."""
    voltage_tolerance: ClassVar[float] = 0.02
    """Relative error of the injected voltage's amplitude; at most 0.1."""
    tracking_tolerance: ClassVar[float] = 0.2
    """rms distance of the trapezoid from its reference, as a part of its amplitude; at most 0.4."""
    angle_tolerance_rad: ClassVar[float] = 0.05
    """Error of a direction in the stator frame; at most 0.2."""

    @abstractmethod
    def make_drive(self, setup: DriveSetup) -> Drive:
        """A new drive, not connected. Called several times with one private directory."""

    @abstractmethod
    def setup(self) -> DriveSetup:
        """Nameplate, options and seed; the kit lays in a private directory where there is none."""

    def prepare(self, drive: Drive, capabilities: Capabilities) -> None:
        """Make the rotor safe to load, after connecting: engages the brake where the drive has one."""
        if capabilities.has_brake:
            drive.set_brake(True)

    def setup_in(self, private_directory: Path) -> DriveSetup:
        setup = self.setup()
        if setup.private_directory is not None:
            return setup
        return setup.model_copy(update={"private_directory": private_directory})

    @contextmanager
    def connected(self, private_directory: Path) -> Iterator[Session]:
        """A connected drive; ramped down, disarmed and closed at the end, whatever happened."""
        setup = self.setup_in(private_directory)
        drive = self.make_drive(setup)
        with ExitStack() as cleanup:
            cleanup.callback(drive.close)
            capabilities = drive.connect()
            cleanup.callback(drive.disarm)
            cleanup.callback(drive.ramp_down)
            self.prepare(drive, capabilities)
            yield Session(drive, capabilities, Sizes.of(setup.motor, capabilities))

    @contextmanager
    def beating(self, session: Session) -> Iterator[Session]:
        """Arm a connected drive and send its heartbeat."""
        with HeartbeatThread(session.drive, (session.capabilities.watchdog_s or 0.2) / 5.0) as heart:
            session.drive.arm(session.sizes.limits)
            yield Session(session.drive, session.capabilities, session.sizes, heart)

    @contextmanager
    def armed(self, private_directory: Path) -> Iterator[Session]:
        """A connected and armed drive with a heartbeat."""
        with self.connected(private_directory) as session, self.beating(session) as beating:
            yield beating
            session.drive.ramp_down()

    def bridge_is_on(self, drive: Drive) -> bool | None:
        """State of the power stage by an independent instrument: a scope, a lamp, an emulator's log.

        None, the default: no instrument, so the kit relies on the drive.
        """
        return None

    def tolerance_a(self, session: Session) -> float:
        """Tolerance of a controlled current [A]."""
        return bounded("current_tolerance", self.current_tolerance, 0.2) * session.sizes.current_a
