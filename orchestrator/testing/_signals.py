"""Signals that excite every effect of the catalogue, for the effect kit. No measurement, and no saturation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from orchestrator.numerics.frames import inductance_to_ab, to_ab, to_phases
from protocols import DriveRecord, LossHistory, Motor, Signals

SIGNAL_ARRAYS = ("i_ab", "v_ab", "v_late_ab", "v_dc", "theta_rad", "resistance_ohm", "i_m_ab", "heat_j", "psi_ab")


def exciting_signals(seed: int = 1) -> Signals:
    """One second of an R-L motor (4 ohm, 43 and 69 mH): both axes swept, square injection on top, warming up.

    The current is prescribed and the voltage computed from it, so the two belong together; noise of
    4 mA lies on the current as measured.
    """
    fs, n = 10000.0, 10000
    t = np.arange(n) / fs
    rng = np.random.default_rng(seed)
    slow = np.stack([2.0 * np.sin(2 * np.pi * 2.0 * t), 2.5 * np.sin(2 * np.pi * 3.0 * t + 0.5)], axis=1)
    phase = np.arange(n) % 20 / 20.0
    triangle = 2.0 * np.abs(2.0 * phase - 1.0) - 1.0
    turn = 2 * np.pi * 2.0 * t
    inductance = np.array([0.043, 0.069])
    i_dq = slow + 0.02 * triangle[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1) / inductance
    v_dq = 4.0 * i_dq + np.gradient(inductance * i_dq, 1.0 / fs, axis=0)
    theta = 0.4
    v_ab = to_ab(v_dq, theta)
    i_ab = to_ab(i_dq, theta) + rng.normal(0.0, 4e-3, (n, 2))
    losses = 6.0 * np.sum(i_dq**2, axis=1)
    return Signals(
        start_s=10.0,
        sampling_frequency_hz=fs,
        pwm_frequency_hz=fs,
        i_ab=i_ab,
        v_ab=v_ab,
        v_late_ab=0.1 * np.diff(v_ab, axis=0, prepend=v_ab[:1]),
        v_dc=np.full(n, 540.0),
        theta_rad=np.full(n, theta),
        turned_rad=0.4,
        resistance_ohm=np.full(n, 4.0),
        i_m_ab=i_ab.copy(),
        heat_j=100.0 + np.cumsum(losses) / fs,
        psi_ab=to_ab(inductance * i_dq + [0.3, 0.0], theta),
        inductance_ab=inductance_to_ab(np.tile([inductance[0], 0.0, inductance[1]], (n, 1)), theta),
        i_abc=to_phases(i_ab) + rng.normal(0.0, 4e-3, (n, 1)),
        clarke_of_three=True,
        temperature_c=np.linspace(24.0, 26.0, n),
        start_temperature_c=20.0,
        came_from_ab=np.array([[-0.4, 0.1], [0.5, -0.2]]),
        losses=LossHistory(time_s=np.array([0.0, 10.0, 11.0]), power_w=np.array([10.0, float(losses.mean()), 0.0])),
        motor=Motor(
            name="kit",
            pole_pairs=2,
            rated_current_rms_a=1.66,
            stator_resistance_ohm=4.0,
            d_inductance_h=0.043,
            q_inductance_h=0.069,
            pm_flux_wb=0.3,
        ),
        drive=DriveRecord(name="kit", sampling_frequency_hz=fs, pwm_frequency_hz=fs, dc_bus_voltage_v=540.0),
    )


def signals_of(i_ab: ArrayLike, v_ab: ArrayLike | None = None) -> Signals:
    """Signals of a current of your own, to test an effect's sign and size: a 540 V bus, 4 ohm, the rotor at 0 rad.

    Parameters
    ----------
    i_ab : array_like, shape (n, 2)
        Stator current [A] at 10 kHz.
    v_ab : array_like, shape (n, 2), optional
        Commanded voltage [V]; zero by default.

    Raises
    ------
    InputError
        Where the two have other shapes than these.
    """
    given, current = exciting_signals(), np.array(i_ab, dtype=np.float64)
    n, fs = len(current), given.sampling_frequency_hz
    return Signals(
        start_s=given.start_s,
        sampling_frequency_hz=fs,
        pwm_frequency_hz=given.pwm_frequency_hz,
        i_ab=current,
        v_ab=np.zeros((n, 2)) if v_ab is None else np.array(v_ab, dtype=np.float64),
        v_dc=given.v_dc[:1].repeat(n),
        theta_rad=np.zeros(n),
        resistance_ohm=given.resistance_ohm[:1].repeat(n),
        i_m_ab=current.copy(),
        heat_j=np.cumsum(6.0 * np.sum(current**2, axis=-1)) / fs,
        motor=given.motor,
        drive=given.drive,
    )


def largest_change(before: Signals, after: Signals) -> float:
    """Largest difference between two sets of signals, each relative to the largest value of its array."""
    changes = []
    for name in SIGNAL_ARRAYS:
        a, b = getattr(before, name), getattr(after, name)
        assert a.shape == b.shape, f"{name} has shape {b.shape} instead of {a.shape}"
        changes.append(float(np.abs(b - a).max()) / max(float(np.abs(a).max()), 1e-12))
    return max(changes)
