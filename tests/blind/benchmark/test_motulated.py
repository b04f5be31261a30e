"""The third plant: its iron has an energy, and its drive does what its defects say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.blind.benchmark.motulated import Defects, Drive, Task, simulate
from tests.blind.benchmark.motulated_cases import PLATES, draw_drive
from tests.blind.magnetics import Machine


def drawn(motor: str = "pmsm_2k2") -> tuple[Machine, Drive]:
    plate, drive = draw_drive(np.random.default_rng(1), motor)
    return plate, replace(drive, noise_a=0.0, quantum_a=0.0, delay=0)


@pytest.mark.parametrize("motor", PLATES)
def test_its_iron_is_reciprocal_and_the_flux_is_the_current_s_inverse(motor: str) -> None:
    plate, drive = drawn(motor)
    iron, top = drive.saturation, plate.top_a
    for i_d, i_q in ((0.0, 0.0), (-0.9 * top, 0.7 * top), (0.5 * top, -top)):
        psi = complex(*iron.flux(i_d, i_q))
        assert iron.current(np.array([psi]))[0] == pytest.approx(complex(i_d, i_q), abs=1e-9 * top)
        step = 1e-5 * plate.rated_flux_wb

        def slope(along: complex, at: complex = psi, h: float = step) -> complex:
            ahead, behind = (iron.current(np.array([at + s * h * along]))[0] for s in (1, -1))
            return complex((ahead - behind) / (2 * h))

        assert slope(1j).real == pytest.approx(slope(1.0).imag, rel=1e-5, abs=1e-3 * abs(slope(1.0)))
    assert iron.flux(0.0, 0.0)[0] == pytest.approx(plate.pm_flux_wb, rel=0.01)


@pytest.mark.slow
def test_a_held_current_needs_r_i_and_what_the_defects_lose() -> None:
    pytest.importorskip("motulator")
    plate, drive = drawn()
    point = 0.5 * plate.top_a * np.exp(1j * (0.3 - drive.believed_rad))
    hold = Task("resistance", {}, np.full(200, point))
    turn, noise = np.exp(1j * drive.believed_rad), np.random.default_rng(0)

    def volts(**changes: object) -> complex:
        bench = replace(drive, defects=replace(Defects(), **changes))  # type: ignore[arg-type]
        ((current, voltage),) = simulate(bench, [hold], 4000, noise)
        assert np.allclose(current, point * turn, rtol=1e-4)
        return complex(voltage[-50:].mean())

    ideal = drive.resistance_ohm * point * turn
    assert volts() == pytest.approx(ideal, rel=1e-4)
    a, b, c = np.real(np.exp(-2j * np.pi / 3 * np.arange(3)) * point * turn)
    assert min(abs(a), abs(b), abs(c)) > 0.2
    signs = np.sign([a, b, c]) @ np.exp(2j * np.pi / 3 * np.arange(3))
    assert volts(dead_v=5.0, dead_knee_a=0.01) - ideal == pytest.approx(2 / 3 * 5.0 * signs, rel=1e-3)
    assert volts(extra_ohm=(0.5, 0.0)) - ideal == pytest.approx(2 / 3 * 0.5 * a, rel=1e-3)
