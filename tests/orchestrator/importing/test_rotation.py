"""A machine that runs differs from a locked one in its waveforms; a current that pulsates along an axis does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.csv
import pytest

from orchestrator.importing._rotation import turning
from orchestrator.importing.guessing import guess_mapping
from orchestrator.recording import open_recording
from protocols import InputError
from tests.orchestrator.importing.strangers import REDUCED, Desk

SEGMENTS = "segments: [{stage: %s}]\nsampling_frequency_hz: 10000\n"
IN_DQ = "{frame: dq, columns: {d: %s_d, q: %s_q}, unit: %s, scaling: amplitude_invariant}\n"


def running(desk: Desk, stage: str, hz: float, speeding: float = 0.0) -> None:
    """A motor at speed: 2 A on q, resistance, inductance and back-EMF; in phases, and in its own dq frame."""
    rng = np.random.default_rng(0)
    t = np.arange(4000) / 1e4
    theta = 2 * np.pi * hz * t * (1.0 + speeding * t)
    i_dq = 2.0j * np.ones(t.size) + 0.02 * (rng.normal(size=t.size) + 1j * rng.normal(size=t.size))
    v_dq = 4.25 * i_dq + 2j * np.pi * hz * (0.3 + 0.069j * 2.0)
    columns = {"i_d": i_dq.real, "i_q": i_dq.imag, "v_d": v_dq.real, "v_q": v_dq.imag}
    for phase, shift in zip("abc", (0.0, 2 * np.pi / 3, 4 * np.pi / 3), strict=True):
        columns |= {f"{n}{phase}": (x * np.exp(1j * (theta - shift))).real for n, x in (("i", i_dq), ("v", v_dq))}
    desk.write("log.csv", columns)
    desk.mapping = SEGMENTS % stage


@pytest.mark.parametrize(("hz", "speeding"), [(50.0, 0.0), (-20.0, 0.0), (30.0, 1.0)])
@pytest.mark.parametrize("stage", ["resistance", "classical", "injection"])
def test_currents_that_turn_are_no_locked_rotor_s(tmp_path: Path, stage: str, hz: float, speeding: float) -> None:
    desk = Desk(tmp_path)
    running(desk, stage, hz, speeding)
    desk.mapping += "current: {frame: abc, columns: {a: ia, b: ib, c: ic}, unit: A}\n"
    desk.mapping += "voltage: {frame: abc, columns: {a: va, b: vb, c: vc}, unit: V}\n"
    with pytest.raises(
        InputError, match=rf"ia, ib, ic: the current turns \d+ times at .* Hz from row 1 .*: {stage} is"
    ):
        desk.run()


def test_a_running_motor_in_its_own_frame_is_reported_by_its_back_emf(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    running(desk, "resistance", 50.0)
    desk.mapping += f"current: {IN_DQ % ('i', 'i', 'A')}voltage: {IN_DQ % ('v', 'v', 'V')}"
    desk.mapping += "accept: [polarity]\n"
    with pytest.raises(InputError, match=r"v_d, v_q: 10\d V .* exceed the drop at the nameplate's 4.25 ohm: back-EMF"):
        desk.run()


def test_a_current_in_the_wrong_unit_is_reported_before_a_back_emf(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    amps = 7.0 + np.random.default_rng(0).normal(scale=0.01, size=4000)
    desk.write("log.csv", {"i_d": amps, "i_q": 0.0 * amps, "v_d": 4.25 * amps, "v_q": 0.0 * amps})
    desk.mapping = SEGMENTS % "resistance"
    desk.mapping += f"current: {IN_DQ % ('i', 'i', 'mA')}voltage: {IN_DQ % ('v', 'v', 'V')}"
    with pytest.raises(InputError, match=r"nowhere more than 0.007\d* A.*; read in mA, A would fit"):
        desk.run()


def test_nothing_that_a_locked_rotor_does_is_taken_for_turning() -> None:
    recording = open_recording(REDUCED)
    for segment in recording.segments():
        assert turning(np.asarray(recording.load(segment).i_ab, float), 1e4) is None, segment.id


def test_nothing_and_noise_do_not_turn() -> None:
    assert turning(np.zeros((500, 2)), 1e4) is None
    assert turning(np.random.default_rng(0).normal(size=(5000, 2)), 1e4) is None


def test_an_angle_that_goes_round_is_guessed_to_be_a_spin(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    running(desk, "spin", 50.0)
    t = np.arange(4000) / 1e4
    table = pyarrow.csv.read_csv(desk.files[0])
    phases = {f"{kind}{phase}": table[f"{kind}{phase}"].to_numpy() for kind in "iv" for phase in "abc"}
    path = desk.write("spin.csv", {"t": t, "theta": np.angle(np.exp(2j * np.pi * 50.0 * t)), **phases})
    assert "{stage: spin}  # theta goes round" in guess_mapping(path).text
