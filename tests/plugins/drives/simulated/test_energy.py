"""The plant's magnetics: reciprocity, parity, saturation as specified, and no surprises outside."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from plugins.drives.simulated import TrueMagnetics, map_motor, map_names, true_flux
from plugins.drives.simulated._map import load_table
from protocols import InputError, Motor
from tests.plugins.drives.simulated.conftest import MOTORS, PM400, options_of
from tests.support.cases import few
from tests.support.close import assert_close


def magnetics_of(motor: Motor, **magnetics: object) -> TrueMagnetics:
    return true_flux(options_of(plant={"magnetics": magnetics} if magnetics else {}), motor)


def shipped(name: str) -> TrueMagnetics:
    return magnetics_of(map_motor(name), kind="map", name=name)


def grid(reach: float, n: int = 9) -> np.ndarray:
    axis = np.linspace(-reach, reach, n)
    return np.array([[d, q] for d in axis for q in axis])


@pytest.mark.parametrize("motor", MOTORS)
def test_current_is_a_gradient_and_even_in_q(motor: Motor) -> None:
    truth = magnetics_of(motor)
    assert motor.rated_current_a is not None
    check_reciprocity_and_parity(truth, 1.5 * motor.rated_current_a)


@few("name", map_names())
def test_a_shipped_map_is_a_gradient_and_even_in_q(name: str) -> None:
    truth = shipped(name)
    rated = map_motor(name).rated_current_a
    assert rated is not None
    check_reciprocity_and_parity(truth, rated)


def check_reciprocity_and_parity(truth: TrueMagnetics, reach: float) -> None:
    i = grid(reach)
    psi = truth.flux(i)
    step = 1e-5 * float(np.ptp(psi[:, 0]))
    on_d, on_q = step * np.eye(2)
    d = (truth.current(psi + on_d) - truth.current(psi - on_d)) / (2 * step)
    q = (truth.current(psi + on_q) - truth.current(psi - on_q)) / (2 * step)
    assert np.abs(d[:, 1] - q[:, 0]).max() < 1e-6 * np.abs(d[:, 0]).max()
    mirrored = truth.flux(i * [1.0, -1.0])
    assert_close(mirrored, psi * [1.0, -1.0], 1e-12)
    numeric = np.linalg.inv(np.stack((d, q), axis=-1))
    assert_close(truth.inductance(i), numeric, 1e-4)


@pytest.mark.parametrize("motor", MOTORS)
def test_a_nameplate_motor_saturates_as_requested_whatever_its_size(motor: Motor) -> None:
    truth = magnetics_of(motor, kind="nameplate", d_fall=0.3, q_fall=0.5, cross=0.08)
    rated, l_d, l_q = motor.rated_current_a, motor.d_inductance_h, motor.q_inductance_h
    assert rated is not None
    assert l_d is not None
    assert l_q is not None
    none = truth.inductance(np.zeros((1, 2)))[0]
    assert_close(none, np.diag([l_d, l_q]), 1e-9)
    on_d, on_q = truth.inductance(np.array([[1.25 * rated, 0.0], [0.0, 1.25 * rated]]))
    assert on_d[0, 0] / l_d == pytest.approx(0.7, abs=1e-3)
    assert on_q[1, 1] / l_q == pytest.approx(0.5, abs=1e-3)
    diagonal = truth.inductance(np.array([[1.0, 1.0]]) * rated / math.sqrt(2))[0]
    assert abs(diagonal[0, 1]) / math.sqrt(l_d * l_q) == pytest.approx(0.08, abs=1e-3)


@pytest.mark.parametrize("motor", MOTORS)
def test_far_beyond_the_rated_current_flux_goes_on_growing_and_the_current_stays_continuous(motor: Motor) -> None:
    truth = magnetics_of(motor)
    assert motor.rated_current_a is not None
    assert motor.d_inductance_h is not None
    psi = truth.pm_flux_wb + np.linspace(0.0, 20.0, 4001) * motor.d_inductance_h * motor.rated_current_a
    i = truth.current(np.column_stack((psi, np.zeros_like(psi))))[:, 0]
    assert (np.diff(i) > 0).all()
    assert np.diff(i).max() < 12 * np.diff(i).min()


def test_the_linear_motor_is_linear() -> None:
    truth = magnetics_of(PM400, kind="nameplate", d_fall=0.0, q_fall=0.0, cross=0.0)
    i = grid(5.0)
    expected = np.column_stack((0.30 + 0.04325 * i[:, 0], 0.06905 * i[:, 1]))
    assert_close(truth.flux(i), expected, 1e-9)


def test_a_polynomial_with_given_coefficients_is_that_polynomial() -> None:
    a = {"a30": 9.0, "a12": 6.5, "a40": 40.0, "a22": 45.0, "a04": 45.0, "a06": 120.0}
    truth = magnetics_of(PM400, kind="polynomial", **a)
    x, y = 0.05, 0.1
    i_d = x / 0.04325 + 3 * a["a30"] * x**2 + a["a12"] * y**2 + 4 * a["a40"] * x**3 + 2 * a["a22"] * x * y**2
    i_q = y / 0.06905 + 2 * a["a12"] * x * y + 2 * a["a22"] * x**2 * y + 4 * a["a04"] * y**3 + 6 * a["a06"] * y**5
    assert truth.current(np.array([[0.30 + x, y]]))[0] == pytest.approx([i_d, i_q], rel=1e-12)


def test_an_energy_that_is_not_convex_is_refused() -> None:
    with pytest.raises(InputError, match="not convex"):
        magnetics_of(PM400, kind="polynomial", a30=200.0)


def test_the_measured_map_is_met_within_its_own_scatter() -> None:
    table, truth = load_table("baldor-5k6", None), shipped("baldor-5k6")
    error = truth.flux(table.i_dq) - table.psi_dq
    assert np.sqrt((error**2).mean()) < 6e-4  # of 1.3 Wb; the map's reciprocity is broken by about as much
    assert truth.pm_flux_wb == pytest.approx(0.444, abs=1e-3)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "not an .npz"),
        (b"i_d_A,i_q_A\n1,2\n", "not an .npz"),
    ],
)
def test_a_broken_npz_is_named(tmp_path: Path, content: bytes, complaint: str) -> None:
    path = tmp_path / "own.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=f"own.npz.*{complaint}"):
        magnetics_of(PM400, kind="map", file=str(path))


def grid_text(rows: int, columns: int, line: str) -> str:
    lines = (line.format(d=d, q=q) for d in range(rows) for q in range(columns))
    return "\n".join(("i_d_A,i_q_A,psi_d_Vs,psi_q_Vs", *lines))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "i_d_a"),
        ("i_d_A,i_q_A,psi_d_Vs\n1,2,3\n", "psi_q_wb"),
        ("i_d_A,i_q_A,psi_d_Vs,psi_q_Vs\n1,2,x,4\n", "a number"),
        ("i_d_A,i_q_A,psi_d_Vs,psi_q_Vs\n1,2,3,4\n", "too few"),
        (grid_text(3, 4, "{d},{q},{d},{q}"), "16 points"),
        (grid_text(5, 5, "{d},{q},nan,{q}"), "fewer than three"),
        ("i_d_A,i_q_A,psi_d_Vs,psi_q_Vs\n" + "1,2,3,4\n" * 20, "grid"),
    ],
)
def test_a_broken_csv_is_named(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "own.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=f"own.csv.*{complaint}"):
        magnetics_of(PM400, kind="map", file=str(path))


def test_an_unknown_map_is_answered_with_the_names() -> None:
    with pytest.raises(InputError, match="baldor-5k6"):
        magnetics_of(PM400, kind="map", name="baldur")


def test_a_nameplate_that_lacks_an_inductance_is_answered_with_the_field() -> None:
    with pytest.raises(InputError, match="d_inductance_h"):
        magnetics_of(PM400.model_copy(update={"d_inductance_h": None}))
