"""A map written in each of the shapes that tools use comes back as the same map, within interpolation error."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from orchestrator.flux_maps import MapFile, audit_map, read_map
from orchestrator.numerics.types import Array
from protocols import FluxMap, InputError

AnyArray = NDArray[np.floating[Any]]
HEAD = "format: fluxbench-map\nversion: 1\nfile: t.npz\nflux: {columns: {d: FD, q: FQ}, unit: Wb}\n"
AXES = "current: {columns: {d: ID, q: IQ}, unit: A}\n"
EXACT, INTERPOLATED, COARSE = 1e-9, 2e-3, 5e-3
"""Of the flux' swing: rounding, and what some two hundred points, or half as many, leave of a saturation curve."""


@dataclass(frozen=True)
class Machine:
    """The gradient of an even and convex co-energy, L_d i_d^2 + L_q i_q^2 saturating with a knee at `knee_a`."""

    magnet_wb: float
    d_h: float
    q_h: float
    knee_a: float
    reach_a: float
    nodes: int

    def psi(self, i: AnyArray) -> Array:
        sizes = np.array([self.d_h, self.q_h])
        ratio = (i**2 @ sizes) / (self.q_h * self.knee_a**2)
        flux: Array = i * sizes / np.sqrt(1.0 + ratio)[..., None] + [self.magnet_wb, 0.0]
        return flux

    @property
    def axis(self) -> Array:
        return np.linspace(-self.reach_a, self.reach_a, self.nodes)


@st.composite
def machines(draw: st.DrawFn) -> Machine:
    q_h, reach_a = 10.0 ** draw(st.floats(-4.0, -1.0)), 10.0 ** draw(st.floats(0.0, 2.5))
    return Machine(
        magnet_wb=q_h * reach_a * draw(st.floats(0.0, 2.0)),
        d_h=q_h * draw(st.floats(0.25, 1.0)),
        q_h=q_h,
        knee_a=reach_a * draw(st.floats(0.7, 3.0)),
        reach_a=reach_a,
        nodes=draw(st.integers(9, 15)),
    )


def read(more: str, **arrays: AnyArray) -> MapFile:
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "t.npz", **arrays)  # type: ignore[arg-type]
        (Path(folder) / "t.yaml").write_text(HEAD + more)
        return read_map(Path(folder) / "t.yaml")


def error_of(machine: Machine, found: FluxMap) -> float:
    """The largest error at the nodes, of the flux' swing."""
    i = np.stack(np.meshgrid(found.i_d, found.i_q, indexing="ij"), axis=-1)
    apart = np.stack((found.psi_d, found.psi_q), axis=-1) - machine.psi(i)
    known = np.isfinite(apart)
    assert known.sum() > 0.5 * known.size
    swing = 0.5 * np.ptp(machine.psi(i), axis=(0, 1)).max()
    return float(np.abs(apart[known]).max() / swing)


def over_axes(machine: Machine) -> tuple[Array, Array]:
    flux = machine.psi(np.stack(np.meshgrid(machine.axis, machine.axis, indexing="ij"), axis=-1))
    return flux[..., 0], flux[..., 1]


@given(machine=machines(), along_columns=st.booleans())
def test_square_tables_are_reported_by_their_values(machine: Machine, along_columns: bool) -> None:
    psi_d, psi_q = (table.T if along_columns else table for table in over_axes(machine))
    found = read(AXES, ID=machine.axis, IQ=machine.axis, FD=psi_d, FQ=psi_q)
    assert error_of(machine, found.flux_map) < EXACT
    assert [remark.values["axes"] for remark in found.remarks] == ["q, d" if along_columns else "d, q"]


def test_axes_say_what_values_cannot() -> None:
    axis = np.array([-1.0, 0.0, 1.0])
    tables = {"FD": np.ones((3, 3)), "FQ": np.add.outer(axis, 1.5 * axis)}
    with pytest.raises(InputError, match=r"set axes: \[d, q\] or \[q, d\]"):
        read(AXES, ID=axis, IQ=axis, **tables)
    found = read(AXES + "axes: [q, d]\n", ID=axis, IQ=axis, **tables).flux_map
    np.testing.assert_allclose(found.psi_q, np.add.outer(1.5 * axis, axis))
    with pytest.raises(InputError, match="expected each of d, q once, got d, theta"):
        read(AXES + "axes: [d, theta]\n", ID=axis, IQ=axis, **tables)
    with pytest.raises(InputError, match=r"tables of shape \(3, 3\), but q has 2, d has 3"):
        read(AXES + "axes: [q, d]\n", ID=axis, IQ=axis[:2], **tables)


@given(
    machine=machines(),
    dimensions=st.permutations([0, 1, 2]),
    closed=st.booleans(),
    order=st.sampled_from([6, 12]),
    as_table=st.booleans(),
)
def test_over_a_rotor_angle_the_mean_is_the_map(
    machine: Machine, dimensions: list[int], closed: bool, order: int, as_table: bool
) -> None:
    angles = 60.0 / 8 * np.arange(9 if closed else 8)
    ripple = 0.01 * machine.q_h * machine.reach_a * np.cos(np.radians(order * angles) + 0.3)
    tables = [table[..., None] + ripple for table in over_axes(machine)]
    axes = [machine.axis, machine.axis, angles]
    if as_table:
        axes = [x.transpose(dimensions) for x in np.meshgrid(*axes, indexing="ij")]
    psi_d, psi_q = (table.transpose(dimensions) for table in tables)
    more = AXES + "rotor_angle: {column: TH, unit: deg}\n"
    found = read(more, ID=axes[0], IQ=axes[1], TH=axes[2], FD=psi_d, FQ=psi_q)
    assert error_of(machine, found.flux_map) < EXACT
    remark = found.remarks[-1]
    assert remark.values["span_deg"] == pytest.approx(60.0)
    assert remark.values["order"] == pytest.approx(order)
    assert remark.values["d_mwb"] == pytest.approx(1e3 * 0.01 * machine.q_h * machine.reach_a)
    assert "no multiple" not in remark.text


def test_angles_of_the_shaft_are_multiplied_by_pole_pairs_and_others_doubted() -> None:
    machine = Machine(0.1, 1e-3, 2e-3, 10.0, 10.0, 9)
    angles = np.arange(0.0, 15.0, 2.5)
    tables = [table[..., None] + 1e-4 * np.cos(np.radians(24 * angles)) for table in over_axes(machine)]
    arrays = {"ID": machine.axis, "IQ": machine.axis, "TH": angles, "FD": tables[0], "FQ": tables[1]}
    shaft = "rotor_angle: {column: TH, unit: deg, mechanical: true}\nmotor: {name: x, pole_pairs: 4}\n"
    (_, remark) = read(AXES + shaft, **arrays).remarks
    assert remark.values["span_deg"] == pytest.approx(60.0)
    assert remark.values["order"] == pytest.approx(6.0)
    (_, remark) = read(AXES + "rotor_angle: {column: TH, unit: deg}\n", **arrays).remarks
    assert "span 15 electrical degrees, which is no multiple of 60: is the angle the shaft's" in remark.text
    with pytest.raises(InputError, match=r"rotor_angle: mechanical needs motor"):
        read(AXES + shaft.partition("\n")[0] + "\n", **arrays)


def test_a_third_dimension_is_a_rotor_angle_only_by_its_name() -> None:
    machine = Machine(0.1, 1e-3, 2e-3, 10.0, 10.0, 9)
    tables = dict(zip(("FD", "FQ"), (np.repeat(t[..., None], 8, axis=2) for t in over_axes(machine)), strict=True))
    angles = np.arange(0.0, 60.0, 7.5)
    found = read(AXES, ID=machine.axis, IQ=machine.axis, angleVec=angles, **tables)
    assert error_of(machine, found.flux_map) < EXACT
    with pytest.raises(InputError, match="name their third axis, rotor_angle"):
        read(AXES, ID=machine.axis, IQ=machine.axis, temperature=angles, **tables)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda i, th: (i[:-1], th[:-1]), "1 of 81 currents lack some of the 8 rotor angles"),
        (lambda i, th: (i, np.where(th > 50.0, 59.0, th)), "angles are not evenly spaced"),
        (lambda i, th: (i, 0.0 * th), "fewer than two rotor angles"),
        (lambda i, th: (i, np.where(th > 50.0, np.nan, th)), "an angle is not finite"),
        (lambda i, th: (1e30 * i, th), "too large for a motor"),
    ],
)
def test_rotor_angles_that_make_no_mean_are_refused(spoil: object, message: str) -> None:
    assert callable(spoil)
    machine = Machine(0.1, 1e-3, 2e-3, 10.0, 10.0, 9)
    i_d, i_q, theta = (
        x.ravel() for x in np.meshgrid(machine.axis, machine.axis, np.arange(0.0, 60.0, 7.5), indexing="ij")
    )
    i, theta = spoil(np.column_stack((i_d, i_q)), theta)
    flux = machine.psi(i)
    with pytest.raises(InputError, match=message):
        read(
            AXES + "rotor_angle: {column: TH, unit: deg}\n",
            ID=i[:, 0], IQ=i[:, 1], TH=theta, FD=flux[:, 0], FQ=flux[:, 1],
        )  # fmt: skip


@given(
    machine=machines(), from_q=st.booleans(), clockwise=st.booleans(), as_axes=st.booleans(), transposed=st.booleans()
)
def test_polar_grids_come_back_from_currents_or_from_amplitude_and_angle(
    machine: Machine, from_q: bool, clockwise: bool, as_axes: bool, transposed: bool
) -> None:
    amplitudes, angles = np.linspace(0.0, machine.reach_a, 9), np.linspace(-180.0, 180.0, 25)
    amplitude, angle = np.meshgrid(amplitudes, angles, indexing="ij")
    turned = np.radians((-angle if clockwise else angle) + (90.0 if from_q else 0.0))
    i = amplitude[..., None] * np.stack((np.cos(turned), np.sin(turned)), axis=-1)
    psi_d, psi_q = np.moveaxis(machine.psi(i), -1, 0)
    if as_axes:
        factor = ", factor: -1" if clockwise else ""
        more = f"angle: {{unit: deg, zero: {'q' if from_q else 'd'}{factor}}}"
        psi_d, psi_q = (table.T if transposed else table for table in (psi_d, psi_q))
        text = f"current: {{columns: {{amplitude: I, angle: B}}, unit: A, {more}}}\n"
        found = read(text, I=amplitudes, B=angles, FD=psi_d, FQ=psi_q)
    else:
        found = read(AXES, ID=i[..., 0], IQ=i[..., 1], FD=psi_d, FQ=psi_q)
    assert error_of(machine, found.flux_map) < INTERPOLATED
    assert "regridded" in {remark.code for remark in found.remarks}
    assert {0.0} <= set(found.flux_map.i_d.tolist()) & set(found.flux_map.i_q.tolist())


@given(machine=machines(), along_columns=st.booleans())
def test_currents_over_fluxes_are_the_inverse_of_the_map(machine: Machine, along_columns: bool) -> None:
    reach = machine.psi(np.array([[machine.reach_a, 0.0], [0.0, machine.reach_a]]))
    fluxes = np.stack(
        np.meshgrid(
            machine.magnet_wb + np.linspace(-1.0, 1.0, 15) * (reach[0, 0] - machine.magnet_wb),
            np.linspace(-1.0, 1.0, 15) * reach[1, 1],
            indexing="ij",
        ),
        axis=-1,
    )
    i = inverted(machine, fluxes)
    tables = [table.T if along_columns else table for table in (i[..., 0], i[..., 1])]
    found = read(AXES, ID=tables[0], IQ=tables[1], FD=fluxes[:, 0, 0], FQ=fluxes[0, :, 1])
    assert error_of(machine, found.flux_map) < COARSE


def inverted(machine: Machine, fluxes: Array) -> Array:
    """Currents at fluxes, NaN beyond the map's reach: i = x sqrt(1 + r) where r / (1 + r) is known from the flux."""
    sizes = np.array([machine.d_h, machine.q_h])
    x = (fluxes - [machine.magnet_wb, 0.0]) / sizes
    share = (x**2 @ sizes) / (machine.q_h * machine.knee_a**2)
    i: Array = x / np.sqrt(np.where(share < 1.0, 1.0 - share, np.nan))[..., None]
    return np.where(np.abs(i).max(axis=-1, keepdims=True) <= 1.2 * machine.reach_a, i, np.nan)


@given(machine=machines(), seed=st.integers(0, 1000))
def test_scattered_points_are_interpolated(machine: Machine, seed: int) -> None:
    from scipy.stats import qmc

    i = machine.reach_a * (2.0 * qmc.Halton(2, seed=seed).random(200) - 1.0)
    flux = machine.psi(i)
    found = read(AXES, ID=i[:, 0], IQ=i[:, 1], FD=flux[:, 0], FQ=flux[:, 1])
    assert error_of(machine, found.flux_map) < INTERPOLATED
    # Predicted from four fifths of the points, also at the rim, where no neighbour stands beyond.
    assert 0.0 <= float(found.remarks[0].values["error_percent"] or 0.0) < 100.0 * COARSE


@given(machine=machines(), seed=st.integers(0, 1000))
def test_currents_that_miss_their_set_points_give_the_flux_there(machine: Machine, seed: int) -> None:
    step = 2.0 * machine.reach_a / (machine.nodes - 1)
    i = np.stack(np.meshgrid(machine.axis, machine.axis, indexing="ij"), axis=-1).reshape(-1, 2)
    i = i + 0.03 * step * np.random.default_rng(seed).uniform(-1.0, 1.0, i.shape)
    flux = machine.psi(i)
    found = read(AXES, ID=i[:, 0], IQ=i[:, 1], FD=flux[:, 0], FQ=flux[:, 1])
    assert found.flux_map.psi_d.shape == (machine.nodes, machine.nodes)
    assert np.isfinite(found.flux_map.psi_d).all()
    assert error_of(machine, found.flux_map) < INTERPOLATED
    assert "set-points" in found.remarks[0].text


@pytest.mark.parametrize(
    ("currents", "message"),
    [
        ([(k, 0.7 * k * k) for k in range(1, 40)], "nor cover an area"),
        ([(k, 0.0) for k in range(-10, 11)] + [(0.0, k) for k in range(-10, 11)], "nor cover an area"),
        ([(np.cos(k), np.sin(k)) for k in range(40)], "nor cover an area"),
        ([(0.0, 1.0), (1.0, 0.3), (2.1, 5.0), (3.3, 2.2), (4.6, 3.1)], "too few to interpolate"),
        (
            [(8 * x + np.cos(k), 8 * y + np.sin(k)) for x, y in ((-1, -1), (1, -1), (0, 1)) for k in range(12)],
            "of the area between them unmeasured",
        ),
    ],
)
def test_points_that_span_no_map_are_refused(currents: list[tuple[float, float]], message: str) -> None:
    i = np.array(currents, dtype=float)
    with pytest.raises(InputError, match=message):
        read(AXES, ID=i[:, 0], IQ=i[:, 1], FD=0.1 + 1e-3 * i[:, 0], FQ=2e-3 * i[:, 1])


def test_fluxes_that_contradict_each_other_at_one_current_are_refused() -> None:
    machine = Machine(0.1, 1e-3, 2e-3, 10.0, 10.0, 9)
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    i = np.concatenate([r * np.column_stack((np.cos(angles), np.sin(angles))) for r in (3.0, 6.0, 10.0)])
    flux = machine.psi(i)
    repeated = read(AXES, **columns_of(np.vstack((i, i[:5])), np.vstack((flux, flux[:5] + 1e-6))))
    assert error_of(machine, repeated.flux_map) < 2 * COARSE
    with pytest.raises(InputError, match="occurs more than once, with fluxes 10 mWb apart"):
        read(AXES, **columns_of(np.vstack((i, i[:5])), np.vstack((flux, flux[:5] + 1e-2))))


def columns_of(i: Array, flux: Array) -> dict[str, Array]:
    return {"ID": i[:, 0], "IQ": i[:, 1], "FD": flux[:, 0], "FQ": flux[:, 1]}


def test_a_map_that_was_interpolated_is_judged_as_the_machine_is() -> None:
    machine = Machine(0.1, 1e-3, 2e-3, 10.0, 10.0, 9)
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    i = np.concatenate([r * np.column_stack((np.cos(angles), np.sin(angles))) for r in np.linspace(1.0, 10.0, 10)])
    assert audit_map(read(AXES, **columns_of(i, machine.psi(i))).flux_map).faults == ()
