"""What a switching leg loses at its edges: the ideal step, its knee, its oddness, and how all of it goes with PWM."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.numerics.frames import from_phases, to_phases
from orchestrator.numerics.types import Array
from plugins.effects.inverter import DeadTime, DeviceDrop
from protocols import DriveRecord, Motor, Signals

FS, BUS = 10_000.0, 540.0
VOLTS = 8.0


def _signals(i_abc: Array, v_abc: Array | None = None, pwm_hz: float = FS, *, known: bool = True) -> Signals:
    """Held currents and voltages (n, 3), a segment's worth; `known`: with a nameplate."""
    i_ab = from_phases(i_abc)
    n = len(i_ab)
    motor = Motor(name="m", pole_pairs=2, rated_current_rms_a=5.0, d_inductance_h=0.05, q_inductance_h=0.05)
    return Signals(
        start_s=0.0,
        sampling_frequency_hz=FS,
        pwm_frequency_hz=pwm_hz,
        i_ab=i_ab,
        v_ab=np.zeros((n, 2)) if v_abc is None else from_phases(v_abc),
        v_dc=np.full(n, BUS),
        theta_rad=np.zeros(n),
        resistance_ohm=np.full(n, 4.0),
        i_m_ab=i_ab,
        heat_j=np.zeros(n),
        motor=motor if known else None,
        drive=DriveRecord(name="d", sampling_frequency_hz=FS, pwm_frequency_hz=FS, dc_bus_voltage_v=BUS),
    )


def _lost(signals: Signals, threshold_a: float, switched: float = 1.0, takeover: float = 0.0) -> Array:
    """Voltage lost in each phase, shape (n, 3)."""
    effect = DeadTime()
    p = effect.Parameters(voltage_v=VOLTS, threshold_a=threshold_a, switched=switched, takeover=takeover)
    v_ab = effect.correct(signals, p).v_ab
    assert v_ab is not None
    return to_phases(signals.v_ab - v_ab)


def _held(i_a: float) -> Array:
    """Phase a at this current and the others far from zero, so that what is lost in a shows alone."""
    return np.tile([i_a, 50.0, -50.0 - i_a], (10, 1))


def _share_of_a(i_a: float, threshold_a: float, pwm_hz: float = FS) -> float:
    """Without ripple, the part of V_dt that phase a loses: b and c lose nearly all of theirs against each other."""
    lost = _lost(_signals(_held(i_a), pwm_hz=pwm_hz, known=False), threshold_a)[0]
    return float(1.5 * lost[0] / (VOLTS * pwm_hz / FS))


def test_without_capacitance_all_of_the_dead_time_is_lost() -> None:
    for i_a in (0.1, -2.0):
        assert _share_of_a(i_a, 1e-3) == pytest.approx(np.sign(i_a), abs=0.006)


@pytest.mark.parametrize("knees", [0.2, 1.0, 4.0])
def test_the_capacitances_give_back_what_the_swing_takes(knees: float) -> None:
    i_k = 0.05
    expected = 0.5 * knees if knees < 1.0 else 1.0 - 0.5 / knees
    assert _share_of_a(knees * i_k, i_k) == pytest.approx(expected, abs=0.001)


def test_the_knee_is_at_the_same_current_at_every_pwm_frequency() -> None:
    assert _share_of_a(0.05, 0.05, 2 * FS) == pytest.approx(_share_of_a(0.05, 0.05), rel=1e-12)


def test_without_ripple_what_is_lost_is_odd_where_the_current_holds() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        i_abc, v_abc = (np.tile(size * rng.normal(size=3), (3, 1)) for size in (0.3, 20.0))
        there = _lost(_signals(i_abc, v_abc, known=False), 0.3)
        back = _lost(_signals(-i_abc, -v_abc, known=False), 0.3)
        assert np.abs(there + back).max() < 1e-12 * np.abs(there).max()


@pytest.mark.parametrize("pwm_hz", [FS, 2.0 * FS])
@pytest.mark.parametrize("i_a", [0.5, 4.0, -4.0])
def test_an_edge_against_the_current_is_the_later_the_larger_it_is(i_a: float, pwm_hz: float) -> None:
    rated_a, takeover = 5.0 * np.sqrt(2.0), 0.04
    i_abc = i_a * np.array([1.0, 1.0, -2.0])
    signals = _signals(np.tile(i_abc, (10, 1)), pwm_hz=pwm_hz)
    there, none = (_lost(signals, 0.1, takeover=part)[0] for part in (takeover, 0.0))
    # Of each phase one edge is with the current and one against it; the ripple is small beside it.
    more = takeover * VOLTS * pwm_hz / FS * i_abc / rated_a
    assert there - none == pytest.approx(more, rel=0.01)


@pytest.mark.parametrize("switched", [0.0, 1.0])
def test_a_leg_with_more_dead_time_loses_more_and_its_neighbours_less(switched: float) -> None:
    signals = _signals(np.tile([2.0, 2.0, -4.0], (10, 1)), known=False)
    effect = DeadTime()
    p = effect.Parameters(voltage_v=VOLTS, threshold_a=1e-3, switched=switched, leg_a_longer=0.3, leg_b_over_c=0.05)
    v_ab = effect.correct(signals, p).v_ab
    assert v_ab is not None
    lost = to_phases(signals.v_ab - v_ab)[0]
    # Between two phases it is the difference of what their legs lose, whatever the star point does.
    assert lost[0] - lost[1] == pytest.approx(0.4 * VOLTS, rel=2e-3)
    assert lost[1] - lost[2] == pytest.approx((0.9 + 0.8) * VOLTS, rel=2e-3)


def test_a_share_of_the_switched_form_is_in_between() -> None:
    signals = _signals(_held(0.03))
    soft, switched, half = (_lost(signals, 0.05, share) for share in (0.0, 1.0, 0.5))
    np.testing.assert_allclose(half, 0.5 * (soft + switched), rtol=1e-12)


def _drop_of_a(i_a: float, growth: float) -> float:
    """What phase a drops with b and c far beyond the knee on either side."""
    signals = _signals(np.tile([i_a, 50.0, -50.0 - i_a], (10, 1)))
    effect = DeviceDrop()
    p = effect.Parameters(voltage_v=0.8, threshold_a=0.01, growth=growth)
    v_ab = effect.correct(signals, p).v_ab
    assert v_ab is not None
    lost = to_phases(signals.v_ab - v_ab)[0]
    # The star point's own: a's drop is what it differs by from the mean of the other two, which nearly cancel.
    return float(1.5 * lost[0])


def test_a_junctions_drop_grows_as_much_with_every_factor_of_the_current() -> None:
    drops = np.array([_drop_of_a(i_a, 0.1) for i_a in (0.2, 0.4, 0.8, 1.6)])
    rated_knees = 5.0 * np.sqrt(2.0) / 0.01
    # The table's end is between the first and the second.
    expected = 0.8 * 0.1 * np.log(2.0) / (0.9 + 0.1 * np.log1p(rated_knees))
    assert np.diff(drops) == pytest.approx(np.full(3, expected), rel=0.03)
    assert np.ptp([_drop_of_a(i_a, 0.0) for i_a in (0.2, 0.4, 1.6)]) < 0.005


def test_a_drop_goes_on_growing_from_table_to_table_and_beyond() -> None:
    """The first ends at 40 knees, 0.4 A, the second at 1280."""

    def drop(current_a: Array) -> Array:
        rated_knees = 5.0 * np.sqrt(2.0) / 0.01
        return np.asarray(0.8 * (0.9 + 0.1 * np.log1p(current_a / 0.01)) / (0.9 + 0.1 * np.log1p(rated_knees)))

    i_a = np.geomspace(0.5, 50.0, 60)
    # The star point's own part: b and c carry 50 A, and that and a's.
    expected = drop(i_a) - 0.5 * (drop(np.full(60, 50.0)) - drop(50.0 + i_a))
    assert [_drop_of_a(one, 0.1) for one in i_a] == pytest.approx(expected, rel=1e-3)


def test_a_drop_that_only_grows_is_shockleys_law() -> None:
    """n k T / q log(1 + i / i_s), at every current."""
    i_a = np.geomspace(1e-3, 50.0, 60)
    drops = np.log1p(i_a / 0.01) - 0.5 * (np.log1p(5000.0) - np.log1p((50.0 + i_a) / 0.01))
    expected = 0.8 * drops / np.log1p(5.0 * np.sqrt(2.0) / 0.01)
    assert [_drop_of_a(one, 1.0) for one in i_a] == pytest.approx(expected, rel=1e-3)


def test_a_logarithm_alone_needs_no_rated_current() -> None:
    signals = replace(_signals(np.tile([1.0, 0.5, -1.5], (10, 1))), motor=None)
    v_ab = DeviceDrop().correct(signals, DeviceDrop.Parameters(voltage_v=0.8, growth=1.0)).v_ab
    assert v_ab is not None
    assert np.isfinite(v_ab).all()
    assert v_ab.any()


def test_the_drops_size_is_that_at_the_rated_current() -> None:
    rated_a = 5.0 * np.sqrt(2.0)
    assert _drop_of_a(rated_a, 0.1) == pytest.approx(_drop_of_a(rated_a, 0.0), rel=0.01)


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (0.32, 0.0, ["leg a's is 32 % longer than the legs' mean: look at its gate driver"]),
        (0.05, 0.085, ["leg c's is 11 % shorter than the legs' mean: look at its gate driver"]),
        (0.01, -0.015, []),
    ],
)
def test_a_leg_whose_dead_time_is_none_of_the_others_is_stated(a: float, b: float, expected: list[str]) -> None:
    effect = DeadTime()
    assert [r.text for r in effect.remarks(effect.Parameters(leg_a_longer=a, leg_b_over_c=b))] == expected
