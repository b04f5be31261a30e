"""The simulated drive with a switched inverter: its sensors, its options, its memory."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plugins.drives.simulated import SimulatedDrive
from plugins.drives.simulated import _state as layout
from plugins.drives.simulated._sensing import SensingParameters, sense
from protocols import Excitation, GatesOff, Hold, Injection, InputError, Limits, Motor, Trapezoid
from tests.plugins.drives.simulated.conftest import MOTORS, Bench, rows

FS = 10_000.0
QUIET = {"noise_a": 0.0, "quantum_a": 0.0}
IDEAL = SensingParameters(
    three=False, gain=(1.0, 1.0, 1.0), offset_a=(0.0, 0.0, 0.0), cubic_per_a2=0.0, even_per_a=0.0, noise_a=0.0,
    drift_a=0.0, remanence_a=0.0, remanence_share=0.0, quantum_a=0.0, full_scale_a=math.inf,
)  # fmt: skip
EVERYTHING: dict[str, Any] = {
    "dead_time": {"voltage_v": 1.0}, "device_drop": {"voltage_v": 0.5}, "hysteresis": {"half_width_a": 0.02},
    "eddy_currents": {"core_loss_ohm": 2000.0}, "winding_heating": {"rise_per_watt": 1e-4},
    "bus_sag": {"per_watt": 1e-6}, "voltage_delay": {"delay_s": 1e-6}, "skin_effect": {"extra_ohm": 0.01},
    "current_filter": {"time_constant_s": 1e-6}, "brake_compliance": {"rad_per_nm": 1e-4},
}  # fmt: skip


def switched(**plant: Any) -> dict[str, Any]:
    return {"inverter": "switched", "sensors": QUIET, **plant}


def readings(s: SensingParameters, i_a: np.ndarray, i_b: np.ndarray, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """(alpha, beta) and the phases as the sensors read them."""
    x, n = np.zeros(layout.STATE_LENGTH), len(i_a)
    noise = np.random.default_rng(seed).standard_normal((n, 6)).astype(np.float32)
    phases, found = np.zeros((n, 3), np.float32), np.zeros((n, 2))
    for k in range(n):
        x[layout.READING_A], x[layout.READING_B] = i_a[k], i_b[k]
        found[k] = sense(s, x, noise, k, phases)
    return found, phases


# Sensors


def test_three_sensors_are_recorded_and_their_common_offset_is_not_in_the_vector(bench: Bench) -> None:
    sensors = {**QUIET, "offset_c_a": 0.03}
    drive = bench(
        plant=switched(sensors=sensors), effects={"current_offset": {"offset_a_a": 0.03, "offset_b_a": 0.03}},
        current_sensors=3,
    )  # fmt: skip
    (block,) = drive.execute(GatesOff(duration_s=0.02))
    assert block.i_abc is not None
    assert block.i_abc == pytest.approx(0.03)
    assert block.i_ab == pytest.approx(0.0, abs=1e-7)
    two = bench(plant=switched())
    assert next(iter(two.execute(GatesOff(duration_s=0.02)))).i_abc is None


def test_a_third_sensor_has_a_gain_of_its_own() -> None:
    s = IDEAL._replace(three=True, gain=(1.0, 1.0, 1.03))
    vector, phases = readings(s, np.array([1.0]), np.array([1.0]))
    assert phases[0] == pytest.approx([1.0, 1.0, -2.06])
    assert vector[0] == pytest.approx([(2 - 1 + 2.06) / 3, (1 + 2.06) / math.sqrt(3)])


def test_an_even_error_is_the_same_for_both_signs() -> None:
    s = IDEAL._replace(even_per_a=0.01, cubic_per_a2=0.001)
    (up, down), _ = readings(s, np.array([2.0, -2.0]), np.zeros(2))
    assert up[0] == pytest.approx(2.0 + 0.04 + 0.008)
    assert down[0] == pytest.approx(-2.0 + 0.04 - 0.008)


def test_a_drifting_offset_walks_as_far_as_the_root_of_time() -> None:
    s = IDEAL._replace(drift_a=1e-4)
    nothing = np.zeros(400)
    ends = [readings(s, nothing, nothing, seed)[0][[99, 399], 0] for seed in range(60)]
    near, far = np.std(ends, axis=0)
    assert far == pytest.approx(1e-4 * 20.0, rel=0.3)
    assert near == pytest.approx(1e-4 * 10.0, rel=0.3)


def test_a_core_remembers_the_last_large_current() -> None:
    s = IDEAL._replace(remanence_a=0.02, remanence_share=0.05)
    path = np.concatenate(
        [np.linspace(0, 3, 50), np.linspace(3, 0, 50), np.linspace(0, -3, 50), np.linspace(-3, 0, 50)]
    )
    vector, _ = readings(s, path, np.zeros(200))
    error = vector[:, 0] - path
    assert error[49] == pytest.approx(0.02)
    assert error[99] == pytest.approx(-0.02)
    assert error[199] == pytest.approx(0.02)


def test_a_converter_has_steps_and_ends() -> None:
    s = IDEAL._replace(quantum_a=2 * 6.0 / 2**10, full_scale_a=6.0)
    vector, _ = readings(s, np.linspace(-7, 7, 5000), np.zeros(5000))
    steps = np.unique(np.round(vector[:, 0], 9))
    assert len(steps) == 2**10 + 1
    assert steps[[0, -1]] == pytest.approx([-6.0, 6.0])


def test_the_converters_bits_are_the_drives(bench: Bench) -> None:
    drive = bench(plant=switched(sensors={"noise_a": 0.02, "bits": 10, "full_scale_a": 8.0}))
    i, _ = rows(drive, Hold(current_d_a=1.0, current_q_a=0.0, settle_s=0.3, duration_s=0.1))
    codes = i[:, 0] / (16.0 / 1024)
    assert codes == pytest.approx(np.round(codes), abs=1e-4)


# What is refused


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"plant": {"switching": {"dead_time_s": 1e-6}}}, r"drive\.plant: switching: needs plant\.inverter: switched"),
        ({"plant": {"sensors": {"bits": 12}}}, r"bits: needs plant\.inverter: switched"),
        ({"current_sensors": 3}, r"current_sensors: needs plant\.inverter: switched"),
        ({"current_sampling": "averaged"}, r"current_sampling: needs plant\.inverter: switched"),
        (
            {"plant": switched(switching={"minimum_pulse_s": 2e-4})},
            r"minimum_pulse_s: 200 us is no shorter than the period of the carrier at 20000 Hz",
        ),
        ({"plant": switched(switching={"dead_time_s": 3e-5})}, "dead_time_s: 30 us is no shorter than half the period"),
        ({"plant": switched(switching={"timer_s": 1e-3})}, "timer_s: 1000 us is no shorter than half the period"),
        ({"plant": switched(switching={"sampling_offset_s": -3e-5})}, "sampling_offset_s: -30 us is half the period"),
        (
            {"plant": switched(effects={"voltage_delay": {"delay_s": 3e-5}})},
            r"sampling_offset_s: with effects\.voltage_delay",
        ),
        (
            {"plant": switched(switching={"output_capacitance_f": 1e-3})},
            r"output_capacitance_f: the .* A at which the drive trips take .* to commutate, longer than half",
        ),
        (
            {"plant": switched(switching={"bus": {"resistance_ohm": 1000.0}})},
            r"bus\.resistance_ohm: 1000 ohm passes at most .* W",
        ),
        ({"plant": switched(sensors={"gain_c_minus_1": 0.01})}, r"gain_c_minus_1: this drive has two sensors"),
        ({"plant": switched(sensors={"offset_c_a": 0.01})}, r"offset_c_a: this drive has two sensors"),
        ({"plant": switched(sensors={"bits": 12, "quantum_a": 0.01})}, "bits: give either bits or quantum_a"),
        ({"plant": switched(sensors={"full_scale_a": 9.0})}, "full_scale_a: belongs to a converter"),
        ({"plant": switched(sensors={"bits": 12, "full_scale_a": 2.0})}, "full_scale_a: 2 A is below"),
        ({"plant": switched(), "pwm_frequency_hz": 8000.0}, "carrier peaks or valleys; at 8000 Hz"),
        ({"plant": switched(), "pwm_frequencies_hz": (4000.0,)}, "pwm_frequencies_hz: .* at 4000 Hz"),
        ({"plant": switched(), "voltage_delay_samples": 0.3}, r"rows \(also 0\.3 samples later\)"),
        ({"plant": switched(), "voltage_delay_samples": 2.5}, "voltage_delay_samples: two samples at most"),
    ],
)  # fmt: skip
def test_bad_options_get_one_line(bench: Bench, options: dict[str, Any], message: str) -> None:
    plant = options.pop("plant", {})
    with pytest.raises(InputError, match=message) as refused:
        bench(plant=plant, effects=plant.pop("effects", None), noise=True, **options)
    assert "\n" not in str(refused.value)


def test_pwm_frequencies_that_the_delay_does_not_fit_are_not_offered(bench: Bench) -> None:
    half = bench(armed=False, plant=switched(), voltage_delay_samples=0.5).connect()
    assert half.pwm_frequencies_hz == (10_000.0, 20_000.0)
    assert bench(armed=False, plant=switched()).connect().pwm_frequencies_hz == (5_000.0, 10_000.0, 20_000.0)


# The drive as a whole


def test_with_the_bridge_off_the_sensors_alone_are_read(bench: Bench) -> None:
    effects = {"dead_time": {"voltage_v": 3.0}, "eddy_currents": {"core_loss_ohm": 500.0}}
    drive = bench(plant=switched(damper={"axis": "d", "ohm": 50.0}), effects=effects)
    rows(drive, Hold(current_d_a=1.0, current_q_a=0.0, settle_s=0.2, duration_s=0.05))
    i, v = rows(drive, GatesOff(duration_s=0.05))
    assert np.abs(i).max() < 1e-3  # the damper's flux takes its time
    assert not v.any()


@pytest.mark.parametrize("motor", MOTORS)
def test_a_bench_with_everything_reaches_its_set_point(bench: Bench, motor: Motor) -> None:
    assert motor.rated_current_a is not None
    drive = loaded(bench, motor=motor)
    i, _ = rows(drive, Hold(current_d_a=0.0, current_q_a=0.7 * motor.rated_current_a, settle_s=1.0, duration_s=0.2))
    assert i.mean(axis=0) == pytest.approx([0.0, 0.7 * motor.rated_current_a], abs=0.005 * motor.rated_current_a)


def loaded(bench: Bench, **more: Any) -> SimulatedDrive:
    switching = {"timer_s": 2e-8, "sampling_offset_s": -1e-6, "bus": {"capacitance_f": 1e-3, "resistance_ohm": 0.1}}
    sensors = {"drift_a_per_sqrt_s": 1e-4, "remanence_a": 1e-3, "offset_c_a": 1e-3}
    return bench(
        effects=EVERYTHING, noise=True, current_sensors=3, plant=switched(switching=switching, sensors=sensors), **more
    )


CAMPAIGN: tuple[Excitation, ...] = (
    Hold(current_d_a=2.0, current_q_a=0.0, settle_s=0.5, duration_s=0.1, pwm_frequency_hz=5000.0),
    Injection(
        target_d_a=1.0, target_q_a=1.0, settle_s=0.3, duration_s=0.6, amplitude_v=40.0, frequency_hz=500.0,
        rotation_hz=5.0,
    ),
    GatesOff(duration_s=0.1),
    Trapezoid(swept_axis="d", held_a=1.0, amplitude_a=2.0, period_s=0.5, periods=1, settle_s=0.2),
)  # fmt: skip


@pytest.mark.parametrize("stop", [0, 1])
def test_a_restored_run_is_the_same_bit_for_bit(bench: Bench, tmp_path: Path, stop: int) -> None:
    whole = loaded(bench, private=tmp_path, armed=False)
    whole.arm(Limits(current_a=4.0, voltage_v=150.0))
    samples = []
    for number, excitation in enumerate(CAMPAIGN):
        samples.append(rows(whole, excitation))
        if number == stop:
            whole.checkpoint(f"point-{number}")
            clock = whole.telemetry().time_s
    again = loaded(bench, private=tmp_path, armed=False)
    again.restore(f"point-{stop}", clock)
    again.arm(Limits(current_a=4.0, voltage_v=150.0))
    for excitation, (i, v) in zip(CAMPAIGN[stop + 1 :], samples[stop + 1 :], strict=True):
        other_i, other_v = rows(again, excitation)
        assert np.array_equal(i, other_i)
        assert np.array_equal(v, other_v)
