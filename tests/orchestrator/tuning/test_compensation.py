"""What a drive compensates agrees with the effects' formulas, written out here, and with effects of one's own."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.signal import lfilter

from orchestrator.diagnosis import linear_magnetics
from orchestrator.numerics.frames import from_phases, from_two_phases, to_phases
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from orchestrator.tuning.compensation import Compensation
from plugins.effects.frame import BrakeCompliance, RotorMisalignment
from plugins.effects.inverter import BusSag, DeadTime, DeviceDrop, VoltageBias
from plugins.effects.resistance import PhaseResistanceImbalance, SkinEffect, WindingHeating
from plugins.effects.sampling import SamplingOffset
from plugins.effects.sensors import (
    CurrentGainMismatch,
    CurrentNonlinearity,
    CurrentOffset,
    CurrentOffsetDrift,
    ShuntReconstruction,
    ThirdCurrentSensor,
)
from plugins.effects.timing import CurrentFilter, VoltageDelay
from protocols import (
    CoEnergySpline,
    Contrast,
    Correction,
    DriveRecord,
    Effect,
    EffectLayer,
    EffectParameters,
    Manifest,
    ModelEffect,
    ModelParameter,
    Motor,
    MotorModel,
    PluginError,
    Rung,
    Saturated,
    Signals,
    amplitude,
)

BUS_V, LARGEST_A = 400.0, 5.0
GRID = EvenSpline(-6.0, 6.0, 6.0, (2, 2))
MOTOR = Motor(name="analytic", pole_pairs=3, rated_current_rms_a=3.0, pm_flux_wb=0.2)
MANIFEST = Manifest(
    format="fluxbench-recording",
    version=1,
    name="bench",
    created="",
    motor=MOTOR,
    drive=DriveRecord(name="d", sampling_frequency_hz=8000.0, pwm_frequency_hz=8000.0, dc_bus_voltage_v=BUS_V),
    segments=(),
)


def parameters(effect: Effect, *, interval: float = 0.0, **values: float) -> ModelEffect:
    """An effect of a model; those parameters that are given were fitted, to +- `interval` of themselves."""
    kept = {}
    for p in effect.Parameters.declared():
        default = getattr(effect.Parameters(), p.name)
        value = values.get(p.name, default)
        low, high = (value - interval * abs(value), value + interval * abs(value))
        given = p.name in values
        kept[p.name] = ModelParameter(
            value=value, low=low if given else None, high=high if given else None, unit=p.unit, fitted=given
        )
    return ModelEffect(name=effect.name, parameters=kept, relative_size=1.0, log_evidence=1.0)


def model_of(*effects: ModelEffect) -> MotorModel:
    """A model of a machine with constant inductances."""
    spline = linear_magnetics(GRID, 0.03, 0.05)
    return MotorModel(
        recording="bench",
        motor=MOTOR,
        baseline=Saturated(),
        r_s_ohm=2.0,
        pm_flux_wb=0.2,
        magnetics=CoEnergySpline(
            d_low_a=GRID.low,
            d_high_a=GRID.high,
            q_high_a=GRID.reach,
            d_intervals=2,
            q_intervals=2,
            coefficients_j=tuple(spline.coefficients),
        ),
        effects=effects,
        ladder=(Rung(added=None, chi2=1.0, rms_v=1.0, heldout_rms_v=1.0, current_rms_a=1.0),),
    )


def compensation(*effects: tuple[Effect, ModelEffect], clarke_of_three: bool | None = None) -> Compensation:
    """Of these effects in this order."""
    model = model_of(*(kept for _, kept in effects))
    known = [effect for effect, _ in effects]
    return Compensation.of(model, known, MANIFEST, LARGEST_A, clarke_of_three=clarke_of_three)


def one(effect: Effect, *, interval: float = 0.0, clarke_of_three: bool | None = None, **values: float) -> Compensation:
    """Of a single effect."""
    kept = parameters(effect, interval=interval, **values)
    return compensation((effect, kept), clarke_of_three=clarke_of_three)


def soft_sign(x: Array, softness: float = 0.5) -> Array:
    """x / (1 + |x|^p)^(1/p), p = 1 / softness."""
    return x / (1.0 + np.abs(x) ** (1.0 / softness)) ** softness


def neutral(found: Compensation, *but: str) -> None:
    """Assert that all but some of the numbers are those of a drive without effects."""
    expected: dict[str, Any] = {
        "lost_v": 0.0,
        "lost_per_bus_v": 0.0,
        "bias_ab_v": 0.0,
        "current_gain": np.eye(2),
        "current_offset_a": 0.0,
        "angle_rad": 0.0,
        "voltage_delay_s": 0.0,
        "current_delay_s": 0.0,
    }
    for name, value in expected.items():
        if name not in but:
            np.testing.assert_array_equal(getattr(found, name), np.broadcast_to(value, np.shape(getattr(found, name))))


def test_without_effects_nothing_is_compensated() -> None:
    found = compensation()
    neutral(found)
    assert found.sources == ()
    assert found.left_out == ()
    assert not found.lost_std_v.any()


def test_the_table_is_evenly_spaced_up_to_the_largest_current() -> None:
    found = compensation()
    assert found.current_a[[0, -1]] == pytest.approx([-LARGEST_A, LARGEST_A])
    assert np.diff(found.current_a) == pytest.approx(found.current_a[1] - found.current_a[0])


def test_a_dead_time_is_lost_in_proportion_to_the_bus_voltage() -> None:
    found = one(DeadTime(), voltage_v=6.0, threshold_a=0.3)
    expected = 6.0 / BUS_V * soft_sign(found.current_a / 0.3)
    assert found.lost_per_bus_v == pytest.approx(expected, abs=1e-4 * 6.0 / BUS_V)
    neutral(found, "lost_per_bus_v")
    assert found.sources == ("dead_time",)


def test_a_device_drop_is_the_same_at_any_bus_voltage() -> None:
    found = one(DeviceDrop(), voltage_v=1.2, threshold_a=0.05)
    assert found.lost_v == pytest.approx(1.2 * soft_sign(found.current_a / 0.05), abs=1e-4)
    neutral(found, "lost_v")


def test_at_twice_the_pwm_frequency_a_dead_time_takes_twice_the_voltage_and_a_device_the_same() -> None:
    for effect, values, factor in ((DeadTime(), {"voltage_v": 6.0}, 2.0), (DeviceDrop(), {"voltage_v": 1.0}, 1.0)):
        model = model_of(parameters(effect, **values))
        bench, drive = (
            Compensation.of(model, [effect], MANIFEST, LARGEST_A, pwm_frequency_hz=hz) for hz in (None, 16_000.0)
        )
        assert drive.lost_v == pytest.approx(factor * bench.lost_v, abs=1e-9)
        assert drive.lost_per_bus_v == pytest.approx(factor * bench.lost_per_bus_v, abs=1e-12)


def test_what_several_effects_take_adds_up() -> None:
    dead_time, drop = DeadTime(), DeviceDrop()
    found = compensation(
        (dead_time, parameters(dead_time, voltage_v=6.0, threshold_a=0.3)),
        (drop, parameters(drop, voltage_v=1.2, threshold_a=0.05)),
    )
    alone = one(dead_time, voltage_v=6.0, threshold_a=0.3), one(drop, voltage_v=1.2, threshold_a=0.05)
    assert found.lost_v == pytest.approx(alone[0].lost_v + alone[1].lost_v, abs=1e-9)
    assert found.lost_per_bus_v == pytest.approx(alone[0].lost_per_bus_v + alone[1].lost_per_bus_v, abs=1e-12)
    assert found.sources == ("dead_time", "device_drop")


@pytest.mark.parametrize("effect", [DeadTime(), DeviceDrop()])
def test_the_lost_voltage_is_odd(effect: Effect) -> None:
    found = one(effect, voltage_v=3.0, threshold_a=0.2)
    for table in (found.lost_v, found.lost_per_bus_v):
        np.testing.assert_array_equal(table, -table[::-1])


def test_the_lost_voltage_put_back_is_the_effect_undone() -> None:
    effect, rng = DeadTime(), np.random.default_rng(0)
    found = one(effect, voltage_v=6.0, threshold_a=0.3)
    i_ab = rng.uniform(-3.0, 3.0, (50, 2))
    legs = np.interp(to_phases(i_ab), found.current_a, found.lost_v + 370.0 * found.lost_per_bus_v)
    expected = 6.0 * 370.0 / BUS_V * soft_sign(to_phases(i_ab) / 0.3)
    # Between its points the table is straight: off by h^2 / 8 times the curvature, 0.86 at most for s(x).
    step = found.current_a[1] - found.current_a[0]
    curvature = 0.86 * 6.0 / 0.3**2
    assert from_phases(legs) == pytest.approx(from_phases(expected), abs=4.0 / 3.0 * step**2 / 8.0 * curvature)


def test_a_bias_of_the_legs_is_a_constant_vector() -> None:
    found = one(VoltageBias(), bias_a_v=0.2, bias_b_v=-0.1)
    assert found.bias_ab_v == pytest.approx(from_two_phases(0.2, -0.1), abs=1e-12)
    neutral(found, "bias_ab_v")


def test_unequal_gains_of_two_sensors_are_undone() -> None:
    found = one(CurrentGainMismatch(), gain_a_minus_b=0.04)
    true = np.array([[1.0, 2.0], [-0.7, 0.3]])
    a, b, _ = to_phases(true).T
    read = from_two_phases(1.02 * a, 0.98 * b)
    assert read @ found.current_gain.T + found.current_offset_a == pytest.approx(true, abs=1e-12)
    neutral(found, "current_gain")


def test_a_gain_of_the_third_sensor_counts_where_three_make_the_vector() -> None:
    found = one(ThirdCurrentSensor(), clarke_of_three=True, gain_c_minus_1=0.03)
    true = np.array([[1.0, 2.0], [-0.7, 0.3]])
    read = from_phases(to_phases(true) * [1.0, 1.0, 1.03])
    assert read @ found.current_gain.T == pytest.approx(true, abs=1e-12)
    two = one(ThirdCurrentSensor(), clarke_of_three=False, gain_c_minus_1=0.03)
    neutral(two)
    assert [left.name for left in two.left_out] == ["third_current_sensor"]


def test_shunts_that_are_read_in_turns_are_compensated_on_the_mean() -> None:
    found = one(ShuntReconstruction(), gain_a_minus_b=0.04)
    # At rest the leg with the largest voltage has the largest current: b and c in turns, or a and one of these.
    assert 0.0 < np.abs(found.current_gain - np.eye(2)).max() < 0.03
    assert [left.name for left in found.left_out] == ["shunt_reconstruction"]
    assert "in part" in found.left_out[0].reason


def test_offsets_are_subtracted() -> None:
    found = one(CurrentOffset(), offset_a_a=0.02, offset_b_a=-0.03)
    assert found.current_offset_a == pytest.approx(-from_two_phases(0.02, -0.03), abs=1e-12)
    neutral(found, "current_offset_a")


def test_gains_and_offsets_are_undone_in_the_effects_order() -> None:
    offset, gain = CurrentOffset(), CurrentGainMismatch()
    found = compensation(
        (offset, parameters(offset, offset_a_a=0.02, offset_b_a=-0.03)),
        (gain, parameters(gain, gain_a_minus_b=0.1)),
    )
    true = np.array([[1.0, 2.0], [-0.7, 0.3]])
    a, b, _ = to_phases(true).T
    read = from_two_phases(1.05 * a + 0.02, 0.95 * b - 0.03)
    assert read @ found.current_gain.T + found.current_offset_a == pytest.approx(true, abs=1e-12)


class CommonMode(Effect):
    """A shunt in the motor's lead, whose amplifier passes a part of the lead's voltage."""

    name: ClassVar[str] = "common_mode"
    summary: ClassVar[str] = "The readings hold a part of the phase voltage."
    signature: ClassVar[str] = "Readings along the voltage."
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        leak_a_per_v: float = amplitude("A/V", typical=1e-3, prior_width=2e-3, low=-0.1, high=0.1)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        return Correction(i_ab=signals.i_ab - p.leak_a_per_v * signals.v_ab)


@pytest.mark.parametrize("delay_s", [3e-5, -2e-5, 2.6e-4])
def test_a_late_voltage_is_a_delay(delay_s: float) -> None:
    found = one(VoltageDelay(), delay_s=delay_s)
    assert found.voltage_delay_s == pytest.approx(delay_s, rel=1e-9)
    neutral(found, "voltage_delay_s")


@pytest.mark.parametrize("time_constant_s", [4e-6, 2e-4])
def test_a_lag_of_the_sensors_is_a_delay(time_constant_s: float) -> None:
    found = one(CurrentFilter(), time_constant_s=time_constant_s)
    assert found.current_delay_s == pytest.approx(time_constant_s, rel=1e-6)
    assert found.delay_s == found.current_delay_s
    neutral(found, "current_delay_s")


def test_a_misaligned_rotor_is_an_angle() -> None:
    found = one(RotorMisalignment(), angle_rad=-0.07)
    assert found.angle_rad == pytest.approx(-0.07)
    neutral(found, "angle_rad")


@pytest.mark.parametrize(
    ("effect", "values", "reason"),
    [
        (BrakeCompliance(), {"rad_per_nm": 0.01}, "a drive in use has no locked rotor"),
        (WindingHeating(), {"rise_per_watt": 0.003}, "temperature of the winding"),
        (PhaseResistanceImbalance(), {"extra_a_ohm": 0.2}, "the motor's winding"),
        (SkinEffect(), {"extra_ohm": 1.0}, "acts on ripple only"),
        (BusSag(), {"per_watt": 1e-4}, "measures its bus voltage"),
        (CurrentOffsetDrift(), {"rate_a_a_per_s": 1e-4}, "changes with time"),
        (SamplingOffset(), {"offset_s": 5e-6}, "neither constant readings"),
        (CommonMode(), {"leak_a_per_v": 2e-3}, "follow the phase voltage"),
    ],
)
def test_what_is_not_the_drives_is_left_out_with_its_reason(
    effect: Effect, values: dict[str, Any], reason: str
) -> None:
    found = one(effect, **values)
    neutral(found)
    assert found.sources == ()
    (left,) = found.left_out
    assert left.name == effect.name
    assert reason in left.reason


def test_of_curved_sensors_the_straight_part_is_compensated_and_the_rest_is_reported() -> None:
    found = one(CurrentNonlinearity(), cubic_per_a2=2e-3)
    assert found.sources == ("current_nonlinearity",)
    (left,) = found.left_out
    assert "in part" in left.reason
    assert found.current_gain[0, 0] < 1.0  # the reading grows faster than the current
    assert found.delay_s == pytest.approx(0.0, abs=1e-9)


def test_of_a_leg_that_differs_the_mean_is_compensated_and_the_rest_is_reported() -> None:
    found = one(DeadTime(), voltage_v=6.0, threshold_a=0.3, leg_a_longer=0.4)
    mean = one(DeadTime(), voltage_v=6.0, threshold_a=0.3)
    assert found.lost_per_bus_v == pytest.approx(mean.lost_per_bus_v, abs=1e-9)
    (left,) = found.left_out
    assert left.reason.startswith("it is compensated in part: leg a's loss is 40 % larger than the legs' mean")


def test_the_tables_error_follows_the_parameters_intervals() -> None:
    exact = one(DeadTime(), voltage_v=6.0, threshold_a=0.3)
    assert not exact.lost_std_v.any()
    found = one(DeadTime(), interval=0.0196, voltage_v=6.0)  # one sigma is 1 % of the voltage
    far = np.abs(found.current_a) > 2.0
    assert found.lost_std_v[far] == pytest.approx(0.06, rel=0.01)
    assert one(VoltageDelay(), interval=0.196, delay_s=1e-5).delay_std_s == pytest.approx(1e-6, rel=1e-6)


def test_the_errors_of_several_parameters_add_in_squares() -> None:
    both = one(VoltageBias(), interval=0.196, bias_a_v=0.2, bias_b_v=0.3)
    alone = [one(VoltageBias(), interval=0.196, bias_a_v=a, bias_b_v=b) for a, b in ((0.2, 0.0), (0.0, 0.3))]
    assert both.bias_std_v == pytest.approx(math.hypot(*(a.bias_std_v for a in alone)))


class LegOnResistance:
    """A third party's effect: a channel resistance, a loss over the bus voltage, and a late sensor, all at once."""

    name: ClassVar[str] = "channel"
    summary: ClassVar[str] = "Channels."
    signature: ClassVar[str] = "Lost voltage."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        channel_ohm: float = amplitude("ohm", typical=0.1, prior_width=0.1, low=0.0, high=1.0)

    def correct(self, signals: Signals, p: Any) -> Correction:
        legs = to_phases(signals.i_ab) * p.channel_ohm
        legs = legs + 0.01 * signals.v_dc[:, None] * np.tanh(to_phases(signals.i_ab)) + 0.001 * legs**2
        slope = np.gradient(signals.i_ab, 1.0 / signals.sampling_frequency_hz, axis=0)
        return Correction(v_ab=signals.v_ab - from_phases(legs), i_ab=signals.i_ab + 1e-5 * slope)


@pytest.mark.slow
def test_an_effect_that_nobody_knows_is_probed_as_well() -> None:
    effect = LegOnResistance()
    found = one(effect, channel_ohm=0.2)
    assert found.lost_v == pytest.approx(0.2 * found.current_a, abs=1e-9)
    assert found.lost_per_bus_v == pytest.approx(0.01 * np.tanh(found.current_a), abs=1e-12)
    assert found.delay_s == pytest.approx(1e-5, rel=1e-6)
    assert found.sources == ("channel",)


class LaggingLoss(LegOnResistance):
    """A dead time's voltage that follows the current with a lag, as a discharging snubber has it."""

    name: ClassVar[str] = "lagging_loss"

    def __init__(self, lag_rows: float) -> None:
        self.lag_rows = lag_rows

    def correct(self, signals: Signals, p: Any) -> Correction:
        keep = math.exp(-1.0 / self.lag_rows)
        legs = np.tanh(to_phases(signals.i_ab) / 0.1) * 10.0 * p.channel_ohm
        lagging = lfilter([1.0 - keep], [1.0, -keep], legs, axis=0, zi=keep * legs[:1])[0]
        return Correction(v_ab=signals.v_ab - from_phases(lagging))


class SensorHysteresis(CommonMode):
    """A core of a current sensor: its reading stays behind by up to a tenth of an ampere, at any speed."""

    name: ClassVar[str] = "sensor_hysteresis"

    def correct(self, signals: Signals, p: Any) -> Correction:
        kept, state = np.zeros_like(signals.i_ab), np.zeros(2)
        for k, change in enumerate(np.diff(signals.i_ab, axis=0, prepend=signals.i_ab[:1])):
            state = np.clip(state + change, -100.0 * p.leak_a_per_v, 100.0 * p.leak_a_per_v)
            kept[k] = state
        return Correction(i_ab=signals.i_ab + kept)


def test_a_loss_that_lags_is_compensated_in_part_and_the_part_left_is_stated() -> None:
    lagging = one(LaggingLoss(10.0), channel_ohm=0.2)
    assert lagging.lost_v[-1] == pytest.approx(2.0, rel=1e-6)
    (left,) = lagging.left_out
    assert left.reason.startswith("it is compensated in part: it depends on earlier currents or voltages, too")
    # A loss of +-V that lags by 10 rows keeps 2 V exp(-t) after its zero crossing, half of the 64 rows that are probed.
    percent = float(left.reason.partition("%")[0].rpartition(" ")[2])
    assert percent == pytest.approx(100.0 * 2.0 * math.sqrt(5.0 / 64.0), rel=0.15)
    assert left.reason.endswith("in 16 ms")  # 128 rows at 8 kHz


@pytest.mark.parametrize("lag_rows", [0.05, 1000.0])
def test_a_loss_that_follows_history_alone_is_in_no_table_and_one_without_lag_has_no_remark(lag_rows: float) -> None:
    found = one(LaggingLoss(lag_rows), channel_ohm=0.2)
    if lag_rows < 1.0:
        assert found.left_out == ()
        return
    neutral(found)
    assert "no table's" in found.left_out[0].reason


def test_a_sensors_hysteresis_is_no_delay() -> None:
    found = one(SensorHysteresis(), leak_a_per_v=1e-3)
    neutral(found)
    assert "earlier currents" in found.left_out[0].reason


class PoorJoint(LegOnResistance):
    """A loss in some of the legs."""

    name: ClassVar[str] = "poor_joint"

    def __init__(self, *legs: float) -> None:
        self.legs = legs

    def correct(self, signals: Signals, p: Any) -> Correction:
        lost = p.channel_ohm * np.tanh(to_phases(signals.i_ab)) * self.legs
        return Correction(v_ab=signals.v_ab - from_phases(lost))


@pytest.mark.parametrize(
    ("legs", "where"),
    [
        ((1.0, 0.0, 0.0), "in phase a alone"),
        ((0.0, 1.0, 1.0), "in phases b and c alone"),
        ((3.0, 1.0, 0.5), "its loss differs from phase to phase"),
    ],
)
def test_a_loss_of_some_legs_is_not_spread_over_all(legs: tuple[float, ...], where: str) -> None:
    found = one(PoorJoint(*legs), channel_ohm=0.2)
    neutral(found)
    assert found.sources == ()
    (left,) = found.left_out
    assert left.reason == f"{where}; the code has one table for all legs"


@pytest.mark.slow
def test_a_loss_that_is_nearly_alike_in_all_legs_is_compensated() -> None:
    assert one(PoorJoint(1.1, 1.0, 0.9), channel_ohm=0.2).sources == ("poor_joint",)


def test_an_effect_that_is_not_installed_is_named() -> None:
    model = model_of(parameters(DeadTime(), voltage_v=6.0))
    with pytest.raises(PluginError, match=r"dead_time.*not installed"):
        Compensation.of(model, [DeviceDrop()], MANIFEST, LARGEST_A)


def test_an_effect_with_other_parameters_is_named() -> None:
    kept = parameters(DeviceDrop(), voltage_v=1.0)
    model = model_of(kept.model_copy(update={"name": "dead_time"}))
    with pytest.raises(PluginError, match=r"dead_time.*parameters"):
        Compensation.of(model, [DeadTime()], MANIFEST, LARGEST_A)


def test_numbers_do_not_depend_on_the_size_of_the_machine() -> None:
    effect = DeadTime()
    small = one(effect, voltage_v=6.0, threshold_a=0.3)
    model = model_of(parameters(effect, voltage_v=6.0, threshold_a=30.0))
    large = Compensation.of(model, [effect], MANIFEST, 100.0 * LARGEST_A)
    assert large.lost_per_bus_v == pytest.approx(small.lost_per_bus_v, abs=1e-12)
    assert all(field.name in vars(large) for field in dataclasses.fields(Compensation))
