"""Batches of segments that differ in all that segments of a recording may differ in, and settings of every effect."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from orchestrator.numerics.frames import inductance_to_ab, to_ab, to_dq
from protocols import DriveRecord, EffectParameters, LossHistory, Motor, ParameterRole, Signals

LENGTHS = (250, 37, 600, 4, 251, 1000, 5, 333)
SAMPLING_HZ = (10_000.0, 10_000.0, 20_000.0, 10_000.0, 20_000.0, 8_000.0, 10_000.0, 10_000.0)
PWM_HZ = (10_000.0, 20_000.0, 20_000.0, 10_000.0, 10_000.0, 24_000.0, 5_000.0, 10_000.0)

MOTOR = Motor(
    name="m", pole_pairs=2, rated_current_rms_a=1.66, d_inductance_h=0.043, q_inductance_h=0.069, pm_flux_wb=0.3
)
DRIVE = DriveRecord(name="d", sampling_frequency_hz=1e4, pwm_frequency_hz=1e4, dc_bus_voltage_v=540.0)


def segments_with_a_model() -> list[Signals]:
    """With model, nameplate and drive; what a single segment may lack, some lack."""
    heated = [_losses(1.0), _losses(2.0)]
    whole = []
    for k, bare in enumerate(segments_alone()):
        rng = np.random.default_rng(100 + k)
        i_dq, n, theta = to_dq(bare.i_ab, bare.theta_rad), len(bare.v_dc), bare.theta_rad
        psi = to_ab(i_dq * [0.043, 0.069] + [0.3, 0.0], theta)
        d, q = 0.043 - 0.002 * i_dq[:, 0] ** 2, 0.069 - 0.003 * i_dq[:, 1] ** 2
        extra: dict[str, Any] = {
            "psi_ab": psi,
            "inductance_ab": inductance_to_ab(np.stack([d, 0.001 * i_dq[:, 0], q], axis=1), theta),
            "psi_smooth_ab": psi + 1e-4 * rng.normal(size=(n, 2)),
            "i_smooth_ab": bare.i_ab + 1e-3 * rng.normal(size=(n, 2)),
            "clarke_of_three": (True, False, None)[k % 3],
            "losses": None if k == 4 else heated[k % 2],
            "motor": MOTOR,
            "drive": DRIVE,
        }
        if k % 2:
            extra["v_late_ab"] = rng.normal(size=(n, 2))
        if k % 3:
            extra["i_quiet_ab"] = bare.i_ab + 1e-3 * rng.normal(size=(n, 2))
        if k not in (2, 7):
            extra["came_from_ab"] = rng.normal(size=(1 + k % 3, 2))
        if k % 4 == 1:
            extra["largest_command_abc"] = rng.dirichlet(np.ones(3), n)
        if k != 1:
            extra |= {"temperature_c": 24.0 + rng.normal(size=n)}
        if k % 2:
            extra |= {"start_temperature_c": 20.0}
        whole.append(replace(bare, **extra))
    return whole


def segments_with_a_nameplate() -> list[Signals]:
    return [replace(s, motor=MOTOR, drive=DRIVE) for s in segments_alone()]


def segments_alone() -> list[Signals]:
    """Without model, nameplate, drive or history, at lengths, rates, PWM frequencies and angles of their own."""
    return [_alone(k, *facts) for k, facts in enumerate(zip(LENGTHS, SAMPLING_HZ, PWM_HZ, strict=True))]


def _alone(k: int, n: int, sampling_hz: float, pwm_hz: float) -> Signals:
    rng = np.random.default_rng(k)
    t = np.arange(n) / sampling_hz
    phase = 2.0 * np.pi * rng.uniform(10.0, 60.0) * t + rng.uniform(0.0, 6.0)
    # Of some segments all currents are small, of others large: knees and tables are met on both sides.
    size = (0.05, 2.0, 0.5, 6.0)[k % 4]
    i_ab = size * np.stack([np.cos(phase), 0.7 * np.sin(phase)], axis=1) + 4e-3 * rng.normal(size=(n, 2))
    square = np.where(np.arange(n) % 20 < 10, 40.0, -40.0)[:, None] * np.array([1.0, 0.5])
    theta = np.full(n, 0.4 * k) if k % 4 else 0.3 * k + 0.05 * np.sin(phase)
    return Signals(
        start_s=3.0 * (7 - k),
        sampling_frequency_hz=sampling_hz,
        pwm_frequency_hz=pwm_hz,
        i_ab=i_ab,
        v_ab=4.0 * i_ab + square + rng.normal(size=(n, 2)),
        v_dc=540.0 + rng.normal(size=n),
        theta_rad=theta,
        turned_rad=0.1 * (k % 3),
        resistance_ohm=4.0 + 0.1 * rng.random(n),
        i_m_ab=i_ab + 1e-3 * rng.normal(size=(n, 2)),
        heat_j=10.0 * (8 - k) + np.cumsum(rng.random(n)),
    )


def _losses(size: float) -> LossHistory:
    power_w = size * np.random.default_rng(9).uniform(1.0, 10.0, 40)
    return LossHistory(time_s=np.linspace(0.5, 20.0, 40), power_w=power_w)


def settings(parameters: type[EffectParameters]) -> Iterator[tuple[str, EffectParameters]]:
    """Each named: typical, the other way, every refinement off its neutral value alone and with the others."""
    declared = parameters.declared()
    typical = {p.name: p.typical for p in declared}
    refined = {
        p.name: p.neutral + 0.3 * min(p.prior_width, p.high - p.neutral)
        if p.high > p.neutral
        else p.neutral - 0.3 * p.prior_width
        for p in declared
        if p.role is ParameterRole.REFINEMENT
    }
    amplitudes = [p for p in declared if p.role is ParameterRole.AMPLITUDE and p.low < 0.0]
    opposite = {p.name: -p.typical for p in amplitudes}
    second = {p.name: p.other_form for p in declared if p.other_form is not None}
    yield "typical", parameters(**typical)
    yield "other_way", parameters(**typical | opposite)
    yield "refined", parameters(**typical | refined)
    yield "second", parameters(**typical | second)
    yield "second_refined", parameters(**typical | refined | second)
    for name, value in refined.items():
        yield f"{name}_alone", parameters(**typical | {name: value})
