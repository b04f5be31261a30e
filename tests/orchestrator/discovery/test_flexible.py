"""Flexible laws: curves, memory, and their short forms."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar, cast

import numpy as np
import pytest
from scipy.interpolate import BSpline

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.discovery import FoundForm, cooled, fading_memory, form_values, lagged, play, search, slopes
from orchestrator.discovery import places as at
from orchestrator.discovery import quantities as of
from orchestrator.discovery.bases import CurveBasis, HarmonicBasis, LineBasis, MemoryBasis
from orchestrator.discovery.forms import CURVES, Form, fitting_forms
from orchestrator.discovery.hypotheses import ALL, A, Hypothesis, Ranges, SharedColumns, hypotheses, in_words, term_of
from orchestrator.discovery.laws import FittedLaw, _over_true_current, keeps_scale, table_of
from orchestrator.discovery.ranking import Score, _solved, rank
from orchestrator.discovery.report import Constant
from orchestrator.discovery.search import LearnedLaw
from orchestrator.numerics.frames import to_phases
from orchestrator.testing import exciting_signals
from protocols import LossHistory, SignalBatch, amplitude
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, many_holds, prepared, with_voltage
from tests.orchestrator.diagnosis.reporting.test_resemblance import AlphaBias

TOP = 4.0


def score_of(form: Form, scale: float, power: float, phases: tuple[float, float, float] = A) -> Score:
    """A flexible law that follows a form over the quantity's range, known to a thousandth."""
    if form.parity == "periodic":
        return score_of_harmonic(form, scale)
    knee = np.inf if form.parity == "none" else 0.03 * TOP
    basis = CurveBasis(0.0, TOP, 24, form.parity, knee)
    x = np.linspace(1e-3, TOP, 2000)
    fitted = np.linalg.lstsq(basis.design(x), form.of(x, scale, power), rcond=None)[0]
    coefficients = np.asarray(fitted, dtype=np.float64)
    place, quantity = (at.RESISTANCE, of.TIME) if form.parity == "none" else (at.LEG_VOLTAGE, of.PHASE_CURRENT)
    hypothesis = Hypothesis(place, quantity, ALL if form.parity == "none" else phases, basis, 1.0)
    return Score(hypothesis, 0.0, 0.0, coefficients, 1e-6 * np.eye(basis.size), 1.0, 1.0)


def score_of_harmonic(form: Form, phase: float) -> Score:
    """Harmonics that follow a form over a turn."""
    basis = HarmonicBasis(-np.pi, np.pi, 6, "periodic")
    x = np.linspace(-np.pi, np.pi, 2000)
    fitted = np.linalg.lstsq(basis.design(x), form.of(x, phase, 1.0), rcond=None)[0]
    hypothesis = Hypothesis(at.ANGLE, of.ROTOR_ANGLE, ALL, basis, 1.0)
    return Score(hypothesis, 0.0, 0.0, np.asarray(fitted, dtype=np.float64), 1e-6 * np.eye(basis.size), 1.0, 1.0)


@pytest.mark.parametrize("form", [f for f in CURVES if f.name != "steady"], ids=lambda form: form.name)
def test_a_curve_of_some_form_is_recognised(form: Form) -> None:
    power = form.powers[-2] if form.has_power and form.power_name == "exponent" else form.powers[0]
    best = fitting_forms(score_of(form, 0.3 * TOP, power))[:2]
    assert form.name in [fit.form.name for fit in best if fit.form is not None]


def test_where_r_s_takes_up_a_straight_line_the_rest_decides_the_form() -> None:
    tanh = next(f for f in CURVES if f.name == "tanh")
    score = score_of(tanh, 0.3, 1.0, phases=ALL)
    basis = score.hypothesis.basis
    assert isinstance(basis, CurveBasis)
    x = np.linspace(1e-3, TOP, 2000)
    line = np.linalg.lstsq(basis.design(x), 0.7 * x, rcond=None)[0]
    leaning = replace(score, coefficients=score.coefficients + line)
    best = fitting_forms(leaning)[0]
    assert best.form is tanh
    assert best.scale == pytest.approx(0.3, rel=0.2)


def test_a_power_is_considered_where_r_s_takes_up_a_straight_line() -> None:
    power = next(f for f in CURVES if f.name == "power")
    best = fitting_forms(score_of(power, TOP, 7.0, phases=ALL))[0]
    assert best.form is power
    assert best.power == 7.0


def test_a_sensors_error_over_its_reading_is_put_over_the_true_current() -> None:
    true = np.linspace(1e-3, TOP, 2000)
    error = -0.02 * true**2
    reading = true + error
    basis = CurveBasis(0.0, float(reading.max()), 24, "odd", 0.1)
    over_reading = np.asarray(np.linalg.lstsq(basis.design(reading), error, rcond=None)[0], dtype=np.float64)
    over, coefficients = _over_true_current(basis, over_reading)
    np.testing.assert_allclose(over.design(true) @ coefficients, error, atol=1e-4)


def test_memory_is_shown_by_a_first_rise_or_by_what_a_step_leaves() -> None:
    x = np.array([0.0, 1.0, 3.0])
    np.testing.assert_allclose(MemoryBasis("play", (1.0, 2.0)).design(x), [[0.0, 0.0], [1.0, 1.0], [1.0, 2.0]])
    for kind in ("lag", "cooling"):
        np.testing.assert_allclose(MemoryBasis(kind, (2.0,)).design(x)[:, 0], np.exp(-x / 2.0))
    np.testing.assert_allclose(MemoryBasis("late", (2.0,)).design(x)[:, 0], 1.0 - np.exp(-x / 2.0))


def test_an_odd_curve_is_odd_and_an_even_one_even() -> None:
    x = np.linspace(-TOP, TOP, 101)
    odd, even = (CurveBasis(0.0, TOP, 8, parity, 0.1).design(x) for parity in ("odd", "even"))
    np.testing.assert_allclose(odd, -odd[::-1], atol=1e-12)
    np.testing.assert_allclose(even, even[::-1], atol=1e-12)
    assert not odd[50].any()


def test_a_curve_over_intervals_is_the_mean_between_samples() -> None:
    batch = SignalBatch.of([exciting_signals()])
    basis = CurveBasis(0.0, TOP, 8, "odd", 0.1)
    x = np.linspace(-1.0, 1.0, batch.samples)[:, None]
    means, fine = (
        basis.columns(x, batch, mean=True).T,
        basis.design(np.linspace(x[0, 0], x[1, 0], 101)),
    )
    np.testing.assert_allclose(means[0], fine.mean(axis=0), atol=1e-5)


def test_a_lag_follows_a_step_with_its_time_constant_in_each_segment_anew() -> None:
    one = exciting_signals()
    batch = SignalBatch.of([one, one])
    n, fs = len(one.v_dc), one.sampling_frequency_hz
    x = np.tile((np.arange(n) >= 100).astype(float), 2)
    y = lagged(x, 50 / fs, batch)[:, 0]
    assert y[150] == pytest.approx(1.0 - np.exp(-1.0), abs=0.01)
    np.testing.assert_allclose(y[:n], y[n:])


def test_a_lag_follows_a_straight_line_at_its_time_constant() -> None:
    signals = exciting_signals()
    line = np.arange(len(signals.v_dc)) / signals.sampling_frequency_hz
    behind = line - lagged(line, 3e-4, signals)[:, 0]
    np.testing.assert_allclose(behind[100:], 3e-4, rtol=1e-6)


def test_a_play_keeps_within_its_radius_whatever_the_rate() -> None:
    signals = exciting_signals()
    x = of.phase_currents(signals)
    y = play(x, 0.5, signals)
    assert np.abs(x - y).max() <= 0.5 + 1e-12
    slow = replace(signals, sampling_frequency_hz=1.0)
    np.testing.assert_allclose(play(x, 0.5, slow), y)
    # Between two reversals closer than twice the radius it does not move.
    little = 0.4 * np.sin(np.arange(len(x)))[:, None] * np.ones(3)
    assert np.ptp(play(little, 0.5, signals), axis=0).max() < 1e-12


def test_a_number_that_does_not_show_leaves_the_others_as_they_are() -> None:
    normal = np.array([[4.0, 2.0, 2.0], [2.0, 9.0, 9.0], [2.0, 9.0, 9.0 - 1e-13]])
    right = np.array([[1.0], [2.0], [2.0]])
    expected = np.linalg.solve(normal[:2, :2], right[:2])
    found = _solved(normal, right)
    np.testing.assert_allclose([found[0, 0], found[1, 0] + found[2, 0]], expected[:, 0], rtol=1e-6)


def test_heat_cools_with_its_time_constant_over_the_whole_experiment() -> None:
    time_s = np.linspace(0.0, 40.0, 401)
    power_w = np.where(time_s < 10.0, 5.0, 0.0)
    signals = replace(exciting_signals(), start_s=30.0, losses=LossHistory(time_s=time_s, power_w=power_w))
    left = 5.0 * 8.0 * (1.0 - np.exp(-10.0 / 8.0)) * np.exp(-20.0 / 8.0)
    assert cooled(signals.heat_j, 8.0, signals)[0] == pytest.approx(left, rel=1e-3)
    unknown = replace(signals, losses=None)
    np.testing.assert_array_equal(cooled(unknown.heat_j, 8.0, unknown), unknown.heat_j)


def test_what_a_lag_remembers_fades_and_is_part_of_the_last_way() -> None:
    signals = exciting_signals()
    x = 3.0 * of.phase_currents(signals)
    change = fading_memory(x, 10.0 / signals.sampling_frequency_hz, signals)
    assert signals.came_from_ab is not None
    way = 3.0 * to_phases(signals.came_from_ab[-1:] - signals.i_ab[:1])[0]
    np.testing.assert_allclose(change[0], way / np.sqrt(3.0))
    np.testing.assert_allclose(change[10], change[0] / np.e)


def test_a_line_has_amplitudes_of_its_own_in_two_phases() -> None:
    batch = SignalBatch.of([exciting_signals()])
    each = Hypothesis(at.READING, of.TIME, ALL, LineBasis(50.0, 0.1, True), 0.01)
    y = each.values(each.columns(batch), np.array([1.0, 2.0, 3.0, 4.0]))
    turns = 2.0 * np.pi * 50.0 * batch.time_s
    np.testing.assert_allclose(y[:, 0], np.sin(turns) + 2.0 * np.cos(turns), atol=1e-12)
    np.testing.assert_allclose(y[:, 1], 3.0 * np.sin(turns) + 4.0 * np.cos(turns), atol=1e-12)
    assert not y[:, 2].any()
    single = Hypothesis(at.VOLTAGE_GAIN, of.TIME, ALL, LineBasis(50.0, 0.1, False), 0.01)
    np.testing.assert_allclose(single.values(single.columns(batch), np.array([1.0, 2.0])), y[:, 0], atol=1e-12)


def test_a_line_is_drawn_by_the_first_phases_wave() -> None:
    values = {"sine_of_a_a": 1.0, "cosine_of_a_a": 2.0, "sine_of_b_a": 3.0, "cosine_of_b_a": 4.0, "frequency_hz": 50.0}
    constants = tuple(Constant(name=n, value=v, low=v, high=v, unit="A") for n, v in values.items())
    form = FoundForm(
        name="line", formula="", constants=constants, chi2=1.0, heldout=1.0, heldout_rms_v=None, log_evidence=0.0
    )
    drawn = form_values(form, np.array([0.0, 0.005]))
    assert drawn == pytest.approx([2.0, 1.0])


def test_the_slope_before_a_reading_is_that_of_its_own_segment() -> None:
    one = exciting_signals()
    batch, n, rate = SignalBatch.of([one, one]), len(one.v_dc), one.sampling_frequency_hz
    x = np.tile(np.arange(n) ** 2.0, 2)[:, None]
    found = slopes(x, batch)[:, 0] / rate
    np.testing.assert_allclose(found[[1, 5, n - 1, n + 5]], [1.0, 9.0, 2.0 * n - 3.0, 9.0])
    np.testing.assert_allclose(found[[0, n]], found[[1, n + 1]])


def test_a_curve_is_that_of_its_b_splines() -> None:
    basis = CurveBasis(0.0, TOP, 8, "none")
    x = np.random.default_rng(0).uniform(0.0, TOP, 500)
    expected = BSpline.design_matrix(x, basis.knots, 3).toarray()
    np.testing.assert_allclose(basis.design(x), expected, atol=1e-12)


def test_hypotheses_that_differ_by_their_phase_alone_share_their_columns() -> None:
    batch, shared = SignalBatch.of([exciting_signals()]), SharedColumns()
    basis = CurveBasis(0.0, TOP, 8, "odd", 0.1)
    one, other = (Hypothesis(at.LEG_VOLTAGE, of.PHASE_CURRENT, phases, basis, 1.0) for phases in (A, ALL))
    columns = shared.of(one, batch)
    assert shared.of(other, batch) is columns
    assert shared.of(replace(one, place=at.READING), batch) is not columns
    assert shared.of(one, SignalBatch.of([exciting_signals()])) is not columns


def test_a_law_that_makes_voltage_and_resistance_vanish_is_none() -> None:
    """Without voltage, resistance and flux any current obeys the equations; a resistance may change otherwise."""
    recording = prepared(many_holds())
    before = fitter(recording).fit(free_model())
    score = score_of(next(f for f in CURVES if f.parity == "none"), 0.3 * TOP, 1.0)
    for r_s, kept in ((0.0, False), (1.01 * before.model.r_s, True)):
        after = replace(before, model=replace(before.model, r_s=r_s))
        gain = replace(score.hypothesis, place=at.VOLTAGE_GAIN)
        assert keeps_scale(FittedLaw(None, gain, after), before) == kept
        assert keeps_scale(FittedLaw(None, score.hypothesis, after), before)


@pytest.mark.parametrize("gain", [0.0, 0.3, -0.2])
def test_a_table_of_all_sensors_has_no_gain_in_common(gain: float) -> None:
    """R_s and the map take up any, which no recording shows; of one sensor it is one, and stays."""
    power = next(f for f in CURVES if f.parity == "odd" and f.has_power and f.power_name == "exponent")
    basis = CurveBasis(0.0, TOP, 24, "odd", np.inf)
    x = np.linspace(1e-3, TOP, 2000)
    y = 0.03 * power.of(x, TOP, 6.0)
    fitted = np.linalg.lstsq(basis.design(x), y + gain * x, rcond=None)[0]
    for phases, left in ((ALL, 0.0), (A, gain)):
        hypothesis = Hypothesis(at.READING, of.PHASE_CURRENT, phases, basis, 1.0)
        table = table_of(Score(hypothesis, 0.0, 0.0, np.asarray(fitted), 1e-6 * np.eye(basis.size), 1.0, 1.0))
        assert table is not None
        slope = (table.size * table.y[8]) / (table.top * table.x[8])
        assert slope == pytest.approx(left, abs=2e-3)


@pytest.mark.parametrize(("chi2_anew", "kept"), [(39.0, True), (1.05, False)])
def test_a_law_found_anew_on_a_finer_map_has_to_leave_less(
    chi2_anew: float, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = prepared(many_holds())
    fitted = fitter(recording).fit(free_model())
    score = score_of(next(f for f in CURVES if f.parity == "none"), 0.3 * TOP, 1.0)

    def law(chi2: float) -> LearnedLaw:
        fit = replace(fitted, chi2=chi2 * fitted.dof, model=fitted.model.with_active([term_of(score.hypothesis, zero)]))
        return LearnedLaw(score, (FittedLaw(None, score.hypothesis, fit),), ())

    zero = np.zeros(score.hypothesis.basis.size)
    before, finer, anew = law(1.3), law(1.2).best.fit, law(chi2_anew)
    monkeypatch.setattr(search, "with_finest_map", lambda *_: finer)
    monkeypatch.setattr(search, "with_fitted_constants", lambda one: one.law)
    monkeypatch.setattr(search, "_formed", lambda *_: anew)
    setup = cast(DiagnosisSetup, SimpleNamespace(fitter=SimpleNamespace(fit=lambda *_: fitted)))
    after = search._on_finer_map(setup, before, lambda _: None)
    assert after.best.fit is (finer if kept else anew.best.fit)


class NarrowBias(AlphaBias):
    """A bias that may be a hundredth of the one in the data."""

    name: ClassVar[str] = "narrow_bias"

    class Parameters(AlphaBias.Parameters):
        bias_v: float = amplitude("V", typical=0.001, prior_width=1.0, low=-0.003, high=0.003)


def test_what_an_effect_at_its_bound_cannot_take_up_is_left_to_a_law() -> None:
    maker = fitter(with_voltage(prepared(many_holds()), np.array([0.3, 0.0])))
    fit = maker.fit(with_free(free_model(), maker, NarrowBias()))
    assert fit.model.active[0].values["bias_v"] == pytest.approx(0.003, rel=0.1)
    ranges = Ranges.in_fit(fit)
    (best, *_) = rank(maker, fit, [h for h in hypotheses(ranges) if h.key == "leg_voltage-a-curve-time"])
    assert best.share == pytest.approx(1.0, abs=0.01)


def test_a_voltage_before_a_reading_is_that_of_its_own_segment() -> None:
    signals = exciting_signals()
    batch = SignalBatch.of([signals, signals])
    before = of.VOLTAGE_BEFORE.of(batch)
    v = to_phases(signals.v_ab)
    n = len(v)
    for start in (0, n):
        np.testing.assert_array_equal(before[start], v[0])
        np.testing.assert_array_equal(before[start + 1 : start + n], v[:-1])


def test_steps_are_told_in_words_with_the_time_that_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 3.0, 8.0])
    monkeypatch.setattr(search, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    law = Hypothesis(at.LEG_VOLTAGE, of.PHASE_CURRENT, A, CurveBasis(0.0, TOP, 9, "odd", np.inf), 0.01)
    progress: list[str] = []
    for step in search._steps("curve", 3, progress.append):
        step(in_words(law))
    words = "a voltage that each leg loses, over its own current, in phase a alone"
    assert progress == [
        f"curve 1 of 3: {words}",
        f"curve 2 of 3, 6 s left of these: {words}",
        f"curve 3 of 3, 4 s left of these: {words}",
    ]
