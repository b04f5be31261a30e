"""Readings that the corrections are held against, and what a correction makes of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orchestrator.numerics.types import Array
from protocols import DriveRecord, Effect, Motor, Signals

FS = 10_000.0


def readings(n: int = 400, pwm_hz: float = FS) -> Signals:
    k = np.arange(n)
    i = np.stack([2.0 * np.cos(2 * np.pi * k / n), 1.5 * np.sin(2 * np.pi * k / n)], axis=1)
    v = 4.0 * i + np.where(k % 20 < 10, 40.0, -40.0)[:, None] * np.array([1.0, 0.5])
    return Signals(
        start_s=5.0,
        sampling_frequency_hz=FS,
        pwm_frequency_hz=pwm_hz,
        i_ab=i,
        v_ab=v,
        v_dc=np.full(n, 540.0),
        theta_rad=np.full(n, 0.2),
        resistance_ohm=np.full(n, 4.0),
        i_m_ab=i,
        heat_j=np.linspace(10.0, 20.0, n),
        motor=Motor(name="m", pole_pairs=2, d_inductance_h=0.043, q_inductance_h=0.069),
        drive=DriveRecord(name="d", sampling_frequency_hz=FS, pwm_frequency_hz=FS, dc_bus_voltage_v=540.0),
    )


def corrected(effect: Effect, signals: Signals, **values: float) -> Signals:
    return signals.corrected(effect.correct(signals, effect.Parameters(**values)))


def reads(signals: Signals, i_ab: Array) -> Signals:
    return replace(signals, i_ab=i_ab, i_m_ab=i_ab)
