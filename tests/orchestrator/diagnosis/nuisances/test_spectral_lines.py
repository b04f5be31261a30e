"""Lines in the spectrum of the readings, each against what defines it."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.criteria import WeakFormCriteria
from orchestrator.diagnosis.nuisances.spectral_lines import added_noise, find_lines, spectrum_of
from orchestrator.numerics.types import Array

CRITERIA = WeakFormCriteria()
FS = 10_000.0
NOISE_A = 0.004


def _holds(ripple_a: Array, frequency_hz: float, seed: int = 1) -> list[Array]:
    rng = np.random.default_rng(seed)
    t = np.arange(2500) / FS
    turns = [2.0 * np.pi * (frequency_hz * t + rng.random()) for _ in ripple_a]
    noise = (rng.normal(0.0, NOISE_A, (len(t), 2)) for _ in ripple_a)
    return [
        spectrum_of(n + a * np.stack([np.cos(x), np.sin(x)], axis=1))
        for a, x, n in zip(ripple_a, turns, noise, strict=True)
    ]


def test_noise_has_no_lines() -> None:
    assert find_lines(_holds(np.zeros(20), 300.0), _holds(np.zeros(1), 300.0), FS) == ()


def test_a_current_that_is_still_settling_is_no_line() -> None:
    t = np.arange(1500) / FS
    tail = 0.5 * np.exp(-t / 0.015)[:, None] * np.stack([np.cos(60.0 * t), np.sin(60.0 * t)], axis=1)
    rng = np.random.default_rng(1)
    settling = [spectrum_of(tail + rng.normal(0.0, NOISE_A, (len(t), 2))) for _ in range(20)]
    assert find_lines(settling, [], FS) == ()


def test_ripple_alike_in_every_hold_and_absent_with_the_bridge_off_is_switching_ripple() -> None:
    (line,) = find_lines(_holds(np.full(20, 0.01), 131.7), _holds(np.zeros(1), 131.7, seed=2), FS)
    assert line.switching
    assert line.frequency_hz == pytest.approx(131.7, abs=4.0)
    assert line.power == pytest.approx(0.5 * 0.01**2, rel=0.1)


@pytest.mark.parametrize(("ripple_a", "off_a"), [(np.linspace(0.0, 0.02, 20), 0.0), (np.full(20, 0.01), 0.01)])
def test_ripple_that_grows_or_stays_with_the_bridge_off_is_not(ripple_a: Array, off_a: float) -> None:
    (line,) = find_lines(_holds(ripple_a, 300.0), _holds(np.array([off_a]), 300.0, seed=2), FS)
    assert not line.switching


def test_readings_that_alternate_are_a_line_at_half_the_sampling_frequency() -> None:
    rng = np.random.default_rng(3)
    odd = 0.003 * (-1.0) ** np.arange(2500)
    holds = [spectrum_of(rng.normal(0.0, NOISE_A, (2500, 2)) + odd[:, None]) for _ in range(12)]
    (line,) = find_lines(holds, [], FS)
    assert line.frequency_hz == pytest.approx(FS / 2.0)
    assert not line.switching


def test_noise_that_a_line_adds_is_what_it_does_to_the_equation() -> None:
    (line,) = find_lines(_holds(np.full(20, 0.01), 131.7), _holds(np.zeros(1), 131.7, seed=2), FS)
    step, ohm, henry = 100, 4.0, 0.05
    w = np.concatenate([[0.0], 1.0 - np.abs(np.arange(-step, step + 1)) / step, [0.0]])
    weight = ohm / FS * 0.5 * (w[1:] + w[:-1]) + henry * np.diff(w)
    phase = 2.0 * np.pi * (131.7 / FS * np.arange(len(weight)) + np.random.default_rng(4).random((4000, 1)))
    made = float(np.var(0.01 * np.cos(phase) @ weight)) / (NOISE_A**2 * float(weight @ weight))
    assert added_noise(line, FS, 1, float(step), ohm, henry, NOISE_A**2) == pytest.approx(made, rel=0.2)
