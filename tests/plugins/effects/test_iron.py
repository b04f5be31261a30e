"""Iron and magnets: each correction undoes the catalogue's equation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from orchestrator.diagnosis.weak_form.segments import late_beside, mean_between
from orchestrator.numerics.types import Array
from plugins.effects.iron import EddyCurrents, Hysteresis, MagnetHeating, SlotHarmonics
from plugins.effects.timing import VoltageDelay
from protocols import LossHistory, Signals
from tests.plugins.effects.readings import FS, corrected, readings
from tests.support.close import assert_close


def test_eddy_current_follows_the_voltage_before_the_sample() -> None:
    signals = readings()
    out = corrected(EddyCurrents(), signals, core_loss_ohm=1000.0, lag_s=1e-7)
    eddy = (signals.v_ab[9] - 4.0 * signals.i_ab[10]) / 1000.0
    np.testing.assert_allclose(signals.i_m_ab[10] - out.i_m_ab[10], eddy)


@pytest.mark.parametrize("lag_s", [5e-6, 8e-5, 5e-4])
def test_a_late_eddy_current_bends_between_samples_as_an_exponential(lag_s: float) -> None:
    """Its mean over an interval, beside the mean of both ends, is in the resistive drop that the voltage loses."""
    v = np.random.default_rng(2).normal(size=(400, 2))
    signals = replace(readings(), v_ab=v, i_ab=np.zeros((400, 2)), i_m_ab=np.zeros((400, 2)))
    out = corrected(EddyCurrents(), signals, core_loss_ohm=1000.0, lag_s=lag_s)
    eddy = -out.i_m_ab
    decay = math.exp(-1.0 / (lag_s * FS))
    mean = v / 1000.0 + (eddy - v / 1000.0) * lag_s * FS * (1.0 - decay)
    after = v / 1000.0 + (eddy - v / 1000.0) * decay
    bend = 4.0 * (mean - 0.5 * (eddy + after))
    assert_close((v - out.v_ab)[:-1], bend[:-1], 1e-9, of=bend)
    assert_close(eddy[1:], after[:-1], 1e-12, of=eddy)


@pytest.mark.parametrize(("lag_s", "part", "within"), [(1e-7, 0.3, 1e-9), (5e-5, 0.5, 1e-9), (5e-5, 0.2, 0.1)])
def test_eddies_behind_a_late_voltage_follow_what_it_was_at_the_reading(
    lag_s: float, part: float, within: float
) -> None:
    """Beside an exponential through both voltages of each interval: exact without a lag, and at half of one."""
    v = np.random.default_rng(2).normal(size=(400, 2))
    nil = np.zeros((400, 2))
    signals = replace(readings(), v_ab=v, i_ab=nil, i_m_ab=nil)
    late = corrected(VoltageDelay(), signals, delay_s=part / FS)
    eddy = -1000.0 * corrected(EddyCurrents(), late, core_loss_ohm=1000.0, lag_s=lag_s).i_m_ab
    old, new = (math.exp(-share / (lag_s * FS)) for share in (part, 1.0 - part))
    expected = np.zeros((400, 2))
    for k in range(1, 399):
        midway = v[k - 1] + (expected[k] - v[k - 1]) * old
        expected[k + 1] = v[k] + (midway - v[k]) * new
    assert_close(eddy[60:], expected[60:], within, of=expected)


def test_a_delay_that_the_drive_declares_is_felt_as_one_that_is_found() -> None:
    signals = readings()
    found = corrected(VoltageDelay(), signals, delay_s=0.4 / FS)
    command = np.asarray(signals.v_ab, dtype=np.float64)
    beside = late_beside(command, 0.4)
    assert beside is not None
    assert found.v_late_ab is not None
    assert_close(mean_between(command, 1, 0.4), found.v_ab, 1e-12, of=found.v_ab)
    assert_close(beside, found.v_late_ab, 1e-12, of=found.v_ab)
    assert late_beside(command, 1.0) is None


def test_what_eddies_feel_of_a_small_delay_is_small() -> None:
    """Early or late: a search walks through none at all without a step."""
    signals = readings()
    felt = [
        corrected(
            EddyCurrents(), corrected(VoltageDelay(), signals, delay_s=by), core_loss_ohm=1000.0, lag_s=1e-7
        ).i_m_ab
        for by in (-1e-9, 0.0, 1e-9)
    ]
    assert_close(felt[0], felt[1], 1e-4, of=signals.i_m_ab)
    assert_close(felt[2], felt[1], 1e-4, of=signals.i_m_ab)


def test_a_damper_may_be_on_one_axis_alone() -> None:
    signals = readings()
    axis_d = np.array([math.cos(0.2), math.sin(0.2)])
    both = signals.i_m_ab - corrected(EddyCurrents(), signals, core_loss_ohm=1000.0).i_m_ab
    damped = signals.i_m_ab - corrected(EddyCurrents(), signals, core_loss_ohm=1000.0, saliency=1.0).i_m_ab
    assert_close(damped @ axis_d, 2.0 * both @ axis_d, 1e-12, of=both)
    assert np.abs(damped @ np.array([-axis_d[1], axis_d[0]])).max() < 1e-12 * np.abs(both).max()


def _felt(v: Array, **values: float) -> Array:
    """The eddy current (n,) of a voltage without any other current, for a conductance of one."""
    nil = np.zeros((len(v), 2))
    signals = replace(readings(len(v)), v_ab=np.outer(v, [1.0, 0.0]), i_ab=nil, i_m_ab=nil)
    eddy = -1000.0 * corrected(EddyCurrents(), signals, core_loss_ohm=1000.0, **values).i_m_ab
    return np.asarray(eddy[:, 0], dtype=np.float64)


def test_spread_eddies_are_those_of_their_time_constants() -> None:
    v = np.random.default_rng(3).normal(size=400)
    both = _felt(v, lag_s=2e-4, faster=0.5)
    shares = 0.5 ** np.arange(5.0)
    single = [_felt(v, lag_s=2e-4 / 4.0**k) for k in range(5)]
    assert_close(both, np.tensordot(shares / shares.sum(), single, axes=1), 1e-12)


@pytest.mark.parametrize("hz", [40.0, 160.0])
def test_eddies_in_thick_iron_fall_with_the_root_of_frequency(hz: float) -> None:
    """Four times the frequency, half the current, an eighth of a turn behind the voltage."""
    t = np.arange(20_000) / FS
    waves = [np.exp(2j * np.pi * f * t) for f in (hz, 4.0 * hz)]
    felt = [_felt(wave.real, lag_s=1e-3, slower=2.0, faster=0.5) for wave in waves]
    there, at_four_times = (2.0 * np.mean((i / wave)[10_000:]) for i, wave in zip(felt, waves, strict=True))
    assert abs(there) / abs(at_four_times) == pytest.approx(2.0, rel=0.1)
    # The voltage of an interval is felt at its end.
    assert np.angle(there) + np.pi * hz / FS == pytest.approx(-0.25 * np.pi, abs=0.1)


def test_a_constant_voltage_was_there_before_a_segment() -> None:
    assert_close(_felt(np.ones(100), lag_s=5e-3), np.ones(100), 1e-12)


def test_a_wave_was_there_before_a_segment() -> None:
    """Its slow current is near zero, not what the first voltage alone would have made of it."""
    v = np.where(np.arange(6000) % 20 < 10, 1.0, -1.0)
    whole, part = _felt(v, lag_s=5e-3)[4000:], _felt(v[4000:], lag_s=5e-3)
    assert np.abs(part - whole)[1:].max() < 0.2 < 0.2 * np.abs(v[4000] - whole[1])


def _with_flux(signals: Signals) -> Signals:
    """Of a machine whose inductance is the same all around."""
    inductance = math.sqrt(0.043 * 0.069)
    return replace(signals, psi_smooth_ab=inductance * np.asarray(signals.i_ab))


def test_slots_that_ask_for_current_are_those_that_give_flux_where_iron_is_linear() -> None:
    signals = _with_flux(readings())
    inductance = math.sqrt(0.043 * 0.069)
    volts, amps = (corrected(SlotHarmonics(), signals, relative=0.02, by_flux=part) for part in (0.0, 1.0))
    given = np.diff(inductance * (amps.i_m_ab - signals.i_m_ab), axis=0) * FS
    assert_close(given, (signals.v_ab - volts.v_ab)[:-1], 1e-9)
    assert_close(amps.v_ab, signals.v_ab, 1e-12)
    assert_close(volts.i_m_ab, signals.i_m_ab, 0.0)


@pytest.mark.parametrize("name", ["across", "along_d", "along_q"])
@pytest.mark.parametrize("part", [0.0, 1.0])
def test_slots_differ_only_where_the_rotor_is_turned(name: str, part: float) -> None:
    signals = _with_flux(readings())
    values = {"relative": 0.02, "by_flux": part}
    turned = replace(signals, turned_rad=0.3)
    for there, as_much in ((signals, True), (turned, False)):
        mere, more = (corrected(SlotHarmonics(), there, **values, **other) for other in ({}, {name: 0.05}))
        same = np.allclose(mere.v_ab, more.v_ab) and np.allclose(mere.i_m_ab, more.i_m_ab)
        assert same is as_much


def _loop(values: dict[str, float], swing_wb: float, around_wb: float = 0.0) -> tuple[Array, Array]:
    k = np.arange(4000)
    psi = np.stack([around_wb + swing_wb * np.sin(2 * np.pi * k / 1000), np.zeros(4000)], axis=1)
    signals = replace(readings(4000), psi_smooth_ab=psi, theta_rad=np.zeros(4000))
    held = signals.i_m_ab - corrected(Hysteresis(), signals, **values).i_m_ab
    return psi[:, 0], held[:, 0]


def test_hysteresis_loop_is_as_wide_as_stated_and_loses_energy() -> None:
    psi, held = _loop({"half_width_a": 0.03, "yield_wb": 0.015}, 0.2)
    assert held.max() == pytest.approx(0.03, rel=1e-6)
    assert held.min() == pytest.approx(-0.03, rel=1e-6)
    area = float(np.sum(0.5 * (held[3000:-1] + held[3001:]) * np.diff(psi[3000:])))
    assert area > 0.0


def test_small_hysteresis_loops_are_reversible() -> None:
    psi, held = _loop({"half_width_a": 0.03, "yield_wb": 0.015}, 0.001)
    slope = np.polyfit(psi, held, 1)[0]
    assert slope == pytest.approx(0.03 / 0.015, rel=1e-6)


@pytest.mark.parametrize("apart", [0.0, 1.0])
def test_saturated_iron_is_stiffer_to_small_loops_by_what_its_field_rises_faster_and_its_large_ones_are_as_wide(
    apart: float,
) -> None:
    form = {"half_width_a": 0.03, "yield_wb": 0.015, "stiffening_per_wb2": 4.0, "by_axes": apart}
    for around in (0.0, 0.4):
        psi, held = _loop(form, 0.0005, around)
        slope = np.polyfit(psi[2000:], held[2000:], 1)[0]
        assert slope == pytest.approx(2.0 * (1.0 + 3.0 * 4.0 * around**2), rel=1e-3)
    _, wide = _loop(form, 0.5)
    assert np.abs(wide).max() == pytest.approx(0.03, rel=1e-6)


def _jiles_and_atherton(field: Array, pinning: float, reversible: float) -> Array:
    """Magnetisation by a field, both in their saturation's units, from nothing; fields do not act on each other."""
    anhysteretic = np.tanh(field)
    irreversible, out = 0.0, np.zeros_like(field)
    for k in range(1, len(field)):
        step = field[k] - field[k - 1]
        away = anhysteretic[k] - irreversible
        if away * step > 0.0:
            irreversible += (1.0 - math.exp(-abs(step) / pinning)) * away
        out[k] = (1.0 - reversible) * irreversible + reversible * anhysteretic[k]
    return out


def test_jiles_and_atherton_leave_less_of_soft_stops_and_less_again_of_those_that_stiffen() -> None:
    """Each at its best, beside the field of iron without hysteresis."""
    time = np.arange(6000) / 1000
    # A large loop, and smaller ones around a bias, as an injection makes them.
    field = np.where(time < 3.0, 0.9, 0.25) * np.sin(2 * np.pi * time) + np.where(time < 3.0, 0.0, 0.5)
    flux = 0.3 * _jiles_and_atherton(field, pinning=0.1, reversible=0.2)
    psi = np.stack([flux, np.zeros(6000)], axis=1)
    signals = replace(readings(6000), psi_smooth_ab=psi, theta_rad=np.zeros(6000))
    without = np.stack([np.arctanh(flux / 0.3), flux, flux**3, flux**5], axis=1)

    def left(x: Array, names: tuple[str, ...]) -> Array:
        values = {"yield_wb": math.exp(x[0]), **dict(zip(names, np.exp(x[1:]), strict=True))}
        held = signals.i_m_ab - corrected(Hysteresis(), signals, half_width_a=0.1, **values).i_m_ab
        columns = np.column_stack([without, held[:, 0]])[1000:]
        return np.asarray(field[1000:] - columns @ np.linalg.lstsq(columns, field[1000:])[0])

    start = {"softness": 0.5, "stiffening_per_wb2": 2.0}
    forms: tuple[tuple[str, ...], ...] = ((), ("softness",), ("softness", "stiffening_per_wb2"))
    sharp, soft, stiff = (
        float(np.std(least_squares(left, [math.log(0.03), *(start[n] for n in names)], args=(names,)).fun))
        for names in forms
    )
    assert soft < 0.8 * sharp
    assert stiff < 0.9 * soft


def test_a_hysteresis_loop_keeps_its_form_whatever_its_width() -> None:
    """So the step from none says what any width does, and a search is not led astray by the typical one."""
    form = {"yield_wb": 0.015, "variance": 0.3, "early_share": 0.4, "softness": 0.5}
    wide, narrow = (_loop({"half_width_a": width, **form}, 0.02)[1] for width in (0.03, 0.001))
    assert_close(30.0 * narrow, wide, 1e-9, of=wide)


def test_stops_that_hold_out_alike_are_one_however_they_share_and_else_yield_apart() -> None:
    """What yields first is then no matter of which stop it is: a search is not trapped on the wrong side of none."""
    sizes = {"half_width_a": 0.03, "yield_wb": 0.015}
    psi, alike = _loop(sizes, 0.2)
    _, unequal = _loop({**sizes, "early_share": 0.8}, 0.2)
    assert_close(unequal, alike, 1e-12, of=alike)
    # 30 mA in all of 1.6 A/Wb: 10 mA of 1 A/Wb and 20 mA of 0.6 A/Wb yield at 10 and 33 mWb.
    two = {"early_share": 1.0 / 1.6, "variance": (0.5 * math.log(10.0 / 3.0)) ** 2}
    _, apart = _loop({"half_width_a": 0.03, "yield_wb": 0.03 / 1.6, **two}, 0.2)
    falling = slice(3250, 3750)
    fallen = apart[3250] - apart[falling]
    swing = psi[3250] - psi[falling]
    expected = np.minimum(1.0 * swing, 0.02) + np.minimum(0.6 * swing, 0.04)
    assert_close(fallen, expected, 0.02, of=expected)


def test_a_third_stop_yields_between_the_two() -> None:
    """Of 2 A/Wb half are the middle one's; the others yield at half and at twice its flux."""
    form = {"middle_share": 0.5, "variance": math.log(2.0) ** 2}
    psi, held = _loop({"half_width_a": 0.03, "yield_wb": 0.015, **form}, 0.2)
    stiff, yields = np.array([0.5, 1.0, 0.5]), np.array([0.5, 1.0, 2.0])
    limits = 0.03 * stiff * yields / (stiff @ yields)
    falling = slice(3250, 3750)
    swing = psi[3250] - psi[falling]
    expected = np.minimum(swing[:, None] * stiff, 2.0 * limits).sum(axis=1)
    assert_close(held[3250] - held[falling], expected, 0.02, of=expected)


def test_a_soft_stop_yields_before_its_limit_and_the_softer_the_sooner() -> None:
    sizes = {"half_width_a": 0.03, "yield_wb": 0.015}
    psi, sharp = _loop(sizes, 0.2)
    _, nearly = _loop({**sizes, "softness": 0.02}, 0.2)
    _, soft = _loop({**sizes, "softness": 0.6}, 0.2)
    _, softer = _loop({**sizes, "softness": 1.0}, 0.2)
    assert_close(nearly, sharp, 0.05, of=sharp)
    assert soft.max() == pytest.approx(0.03, rel=0.02)
    # On the way up, before the limit is reached, less is held the softer the stop; on the way back all are elastic.
    rising = (np.diff(psi, append=psi[:1]) > 0.0) & (sharp > 0.015) & (sharp < 0.025)
    assert rising[3000:].any()
    assert (softer < soft)[3000:][rising[3000:]].all()
    assert (soft < sharp)[3000:][rising[3000:]].all()
    turn = 3000 + 250
    stiff = (sharp[turn] - sharp[turn + 20]) / (psi[turn] - psi[turn + 20])
    assert (soft[turn] - soft[turn + 20]) / (psi[turn] - psi[turn + 20]) == pytest.approx(stiff, rel=1e-3)


@pytest.mark.parametrize("softness", [0.5, 0.7, 1.0])
def test_a_stop_that_gives_on_every_way_is_boucs_and_wens(softness: float) -> None:
    """w dz/du = 1 - |z|^(n - 1) z sign du, in as many small steps as it takes."""
    psi, held = _loop({"half_width_a": 0.03, "yield_wb": 0.015, "softness": softness, "giving": 1.0}, 0.05)
    z, expected = 0.0, []
    for k in range(1, 2001):
        step = (psi[k] - psi[k - 1]) / 0.015 / 50
        for _ in range(50):
            z += step - abs(step) * abs(z) ** (1.0 / softness - 1.0) * z
        expected.append(0.03 * z)
    assert_close(held[1001:2001], expected[1000:], 0.02, of=held)


def test_stops_of_one_axis_do_not_know_of_the_other() -> None:
    """The flux stands still on d and moves to and fro on q: a vector stop forgets what it held on d."""
    k = np.arange(4000)
    psi = np.stack([np.minimum(k * 2e-4, 0.1), 0.1 * np.sin(2 * np.pi * k / 1000) * (k > 1000)], axis=1)
    signals = replace(readings(4000), psi_smooth_ab=psi, theta_rad=np.zeros(4000), came_from_ab=readings().i_ab[:1])
    vector, alone, half = (
        signals.i_m_ab - corrected(Hysteresis(), signals, half_width_a=0.03, yield_wb=0.015, by_axes=part).i_m_ab
        for part in (0.0, 1.0, 0.5)
    )
    assert alone[-1, 0] == pytest.approx(0.03, rel=1e-6)
    assert abs(vector[-1, 0]) < 0.003
    assert_close(alone[2000:, 1].max(), 0.03, 1e-6)
    assert_close(half, 0.5 * (vector + alone), 1e-12)


def test_a_loop_is_as_much_wider_as_its_flux_says() -> None:
    sizes = {"half_width_a": 0.03, "yield_wb": 0.015}
    psi, mere = _loop(sizes, 0.2)
    _, wider = _loop({**sizes, "widening_per_wb2": 25.0}, 0.2)
    _, narrower = _loop({**sizes, "widening_per_wb2": -50.0}, 0.2)
    assert_close(wider, (1.0 + 25.0 * psi**2) * mere, 1e-12)
    assert_close(narrower, mere / (1.0 + 50.0 * psi**2), 1e-12)


def test_a_soft_stop_asks_how_far_the_flux_has_moved_and_not_in_how_many_steps() -> None:
    k = np.arange(4000)
    fine = np.stack([0.2 * np.sin(2 * np.pi * k / 1000), 0.1 * np.cos(2 * np.pi * k / 1000)], axis=1)
    held = []
    for every in (1, 10):
        psi = np.ascontiguousarray(fine[::every])
        signals = replace(readings(len(psi)), psi_smooth_ab=psi, came_from_ab=np.zeros((1, 2)))
        out = corrected(Hysteresis(), signals, half_width_a=0.03, yield_wb=0.015, softness=0.6)
        held.append((signals.i_m_ab - out.i_m_ab)[:: 10 // every])
    assert_close(held[1][100:], held[0][100:], 0.03, of=held[0])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_iron_remembers_from_where_the_current_came(side: float) -> None:
    k = np.arange(4000)
    psi = np.stack([0.2 * np.sin(2 * np.pi * k / 1000), np.zeros(4000)], axis=1)
    signals = replace(readings(4000), psi_smooth_ab=psi)
    far = signals.i_ab[0] - side * np.array([3.0, 0.0])
    held = []
    for came_from in (far, signals.i_ab[0]):
        coming = replace(signals, came_from_ab=came_from[None])
        out = corrected(Hysteresis(), coming, half_width_a=0.03, yield_wb=0.015)
        held.append((coming.i_m_ab - out.i_m_ab)[:, 0])
    assert held[0][0] == pytest.approx(side * 0.03, rel=0.05)
    assert held[1][0] == 0.0
    # After half a loop nothing is left of that.
    assert_close(held[0][1000:], held[1][1000:], 1e-9, of=held[0])


def _held_at_first(came_from: Array, **values: float) -> Array:
    """What a sharp stop holds as a segment begins that the current came to on this way, shape (2,) [A]."""
    psi = np.repeat([[0.2, 0.0]], 4000, axis=0)
    signals = replace(readings(4000), psi_smooth_ab=psi, came_from_ab=came_from)
    out = corrected(Hysteresis(), signals, half_width_a=0.03, yield_wb=0.015, **values)
    return np.asarray((signals.i_m_ab - out.i_m_ab)[0], dtype=np.float64)


def test_iron_remembers_a_sweep_before_a_way_that_is_too_short_to_wipe_it_out() -> None:
    here = readings().i_ab[0]
    near, far = here - [0.01, 0.0], np.array([3.0, 0.0])
    below, above = (_held_at_first(np.array([here + side * far, near])) for side in (-1.0, 1.0))
    assert below[0] == pytest.approx(0.03, rel=0.05)
    assert above[0] == pytest.approx(-0.03, rel=0.1)


def test_a_controller_that_goes_beyond_its_aim_leaves_the_iron_on_the_other_branch() -> None:
    came_from = (readings().i_ab[0] - [3.0, 0.0])[None]
    assert _held_at_first(came_from, overshoot=0.3)[0] == pytest.approx(-0.03, rel=0.05)
    # 15 mWb are 0.27 A or so: a hundredth of 3 A turns little of a loop.
    assert 0.02 < _held_at_first(came_from, overshoot=0.01)[0] < 0.03


def test_what_iron_may_remember_beside_its_way_stays_where_nothing_moves_and_is_gone_after_a_loop() -> None:
    k = np.arange(4000)
    loop = np.stack([0.2 * np.sin(2 * np.pi * k / 1000), np.zeros(4000)], axis=1)
    p = Hysteresis.Parameters(half_width_a=0.03, yield_wb=0.015, early_share=0.5)
    for psi, stays in ((np.repeat(loop[:1], 4000, axis=0), True), (loop, False)):
        signals = replace(readings(4000), psi_smooth_ab=psi, came_from_ab=np.zeros((1, 2)))
        known = signals.corrected(Hysteresis().correct(signals, p)).i_m_ab
        directions = [
            direction.arrays["i_m_ab"] - signals.i_m_ab for direction in Hysteresis().random_directions(signals, p)
        ]
        assert len(directions) == 4
        for direction in directions:
            # No stop holds more than its limit, whatever it remembers.
            assert np.abs(direction).max() <= 0.5 * 0.03 + 1e-12
            assert np.abs(signals.i_m_ab - known - direction).max() <= 0.03 + 1e-12
            if stays:
                assert_close(direction, np.broadcast_to(direction[0], direction.shape), 1e-12, of=0.03)
                assert np.linalg.norm(direction[0]) > 1e-3
            else:
                assert_close(direction[2000:, 0], np.zeros(2000), 1e-6, of=0.03)


def test_magnets_warm_by_the_copper_loss_and_by_what_else_stays_as_it_is() -> None:
    time_s = np.linspace(0.0, 20.0, 201)
    late = LossHistory(time_s=time_s, power_w=np.where(time_s < 10.0, 0.0, 5.0))
    signals = replace(readings(), losses=late)
    values = {"flux_change_wb": -0.0043, "time_constant_s": 8.0}
    slid = []
    for steady in (0.0, 1.0, 0.4):
        out = corrected(MagnetHeating(), signals, **values, steady=steady)
        slid.append(((out.i_m_ab - signals.i_m_ab) @ [math.cos(0.2), math.sin(0.2)])[0])
    # At 5 s no copper has been warm; what stays as it is has come (1 - e^(-5/8)) / (1 - e^(-20/8)) of its way.
    whole = -0.0043 / 0.043
    assert slid[0] == pytest.approx(0.0, abs=1e-12)
    assert slid[1] == pytest.approx(whole * math.expm1(-5.0 / 8.0) / math.expm1(-20.0 / 8.0), rel=1e-2)
    assert slid[2] == pytest.approx(0.4 * slid[1], rel=1e-9)
