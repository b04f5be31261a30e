"""Each planted mistake is found and reported with its place; correct data raise no finding."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from orchestrator.importing._waveform_checks import _scaling_hint
from orchestrator.recording import open_recording
from orchestrator.recording._recording_checks import SoundRecording
from protocols import InputError
from tests.orchestrator.importing.benches import PHASES, RATE, Bench, Numbers, held_current, in_phases, phase_log
from tests.support.cases import few
from tests.support.close import assert_close


def complaint(bench: Bench) -> str:
    """The one line that the import ends with, the file's name at its start."""
    with pytest.raises(InputError) as raised:
        bench.run()
    line = str(raised.value)
    assert len(line.splitlines()) == 1
    assert not (bench.folder / "recording").exists()
    return line.removeprefix(f"{bench.folder}/")


def injection(
    n: int = 4000, late: float = 0.0, seed: int = 0, sine: bool = False, trembling_v: float = 0.0
) -> tuple[Numbers, Numbers]:
    """Current and commanded voltage of a rotating injection into a salient winding, the voltage acting late."""
    fine = 20
    t = np.arange(n * fine) / (RATE * fine)
    k = np.arange(n)
    f = np.sin(np.pi / 10 * k) if sine else np.where((k // 10) % 2 == 0, 1.0, -1.0)
    turn = 2.0 * np.pi * 2.0 * k / RATE
    v = 40.0 * f[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]) + np.array([8.0, 3.0])
    v += trembling_v * np.random.default_rng(seed + 1).normal(size=v.shape)
    shift = round(late * fine)
    acting = np.roll(np.repeat(v, fine, axis=0), shift, axis=0)
    inductance, i = np.array([0.043, 0.069]), np.empty((t.size + 1, 2))
    i[0] = np.array([8.0, 3.0]) / 4.25
    decay = np.exp(-4.25 / inductance / (RATE * fine))
    for index, here in enumerate(acting):
        i[index + 1] = i[index] * decay + here / 4.25 * (1.0 - decay)
    noise = 2e-3 * np.random.default_rng(seed).normal(size=(n, 2))
    return i[:-1:fine] + noise, v


# Time


def test_uneven_time_stamps_are_refused_with_the_largest_deviation(bench: Bench) -> None:
    bench.columns["t"][250] += 0.3 / RATE
    message = complaint(bench)
    assert message.startswith("log.csv: t: time stamps are uneven: row 251 (t = 0.02503 s) is 3e-05 s (0.3 samples)")
    assert "resample: true" in message


def test_time_stamps_within_the_tolerance_pass(bench: Bench) -> None:
    bench.columns["t"] = bench.columns["t"] + 0.05 / RATE * np.sin(np.arange(400))
    assert bench.run().sampling_frequency_hz == RATE


def test_resampling_interpolates_currents_keeps_volt_seconds_and_is_noted(bench: Bench) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(400) / RATE + rng.uniform(-0.2, 0.2, 400) / RATE
    t[[0, -1]] = 0.0, 399 / RATE
    i = np.column_stack([2.0 + 30.0 * t, 1.0 - 20.0 * t])
    v = np.array([8.0, 4.0]) + np.repeat(rng.normal(size=(40, 2)), 10, axis=0)
    bench.columns, _ = phase_log(i, v)
    bench.columns["t"] = t
    bench.mapping |= {"resample": True, "sampling_frequency_hz": RATE}
    report = bench.run()
    assert "time stamps are uneven" in report.notes[0]
    assert "resampled to 10000 Hz" in report.notes[0]
    (capture,) = bench.captures()
    grid = np.arange(400) / RATE
    assert_close(capture.i_ab, np.column_stack([2.0 + 30.0 * grid, 1.0 - 20.0 * grid]), 2.0**-22)
    held = v[:-1] * np.diff(t)[:, None]
    np.testing.assert_allclose(capture.v_ab[:-1].sum(axis=0) / RATE, held.sum(axis=0), rtol=1e-6)


def test_another_rate_in_a_later_segment_is_refused_and_can_be_resampled(bench: Bench) -> None:
    slower = bench.columns | {"t": 1.0 + bench.columns["t"] * 1.25}
    bench.files = {"a.csv": bench.columns, "b.csv": slower}
    assert "b.csv: t: sampled at 8000 Hz from row 1 (t = 1 s) on, the recording is at 10000 Hz" in complaint(bench)
    bench.mapping["resample"] = True
    assert bench.run().samples == 400 + 499


def test_a_gap_is_refused_or_splits(bench: Bench) -> None:
    bench.columns["t"][150:] += 0.5
    assert "0.5 s without a sample before row 151 (t = 0.515 s)" in complaint(bench)
    bench.mapping["split_at_gaps"] = True
    report = bench.run()
    segments = open_recording(bench.folder / "recording").segments()
    assert [(s.samples, round(s.start_s, 9)) for s in segments] == [(150, 0.0), (250, 0.515)]
    assert "gap before row 151" in report.notes[0]


@pytest.mark.parametrize("missing", [np.nan, np.inf])
def test_missing_samples_are_refused_or_split(bench: Bench, missing: float) -> None:
    bench.columns["vb"][200:203] = missing
    assert complaint(bench).startswith("log.csv: vb: row 201 (t = 0.02 s) has no finite value, the first of 3")
    bench.mapping["split_at_gaps"] = True
    bench.run()
    assert [len(capture) for capture in bench.captures()] == [200, 197]


def test_a_missing_sample_splits_where_only_the_frequency_is_given(bench: Bench) -> None:
    bench.columns["ia"][100] = np.nan
    del bench.mapping["time"]
    bench.mapping |= {"sampling_frequency_hz": RATE, "split_at_gaps": True}
    bench.run()
    segments = open_recording(bench.folder / "recording").segments()
    assert [(s.samples, s.start_s) for s in segments] == [(100, 0.0), (299, pytest.approx(0.0101))]


def test_stretches_too_short_to_tell_anything_are_left_out_and_noted(bench: Bench) -> None:
    bench.columns["ia"][[100, 105]] = np.nan
    bench.mapping["split_at_gaps"] = True
    report = bench.run()
    assert [len(capture) for capture in bench.captures()] == [100, 294]
    assert any("4 samples" in note and "left out" in note for note in report.notes)


@pytest.mark.parametrize("step", [0.0, -2.0])
def test_time_that_does_not_increase_is_refused(bench: Bench, step: float) -> None:
    bench.columns["t"][300:] += (step - 1.0) / RATE
    assert complaint(bench).startswith("log.csv: t: time does not increase: row 301 ")


def test_a_missing_time_stamp_is_found_not_skipped(bench: Bench) -> None:
    bench.columns["t"][77] = np.nan
    bench.mapping["segments"][0] |= {"from_s": 0.0, "to_s": 1.0}
    assert complaint(bench).startswith("log.csv: t: row 78 has no finite value")


def test_milliseconds_labelled_seconds_are_doubted(bench: Bench) -> None:
    bench.columns["t"] *= 1e3
    assert "t: read in s, the time stamps make 10 Hz; ms would give 10000 Hz" in complaint(bench)


def test_a_given_frequency_against_another_one_is_doubted(bench: Bench) -> None:
    bench.mapping["sampling_frequency_hz"] = 1e3
    assert "the time stamps make 10000 Hz, not 1000 Hz" in complaint(bench)


def test_coarsely_printed_time_stamps_give_the_round_frequency(bench: Bench) -> None:
    bench.columns["t"] = np.round(5.0 + np.arange(400) / 12_500.0, 6)
    assert bench.run().sampling_frequency_hz == 12_500.0


# Units


@pytest.mark.parametrize(("labelled", "by", "fitting"), [("A", 1e3, "mA"), ("mA", 1e-3 * 1e3, "A"), ("kA", 1.0, "A")])
def test_currents_in_another_unit_are_doubted(bench: Bench, labelled: str, by: float, fitting: str) -> None:
    for name in PHASES.values():
        bench.columns[name] *= by
    bench.mapping["current"]["unit"] = labelled
    del bench.mapping["motor"]["stator_resistance_ohm"]
    message = complaint(bench)
    assert "ia, ib, ic: " in message
    assert "rated current" in message
    assert f"read in {labelled}, {fitting} would fit" in message
    assert "accept: [current_unit]" in message


@pytest.mark.parametrize(("labelled", "by", "fitting"), [("V", 1e3, "mV"), ("mV", 1.0, "V"), ("kV", 1.0, "V")])
def test_voltages_in_another_unit_are_doubted(bench: Bench, labelled: str, by: float, fitting: str) -> None:
    for name in ("va", "vb", "vc"):
        bench.columns[name] *= by
    bench.mapping["voltage"]["unit"] = labelled
    message = complaint(bench)
    assert "va, vb, vc: " in message
    assert f"read in {labelled}, {fitting} would fit" in message


def test_volts_over_amperes_that_are_no_winding_s_are_doubted(bench: Bench) -> None:
    del bench.mapping["motor"]["rated_current_rms_a"]
    bench.mapping["current"]["unit"] = "mA"
    assert "va, vb, vc over ia, ib, ic: 4.25e+03 ohm, the nameplate says 4.25 ohm" in complaint(bench)


def test_a_bus_far_from_the_nominal_one_is_doubted(bench: Bench) -> None:
    bench.columns["udc"] = np.full(400, 0.54)
    bench.mapping["bus"] = {"column": "udc", "unit": "V"}
    message = complaint(bench)
    assert "udc: 0.54 V (median" in message
    assert "read in V, kV would fit" in message


def test_more_voltage_than_the_bridge_can_make_is_noted(bench: Bench) -> None:
    bench.mapping["drive"]["dc_bus_voltage_v"] = 10.0
    report = bench.run()
    assert any("more than a bridge makes of 10 V" in note for note in report.notes)


def test_degrees_labelled_radians_are_doubted_in_a_column(bench: Bench) -> None:
    bench.columns["theta"] = np.full(400, 90.0)
    bench.mapping["rotor_angle"] = {"column": "theta", "unit": "rad"}
    assert "theta: 90 rad is beyond a turn; read in rad, deg would fit" in complaint(bench)


def test_degrees_labelled_radians_are_doubted_in_the_mapping(bench: Bench) -> None:
    bench.mapping["segments"][0]["rotor_angle"] = {"value": 30.0, "unit": "rad"}
    assert complaint(bench).startswith("mapping.yaml: segments.0.rotor_angle: 30 rad is beyond a turn")


def test_a_locked_rotor_that_turns_is_doubted(bench: Bench) -> None:
    bench.columns["theta"] = np.linspace(350.0, 370.0, 400) % 360.0
    bench.mapping["rotor_angle"] = {"column": "theta", "unit": "deg"}
    assert "theta: a locked rotor's angle changes by 0.349 rad" in complaint(bench)


# Frame and scaling


def test_a_reversed_phase_is_named(bench: Bench) -> None:
    bench.columns["ic"] *= -1.0
    message = complaint(bench)
    assert "do not add up to zero" in message
    assert "phase c looks reversed" in message


def test_a_reversed_phase_with_little_current_in_it_is_noted(bench: Bench) -> None:
    bench.columns["ib"] *= -1.0
    assert any("phase b may be reversed" in note for note in bench.run().notes)


def test_a_small_zero_sequence_is_noted_only(bench: Bench) -> None:
    bench.columns["ic"] += 0.4
    report = bench.run()
    assert any("zero sequence" in note and "offsets or gains" in note for note in report.notes)


@pytest.mark.parametrize(
    ("true", "by"), [("power_invariant", np.sqrt(1.5)), ("rms", np.sqrt(0.5)), ("amplitude_invariant", 1.0)]
)
@pytest.mark.parametrize("labelled", ["power_invariant", "rms", "amplitude_invariant"])
def test_a_wrong_scaling_shows_beside_the_phase_currents(bench: Bench, true: str, by: float, labelled: str) -> None:
    i, _ = held_current()
    bench.columns |= {"ix": by * i[:, 0], "iy": by * i[:, 1]}
    bench.mapping["current"] = {
        "frame": "alpha_beta",
        "columns": {"alpha": "ix", "beta": "iy"},
        "unit": "A",
        "scaling": labelled,
    }
    bench.mapping["phase_currents"] = {"columns": dict(PHASES), "unit": "A"}
    if labelled == true:
        assert bench.run().notes == ()
    else:
        assert f"labelled {labelled}, {true} would fit" in complaint(bench)


def dq_beside_phases(bench: Bench) -> None:
    i, _ = held_current()
    turned = (i[:, 0] + 1j * i[:, 1]) * np.exp(-0.9j)
    bench.columns |= {"id": turned.real, "iq": turned.imag}
    bench.mapping["current"] = {
        "frame": "dq",
        "columns": {"d": "id", "q": "iq"},
        "unit": "A",
        "scaling": "amplitude_invariant",
        "angle": {"value": 0.9, "unit": "rad"},
    }
    bench.mapping["phase_currents"] = {"columns": dict(PHASES), "unit": "A"}


def test_a_wrong_frame_angle_shows_beside_the_phase_currents(bench: Bench) -> None:
    dq_beside_phases(bench)
    assert bench.run("right").notes == ()
    bench.mapping["current"]["angle"]["value"] = -0.6
    assert "the phase currents are turned by 86 degrees against what these columns give" in complaint(bench)


def test_another_unit_of_the_phase_currents_shows(bench: Bench) -> None:
    dq_beside_phases(bench)
    bench.mapping["phase_currents"]["unit"] = "mA"
    del bench.mapping["motor"]["rated_current_rms_a"]
    assert "the phase currents are 0.001 times what these columns give" in complaint(bench)


# Signals


def test_currents_that_are_all_constant_are_doubted(bench: Bench) -> None:
    for name in PHASES.values():
        bench.columns[name][:] = 0.0
    assert "ia, ib, ic: constant at 0 from row 1 (t = 0 s)" in complaint(bench)


def test_constant_currents_are_what_a_bridge_that_is_off_has(bench: Bench) -> None:
    for name in (*PHASES.values(), "va", "vb", "vc"):
        bench.columns[name][:] = 0.0
    bench.mapping["segments"] = [{"stage": "gates_off"}]
    assert bench.run().notes == ()


def test_one_dead_channel_is_noted(bench: Bench) -> None:
    i, v = held_current()
    bench.columns, _ = phase_log(i, v * [1.0, 0.0])
    bench.columns |= {"ix": i[:, 0], "iy": np.zeros(400)}
    bench.mapping["current"] = {
        "frame": "alpha_beta",
        "columns": {"alpha": "ix", "beta": "iy"},
        "unit": "A",
        "scaling": "amplitude_invariant",
    }
    report = bench.run()
    assert any("iy: constant at 0" in note for note in report.notes)


def test_a_voltage_that_is_zero_throughout_is_doubted(bench: Bench) -> None:
    for name in ("va", "vb", "vc"):
        bench.columns[name][:] = 0.0
    assert "va, vb, vc: zero from row 1" in complaint(bench)


@pytest.mark.parametrize("which", ["current", "voltage"])
def test_reversed_polarity_is_found_and_a_factor_mends_it(bench: Bench, which: str) -> None:
    columns = bench.mapping[which]["columns"].values()
    for name in columns:
        bench.columns[name] *= -1.0
    assert "180 degrees apart" in complaint(bench)
    bench.mapping[which]["factor"] = -1.0
    assert bench.run().notes == ()


def test_a_voltage_without_a_current_at_the_beginning_is_noted(bench: Bench) -> None:
    n = 6000
    i = np.column_stack([np.where(np.arange(n) < 3000, 0.0, 2.0), np.zeros(n)])
    v = np.column_stack([np.where(np.arange(n) < 3000, 3.0, 8.5), np.zeros(n)])
    bench.columns, _ = phase_log(i + 1e-3 * np.random.default_rng(7).normal(size=i.shape), v)
    (note,) = bench.run().notes
    assert "3 V stand for 0.3 s and no current flows: was the bridge off?" in note
    bench.columns = {name: values[3000:] for name, values in bench.columns.items()}
    assert bench.run("enabled").notes == ()


def test_exchanged_phases_are_found(bench: Bench) -> None:
    bench.mapping["voltage"]["columns"] = {"a": "vb", "b": "vc", "c": "va"}
    message = complaint(bench)
    assert "120 degrees apart" in message
    assert "phases are exchanged" in message


def test_phases_that_are_exchanged_look_reversed_across_an_axis_alone(bench: Bench) -> None:
    levels = np.repeat([[2.0, 0.0], [0.0, 2.0]], 2000, axis=0)
    i = levels + 1e-3 * np.random.default_rng(8).normal(size=levels.shape)
    bench.columns, _ = phase_log(i * [1.0, -1.0], 4.25 * levels)
    bench.columns["point"] = np.repeat(["d", "q"], 2000)
    bench.mapping["segment_column"] = "point"
    bench.mapping["segments"] = [{"label": "*", "stage": "resistance"}]
    message = complaint(bench)
    assert "180 degrees apart" in message
    assert "two phases of one of both may be exchanged" in message


def as_injection(bench: Bench, late: float, sine: bool = False) -> None:
    bench.columns, _ = phase_log(*injection(late=late, sine=sine))
    bench.mapping["segments"] = [{"stage": "injection"}]


def test_reversed_polarity_is_found_under_an_injection(bench: Bench) -> None:
    as_injection(bench, 0.0)
    bench.mapping["voltage"]["factor"] = -1.0
    assert "180 degrees apart" in complaint(bench)


@pytest.mark.parametrize("known", [True, False], ids=["R known", "R not known"])
def test_a_current_that_decays_beneath_whole_periods_is_not_reversed(bench: Bench, known: bool) -> None:
    """An alternating voltage that is switched on leaves a current that no voltage drives, and that decays."""
    t = np.arange(4000) / RATE
    v = np.round(30.0 * np.sin(2.0 * np.pi * 50.0 * t), 6)
    ohm, henry = 0.5, 0.05
    decay = np.exp(-ohm / henry / RATE)
    i = lfilter([0.0, (1.0 - decay) / ohm], [1.0, -decay], v) + 1e-3 * np.random.default_rng(3).normal(size=t.size)
    zero = np.zeros_like(t)
    bench.columns, _ = phase_log(np.column_stack([i, zero]), np.column_stack([v, zero]))
    bench.mapping["motor"]["stator_resistance_ohm"] = ohm if known else None
    bench.run()
    SoundRecording(open_recording(bench.folder / "recording")).read_through()


@few("late", [1.0, 1.5, 2.75, -1.0], fast=2)
def test_a_voltage_that_acts_late_is_noted_with_the_lag(bench: Bench, late: float) -> None:
    as_injection(bench, late)
    report = bench.run()
    (note,) = report.notes
    message = re.search(r"voltage_delay_samples is 0: (-?[0-9.]+) would fit", note)
    assert message is not None
    assert float(message[1]) == pytest.approx(late, abs=0.1)


@few("known", [True, False], ids=["R known", "R not known"])
@pytest.mark.parametrize("late", [0.0, 1.0])
def test_a_sines_lag_is_noted_where_the_nameplate_has_the_resistance(bench: Bench, late: float, known: bool) -> None:
    as_injection(bench, late, sine=True)
    if not known:
        bench.mapping["motor"]["stator_resistance_ohm"] = None
    notes = bench.run().notes
    assert len(notes) == (late > 0.0 and known)
    assert all("by the phase of a sine at 4.25 ohm" in note and "1.0 would fit" in note for note in notes)


@few("late", [0.0, 1.0, 1.5])
def test_a_lag_that_the_mapping_knows_of_is_not_stated(bench: Bench, late: float) -> None:
    as_injection(bench, late)
    bench.mapping["drive"]["voltage_delay_samples"] = late
    assert bench.run().notes == ()


# All of them


def spoil_unit(bench: Bench) -> None:
    bench.mapping["current"]["factor"] = 30.0
    bench.mapping["motor"]["stator_resistance_ohm"] = None


def spoil_zero_sequence(bench: Bench) -> None:
    for name in ("ic", "vc"):
        bench.columns[name] *= -1.0
    bench.mapping["motor"]["stator_resistance_ohm"] = None


def spoil_polarity(bench: Bench) -> None:
    bench.mapping["current"]["factor"] = -1.0
    bench.mapping["motor"]["stator_resistance_ohm"] = None


@pytest.mark.parametrize(
    ("name", "spoil"),
    [("current_unit", spoil_unit), ("zero_sequence", spoil_zero_sequence)],
)
def test_what_is_accepted_becomes_a_note(bench: Bench, name: str, spoil: Callable[[Bench], None]) -> None:
    spoil(bench)
    assert f"accept: [{name}]" in complaint(bench)
    bench.mapping["accept"] = [name]
    assert any(note.endswith("(accepted)") for note in bench.run().notes)


def test_what_no_command_would_read_is_refused_even_where_it_is_accepted(bench: Bench) -> None:
    spoil_polarity(bench)
    bench.mapping["accept"] = ["polarity"]
    assert "no command would read the recording: voltage and current are 180 degrees apart" in complaint(bench)
    assert not (bench.folder / "recording").exists()


def test_the_same_note_is_stated_once_and_counted(bench: Bench) -> None:
    files: dict[str, dict[str, Any]] = {f"{k}.csv": bench.columns for k in range(4)}
    bench.files = files
    (note,) = bench.run().notes
    assert note.endswith("the same 2 times more")


def test_phase_quantities_of_a_vector_are_its_projections() -> None:
    a, b, c = in_phases(np.array([[1.0, 0.0]]))[0]
    assert (a, b, c) == (pytest.approx(1.0), pytest.approx(-0.5), pytest.approx(-0.5))


def test_where_no_scaling_was_claimed_none_is_suggested() -> None:
    assert _scaling_hint(None, 2.0) == ""
    assert _scaling_hint("rms", 1.0) == ""
    assert _scaling_hint("rms", 1.0 / np.sqrt(2.0)).endswith("amplitude_invariant would fit")
