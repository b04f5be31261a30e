"""Plausibility of what any drive reads: against its bus, the limits of the run, and the readings before.

No motor and no sensor error explains what is refused here; a drive that sends it is a fault. The bounds are wide, so
that poor sensors and noise pass. NaN passes no comparison. Frames and time stamps are the drive's own business.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from pydantic import ValidationError

from orchestrator.validation.plausibility import MAX_VOLTAGE_RATIO, PLAUSIBLE_BOUNDS, Numbers
from protocols import (
    Capabilities,
    Capture,
    DriveFault,
    Excitation,
    FaultCause,
    GatesOff,
    Limits,
    Telemetry,
    VoltageSteps,
)

MAX_CURRENT_RATIO = 1.5
"""Current of a sample over the limit above which the drive has failed to trip."""
MAX_COMMAND_RATIO = 1.5 * MAX_VOLTAGE_RATIO
"""Voltage vector over the bus voltage: a bridge's longest, with half of it for controllers that saturate late."""
MAX_STEP_RATIO = 0.02
"""Steps of a voltage over the bus voltage above which resistances and fluxes from it mean nothing."""
MAX_LEVELS = round(2.0 * MAX_COMMAND_RATIO / MAX_STEP_RATIO)
"""Levels that a voltage with such steps has at most."""
MIN_LEVELS = 3
"""A voltage that is switched between two levels has no steps."""
MIN_LEVELS_RATIO = 8
"""Levels of the current over those of the voltage: a current that repeats itself has a voltage that does so too."""
TEMPERATURES_C = (-60.0, 300.0)
"""No winding with a thermometer is colder or hotter."""
MAX_CLOCK_RATIO = 1.1
"""Time that passes by the drive's clock over that of the host."""
CLOCK_TOLERANCE_S = 1.0
"""Delay between a sample and its arrival that differs from block to block; `plugins.link` is stricter."""
_HOST_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Host clock that continues during suspend, as the drive's does."""


class ReadingCheck:
    """Checks the blocks of a run's points; each method raises `DriveFault`.

    Parameters
    ----------
    capabilities : Capabilities
        Nominal bus voltage and kind of clock.
    limits : Limits
    clock : callable
        Host's time [s].
    """

    def __init__(
        self,
        capabilities: Capabilities,
        limits: Limits,
        clock: Callable[[], float] = lambda: time.clock_gettime(_HOST_CLOCK),
    ) -> None:
        self._bus_v, self._is_simulated = capabilities.dc_bus_voltage_v, capabilities.clock_is_simulated
        self._limits, self._clock = limits, clock
        self._last: tuple[float, float] | None = None
        """End of the last block by the drive's clock, and its arrival by the host's [s]."""
        self._point = ""
        self._excitation: Excitation = GatesOff(duration_s=1.0)
        self._levels: list[Numbers] = []

    def begin(self, point: str, excitation: Excitation) -> None:
        """Start a point."""
        self._point, self._excitation, self._levels = point, excitation, []

    def check(self, capture: Capture) -> None:
        """Check a block with at least one row."""
        self._check_time(capture)
        self._check_bus(capture)
        peak_a, peak_v = _longest(capture.i_ab), _longest(capture.v_ab)
        limit_a = self._limits.current_a
        if not peak_a <= MAX_CURRENT_RATIO * limit_a:
            message = f"{peak_a:.3g} A measured, the limit is {limit_a:.3g} A, and the drive went on"
            raise self._fault(message, FaultCause.OVERCURRENT)
        bus_v = max(self._bus_v, float(np.max(capture.v_dc)))
        if not peak_v <= MAX_COMMAND_RATIO * bus_v:
            raise self._fault(f"{peak_v:.4g} V at the motor, from a bus of {bus_v:.4g} V")
        if capture.temperature_c is not None:
            low_c, high_c = float(np.min(capture.temperature_c)), float(np.max(capture.temperature_c))
            if not (TEMPERATURES_C[0] <= low_c and high_c <= TEMPERATURES_C[1]):
                raise self._fault(f"a winding between {low_c:.4g} and {high_c:.4g} degrees Celsius")
        self._collect_levels(capture)

    def conclude(self) -> None:
        """Check the steps of the point's voltages, of which a block may show too few."""
        if isinstance(self._excitation, VoltageSteps) or not self._levels:
            return
        currents, *voltages = self._levels
        for levels in voltages:
            if not MIN_LEVELS <= len(levels) <= min(MAX_LEVELS, len(currents) / MIN_LEVELS_RATIO):
                continue
            step_v = float(np.diff(levels).min())
            if step_v > MAX_STEP_RATIO * self._bus_v:
                share = f"{100.0 * step_v / self._bus_v:.2g} % of the bus voltage"
                raise self._fault(
                    f"the voltages come in steps of {step_v:.3g} V, {share}: no resistance follows from them"
                )

    def _check_time(self, capture: Capture) -> None:
        start_s, now_s = capture.start_s, self._clock()
        if not start_s > -CLOCK_TOLERANCE_S:
            raise self._fault(f"its clock stands at {start_s:.6g} s, before the experiment's begin")
        if self._last is not None:
            end_s, arrival_s = self._last
            passed_s, possible_s = start_s - end_s, MAX_CLOCK_RATIO * (now_s - arrival_s) + CLOCK_TOLERANCE_S
            if not passed_s > -CLOCK_TOLERANCE_S:
                raise self._fault(f"its clock went back by {-passed_s:.4g} s")
            if not (self._is_simulated or passed_s < possible_s):
                raise self._fault(f"its clock jumped by {passed_s:.4g} s within {now_s - arrival_s:.2g} s")
        self._last = start_s + len(capture) / capture.sampling_frequency_hz, now_s

    def _check_bus(self, capture: Capture) -> None:
        low, high = PLAUSIBLE_BOUNDS.bus
        low_v, high_v = float(np.min(capture.v_dc)), float(np.max(capture.v_dc))
        min_v = 0.0 if isinstance(self._excitation, GatesOff) else low * self._bus_v  # it may be off with the bridge
        if not (min_v <= low_v and high_v <= high * self._bus_v):
            wrong_v = high_v if not high_v <= high * self._bus_v else low_v
            raise self._fault(f"a bus of {wrong_v:.4g} V; the drive has one of {self._bus_v:.4g} V")

    def _collect_levels(self, capture: Capture) -> None:
        """Distinct values of the current, and of each voltage in the stator's and in the rotor's frame."""
        from orchestrator.numerics.frames import to_dq  # imported on use: kernels take long to load

        v_dq = to_dq(capture.v_ab, self._excitation.rotor_angle_rad)
        columns = [capture.i_ab[:, 0] + capture.i_ab[:, 1], *capture.v_ab.T, *v_dq.T]
        most = [MIN_LEVELS_RATIO * MAX_LEVELS, *[MAX_LEVELS] * 4]
        self._levels = self._levels or [np.empty(0) for _ in columns]
        for k, (column, enough) in enumerate(zip(columns, most, strict=True)):
            if len(self._levels[k]) <= enough:
                digits = np.round(np.asarray(column, np.float64), 6)
                self._levels[k] = np.union1d(self._levels[k], digits)

    def _fault(self, detail: str, cause: FaultCause = FaultCause.WRONG_DATA) -> DriveFault:
        return DriveFault(cause, f"{self._point}: {detail}")


def check_telemetry(telemetry: Telemetry, capabilities: Capabilities, limits: Limits) -> Telemetry:
    """A reading between points, as it came; raises `DriveFault` where no drive can have it."""
    bus_v, max_v = telemetry.v_dc_v, PLAUSIBLE_BOUNDS.bus[1] * capabilities.dc_bus_voltage_v
    if not 0.0 <= bus_v <= max_v:
        message = f"reads a bus of {bus_v:.4g} V; it has one of {capabilities.dc_bus_voltage_v:.4g} V"
        raise DriveFault(FaultCause.WRONG_DATA, f"{capabilities.name} {message}")
    current_a = float(np.hypot(telemetry.i_d_a, telemetry.i_q_a))
    if not current_a <= MAX_CURRENT_RATIO * limits.current_a:
        message = f"{current_a:.3g} A measured, the limit is {limits.current_a:.3g} A, and the drive went on"
        raise DriveFault(FaultCause.OVERCURRENT, message)
    return telemetry


def impossible_reading(name: str, error: ValidationError) -> DriveFault:
    """The fault of a drive whose capabilities, captures or telemetry have a value that cannot be."""
    first = error.errors(include_url=False)[0]
    place = ".".join(map(str, first["loc"]))
    return DriveFault(FaultCause.WRONG_DATA, f"{name} gave an impossible value: {place}: {first['msg']}")


def _longest(vectors: Numbers) -> float:
    """Length of the longest of vectors (n, 2), also where its square is no number of this type."""
    scale = float(np.max(np.abs(vectors)))
    if not 0.0 < scale < np.inf:
        return scale
    return scale * float(np.sqrt(np.max(np.sum(np.square(vectors / scale), axis=1))))
