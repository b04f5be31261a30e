"""Quantities that a law may depend on, each a function of a segment's signals.

A written effect holds a copy of the function that it uses: each needs numpy, `orchestrator.numerics.frames` and the
memories of `orchestrator.discovery` alone.
Quantities of the phases have shape (n, 3), all others (n,).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from orchestrator.discovery.memory import earlier, slopes
from orchestrator.numerics.frames import to_dq, to_phases
from orchestrator.numerics.types import Array
from protocols import SignalBatch, Signals


def phase_currents(signals: Signals | SignalBatch) -> Array:
    """Each phase's own current [A], without its readings' noise where that is known."""
    quiet = signals.i_quiet_ab
    return to_phases(signals.i_ab if quiet is None else quiet)


def smooth_currents(signals: Signals | SignalBatch) -> Array:
    """Each phase's own current [A] that belongs to the smooth flux: a memory would follow the peaks of noise."""
    smooth = signals.i_smooth_ab
    return to_phases(signals.i_ab if smooth is None else smooth)


def next_phase_currents(signals: Signals | SignalBatch) -> Array:
    """For phases a, b, c the current of phase b, c, a [A]."""
    return np.roll(to_phases(signals.i_ab), -1, axis=1)


def previous_phase_currents(signals: Signals | SignalBatch) -> Array:
    """For phases a, b, c the current of phase c, a, b [A]."""
    return np.roll(to_phases(signals.i_ab), 1, axis=1)


def current_slopes(signals: Signals | SignalBatch) -> Array:
    """Slope of each phase's current up to each reading [A/s], of the current that belongs to the smooth flux."""
    smooth = signals.i_smooth_ab
    return slopes(to_phases(signals.i_ab if smooth is None else smooth), signals)


def phase_voltages(signals: Signals | SignalBatch) -> Array:
    """Each phase's own voltage as commanded [V]."""
    return to_phases(signals.v_ab)


def voltages_before(signals: Signals | SignalBatch) -> Array:
    """Each phase's own voltage as commanded up to each reading [V]."""
    return earlier(to_phases(signals.v_ab), signals)


def phase_fluxes(signals: Signals | SignalBatch) -> Array:
    """Flux linkage along the axis of each phase by the present map [Wb]; zero without a map."""
    flux = signals.psi_ab if signals.psi_smooth_ab is None else signals.psi_smooth_ab
    return to_phases(0.0 * signals.i_ab if flux is None else flux)


def current(signals: Signals | SignalBatch) -> Array:
    """Length of the current vector [A]."""
    quiet = signals.i_quiet_ab
    return np.asarray(np.linalg.norm(signals.i_ab if quiet is None else quiet, axis=1), dtype=np.float64)


def current_d(signals: Signals | SignalBatch) -> Array:
    """Current along the d axis [A]."""
    return to_dq(signals.i_ab, signals.theta_rad)[:, 0]


def current_q(signals: Signals | SignalBatch) -> Array:
    """Current along the q axis [A]."""
    return to_dq(signals.i_ab, signals.theta_rad)[:, 1]


def torque(signals: Signals | SignalBatch) -> Array:
    """psi x i, the torque over 1.5 pole pairs [Wb A]; zero without a map."""
    if signals.psi_ab is None:
        return np.zeros(len(signals.v_dc))
    return np.asarray(
        signals.psi_ab[:, 0] * signals.i_ab[:, 1] - signals.psi_ab[:, 1] * signals.i_ab[:, 0], dtype=np.float64
    )


def voltage(signals: Signals | SignalBatch) -> Array:
    """Length of the commanded voltage vector [V]."""
    return np.asarray(np.linalg.norm(signals.v_ab, axis=1), dtype=np.float64)


def power(signals: Signals | SignalBatch) -> Array:
    """Electrical power by command and reading [W]."""
    return np.asarray(1.5 * np.sum(signals.v_ab * signals.i_ab, axis=1), dtype=np.float64)


def link_voltage(signals: Signals | SignalBatch) -> Array:
    """Link voltage beyond the drive's nominal one [V]: a part that is lost at that one shows nowhere but in the map."""
    nominal = np.mean(signals.v_dc) if signals.drive is None else signals.drive.dc_bus_voltage_v
    return np.asarray(signals.v_dc - nominal, dtype=np.float64)


def time(signals: Signals | SignalBatch) -> Array:
    """Time since the start of the experiment [s]."""
    return np.asarray(signals.time_s, dtype=np.float64)


def rotor_angle(signals: Signals | SignalBatch) -> Array:
    """Electrical angle of the rotor as believed [rad]."""
    return np.asarray(signals.theta_rad, dtype=np.float64)


def heat(signals: Signals | SignalBatch) -> Array:
    """Copper loss since the start of the experiment [W s]."""
    return np.asarray(signals.heat_j, dtype=np.float64)


@dataclass(frozen=True)
class Quantity:
    """A quantity, with what a person calls it.

    Attributes
    ----------
    of : callable
        Its function.
    text : str
        As in "a voltage of each leg over <its own current>".
    unit : str
    symbol : str
        In formulas.
    """

    of: Callable[[Signals | SignalBatch], Array]
    text: str
    unit: str
    symbol: str
    of_phases: bool = False

    @property
    def name(self) -> str:
        return self.of.__name__


PHASE_CURRENT = Quantity(phase_currents, "its own current", "A", "i", of_phases=True)
SMOOTH_CURRENT = Quantity(smooth_currents, "its own smooth current", "A", "i", of_phases=True)
NEXT_CURRENT = Quantity(next_phase_currents, "the current of the next phase", "A", "i_next", of_phases=True)
PREVIOUS_CURRENT = Quantity(
    previous_phase_currents, "the current of the previous phase", "A", "i_previous", of_phases=True
)
CURRENT_SLOPE = Quantity(current_slopes, "the slope of its own current", "A/s", "di/dt", of_phases=True)
PHASE_VOLTAGE = Quantity(phase_voltages, "its own voltage", "V", "v", of_phases=True)
VOLTAGE_BEFORE = Quantity(voltages_before, "its own voltage before the reading", "V", "v", of_phases=True)
PHASE_FLUX = Quantity(phase_fluxes, "its own flux", "Wb", "psi", of_phases=True)
CURRENT = Quantity(current, "|i|", "A", "|i|")
CURRENT_D = Quantity(current_d, "i_d", "A", "i_d")
CURRENT_Q = Quantity(current_q, "i_q", "A", "i_q")
TORQUE = Quantity(torque, "the torque", "Wb A", "T")
VOLTAGE = Quantity(voltage, "|v|", "V", "|v|")
POWER = Quantity(power, "the power", "W", "P")
LINK_VOLTAGE = Quantity(link_voltage, "the link voltage beyond its nominal value", "V", "(v_dc - v_nominal)")
TIME = Quantity(time, "time", "s", "t")
ROTOR_ANGLE = Quantity(rotor_angle, "the angle of the rotor", "rad", "theta")
HEAT = Quantity(heat, "the heat dissipated", "W s", "W")
