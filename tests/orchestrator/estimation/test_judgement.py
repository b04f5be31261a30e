"""Which map is recommended, whether it can be relied on, and what is stated of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.estimation import estimate_recording
from protocols import (
    AxisPercent,
    Basis,
    CheckOutcome,
    Estimate,
    EstimationContext,
    EstimationReport,
    Estimator,
    FluxMapEstimate,
    IncrementalInductances,
    MapChecks,
    MapCriteria,
    RecordingReader,
    Remark,
    ResistanceReading,
)
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.orchestrator.estimation.made_up import (
    R_S,
    RECORDING,
    SOUND,
    Injected,
    Mapper,
    OneEnergy,
    Resistance,
    Ripples,
    Sweeps,
    explained,
)
from tests.support.cases import few

WORSE = AxisPercent(d_percent=1.0, q_percent=12.0)


def judged(folder: Path, *estimators: Estimator, **criteria: float) -> EstimationReport:
    return estimate_recording(RECORDING, estimators, folder, criteria=MapCriteria(**criteria), check_model=explained)


def stated(report: EstimationReport, code: str) -> Remark:
    (found,) = (remark for remark in report.remarks if remark.code == code)
    return found


def test_the_map_of_the_highest_rank_is_recommended(tmp_path: Path) -> None:
    report = judged(tmp_path, Mapper("other"), Sweeps(), Ripples(), OneEnergy())
    assert list(report.maps) == ["one_energy", "ripples", "sweeps", "other"]
    assert report.method == "one_energy"


@pytest.mark.parametrize(("factor", "method"), [(0.99, "one_energy"), (0.9, "ripples")])
def test_an_energy_is_recommended_where_it_explains_the_measurements(
    factor: float, method: str, tmp_path: Path
) -> None:
    energy = OneEnergy(factor=factor)
    report = judged(tmp_path, energy, Ripples())
    assert report.method == method
    assert energy.saw is not None
    assert [made.map.method for made in energy.saw.of(Injected)] == ["ripples"]
    assert judged(tmp_path, energy, Ripples(), energy_percent=20.0).method == "one_energy"


def test_an_energy_beside_nothing_is_recommended(tmp_path: Path) -> None:
    assert judged(tmp_path, OneEnergy(factor=0.5)).method == "one_energy"


def test_symmetry_is_reported_of_a_map_that_does_not_have_it_by_construction(tmp_path: Path) -> None:
    checks = MapChecks(parity=AxisPercent(d_percent=0.7, q_percent=0.8), reciprocity_percent=0.4)
    report = judged(tmp_path, OneEnergy(), Sweeps(), Ripples(checks=checks))
    assert report.recommended is not None
    assert report.recommended.basis is Basis.ENERGY
    assert report.measured_symmetry == "ripples"
    assert report.maps["ripples"].checks == checks
    assert judged(tmp_path, OneEnergy()).measured_symmetry is None


@few("factor, percent", [(0.95, 5.0), (1.03, 3.0), (0.995, None)])
def test_a_difference_of_the_methods_is_put_in_words(factor: float, percent: float | None, tmp_path: Path) -> None:
    report = judged(tmp_path, Sweeps(), Ripples(factor=factor))
    assert report.usable == (percent is None)
    assert ("flux_ratio" in {remark.code for remark in report.remarks}) == (percent is not None)
    if percent is not None:
        reported = stated(report, "flux_ratio")
        assert reported.values["apart_percent"] == pytest.approx(percent)
        assert reported.text.endswith("`fluxbench diagnose` finds the cause")
        assert (reported.values["size"] == "less") == (factor < 1.0)


def test_an_energys_map_is_not_usable_where_what_it_was_fitted_to_is_not_even(tmp_path: Path) -> None:
    uneven = MapChecks(parity=AxisPercent(d_percent=0.7, q_percent=9.0))
    report = judged(tmp_path, OneEnergy(), Sweeps(), Ripples(checks=uneven))
    assert report.method == "one_energy"
    assert not report.usable
    assert stated(report, "bad_parity").values == {"axis": "q", "off_percent": 9.0}


def test_methods_that_differ_much_leave_no_map_usable(tmp_path: Path) -> None:
    report = judged(tmp_path, Sweeps(), Ripples(factor=0.8))
    assert not report.usable
    difference = report.classical_against_injection_percent
    assert difference is not None
    assert stated(report, "methods_differ").values["apart_percent"] == difference
    assert judged(tmp_path, Sweeps(), Mapper("other", factor=0.8)).classical_against_injection_percent is None


@pytest.mark.parametrize(
    ("checks", "code"),
    [
        (MapChecks(crossings=WORSE, parity=SOUND.parity), "bad_crossings"),
        (MapChecks(crossings=SOUND.crossings, parity=WORSE), "bad_parity"),
    ],
)
def test_a_map_that_contradicts_itself_is_not_usable(checks: MapChecks, code: str, tmp_path: Path) -> None:
    report = judged(tmp_path, Sweeps(), Ripples(checks=checks))
    assert not report.usable
    assert report.remarks[0].code == code
    assert report.remarks[0].values["axis"] == "q"
    assert "12.0 %" in report.reasons[0]
    tolerant = judged(tmp_path, Sweeps(), Ripples(checks=checks), crossings_percent=20.0, parity_percent=20.0)
    assert tolerant.usable
    assert tolerant.criteria.parity_percent == 20.0


def test_without_a_map_nothing_is_usable(tmp_path: Path) -> None:
    report = judged(tmp_path, Resistance())
    assert not report.usable
    assert stated(report, "no_map")
    assert report.recommended is None


def test_of_two_resistances_the_narrower_interval_is_used_and_the_other_reported(tmp_path: Path) -> None:
    class Rough(Resistance):
        def estimate(self, recording: object, context: object) -> Estimate:
            return R_S.model_copy(update={"value_ohm": 4.5, "low": 4.0, "high": 5.0})

    Rough.name = "rough"
    report = judged(tmp_path, Rough(), Resistance())
    assert report.resistance == R_S
    assert stated(report, "rough.wider_interval").values == {"value_ohm": 4.5, "low": 4.0, "high": 5.0}


def test_inductances_are_summed_up_where_they_are_known(tmp_path: Path) -> None:
    made = judged(tmp_path, Sweeps()).maps["sweeps"].inductances
    assert made is not None
    assert 0.0 < made.l_dd_low_h < made.l_dd_high_h
    assert 0.0 < made.l_dq_largest_h < made.l_qq_high_h


def outcome(report: EstimationReport, name: str) -> CheckOutcome:
    (found,) = (check.outcome for check in report.checks if check.name == name)
    return found


def test_a_check_that_cannot_be_made_has_not_passed(tmp_path: Path) -> None:
    nothing = MapChecks()
    report = judged(tmp_path, Sweeps(checks=nothing))
    assert not report.usable
    assert report.remarks[0].code == "unchecked"
    assert [outcome(report, name) for name in ("crossings", "parity")] == 2 * [CheckOutcome.NOT_POSSIBLE]
    # Two methods that agree show that the flux does not depend on the way; they do not show the angle.
    both = judged(tmp_path, Sweeps(checks=nothing), Ripples(checks=nothing))
    assert [check.name for check in both.checks if not check.is_met] == ["parity"]
    assert judged(tmp_path, Sweeps(checks=nothing), Ripples()).usable


def test_injection_alone_is_usable_where_a_second_frequency_sees_the_same(tmp_path: Path) -> None:
    assert not judged(tmp_path, Ripples()).usable
    for second_hz, factor, usable in ((1000.0, 1.0, True), (1000.0, 1.03, False), (550.0, 1.0, False)):
        injected = [seen(500.0, 1.0), seen(second_hz, factor)]
        assert judged(tmp_path, Ripples(incremental=tuple(injected))).usable is usable


def seen(frequency_hz: float, factor: float) -> IncrementalInductances:
    inductance = factor * np.array([[0.04, 0.0, 0.07], [0.03, 0.001, 0.06]])
    return IncrementalInductances(
        frequency_hz=frequency_hz, amplitude_v=40.0, i_dq=np.array([[0.0, 0.0], [1.0, 1.0]]), inductance=inductance
    )


def test_methods_that_differ_by_more_than_the_promise_leave_no_map_usable(tmp_path: Path) -> None:
    report = judged(tmp_path, Sweeps(), Ripples(factor=0.98), least_flux_ratio=1.0)
    assert outcome(report, "methods") is CheckOutcome.FAILED
    assert not report.usable
    assert judged(tmp_path, Sweeps(), Ripples(factor=0.98), least_flux_ratio=1.0, accuracy_percent=3.0).usable


def test_a_map_that_stops_before_the_rated_current_is_checked_against_its_own_edge(tmp_path: Path) -> None:
    motor = RECORDING.manifest.motor.model_copy(update={"rated_current_rms_a": 2.5})
    recording = MemoryRecording(RECORDING.manifest.model_copy(update={"motor": motor}), {})
    report = estimate_recording(recording, [Sweeps(), Ripples(factor=0.8)], tmp_path)
    assert stated(report, "rated_current_not_reached").values["reference_wb"] is not None
    assert report.classical_against_injection_percent is not None
    assert not report.usable


def test_a_nameplate_without_a_rated_current_is_said_to_have_none(tmp_path: Path) -> None:
    motor = RECORDING.manifest.motor.model_copy(update={"rated_current_rms_a": None})
    assert motor.rated_current_a is None
    recording = MemoryRecording(RECORDING.manifest.model_copy(update={"motor": motor}), {})
    report = estimate_recording(recording, [Sweeps(), Ripples()], tmp_path)
    remark = stated(report, "rated_current_not_given")
    assert remark.text.startswith("the nameplate has no rated current: percentages of the rated flux refer to ")
    assert "rated_current_not_reached" not in {one.code for one in report.remarks}


@pytest.mark.parametrize(
    ("resistance", "name"),
    [
        ({"value_ohm": 0.019, "low": -0.21, "high": 0.25}, "resistance_interval"),
        ({"value_ohm": -1.0, "low": -1.1, "high": -0.9}, "resistance_interval"),
        ({"readings": [(0.0, 3.0), (1.0, 5.0), (2.0, 3.0), (3.0, 5.2)]}, "resistance_scatter"),
    ],
)
def test_a_resistance_that_is_not_known_leaves_no_map_usable(
    resistance: dict[str, Any], name: str, tmp_path: Path
) -> None:
    fields = dict(resistance)
    if "readings" in fields:
        fields["readings"] = tuple(
            ResistanceReading(start_s=at, value_ohm=ohm, std_ohm=0.01) for at, ohm in fields["readings"]
        )

    class Doubtful(Resistance):
        def estimate(self, recording: object, context: object) -> Estimate:
            return R_S.model_copy(update=fields)

    report = judged(tmp_path, Doubtful(), Sweeps(), Ripples())
    assert [check.name for check in report.checks if not check.is_met] == [name]
    assert not report.usable


def test_an_energy_that_is_not_convex_is_not_usable(tmp_path: Path) -> None:
    class Bent(Sweeps):
        def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
            made = super().estimate(recording, context)
            assert isinstance(made, FluxMapEstimate)
            bent = made.map.model_copy(update={"l_dq": 2.0 * made.map.l_qq})
            return made.model_copy(update={"map": bent})

    report = judged(tmp_path, Bent(), Ripples(), Resistance())
    assert outcome(report, "convex") is CheckOutcome.PASSED
    alone = judged(tmp_path, Bent())
    assert outcome(alone, "convex") is CheckOutcome.FAILED
    assert not alone.usable


def test_a_flux_whose_band_is_wider_than_the_promise_is_not_usable(tmp_path: Path) -> None:
    class Vague(Sweeps):
        def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
            made = super().estimate(recording, context)
            assert isinstance(made, FluxMapEstimate)
            wide = np.full_like(made.map.psi_d, 0.01)
            return made.model_copy(update={"map": made.map.model_copy(update={"psi_d_std": wide, "psi_q_std": wide})})

    report = judged(tmp_path, Vague())
    assert [check.name for check in report.checks if not check.is_met] == ["flux_band"]


@pytest.mark.parametrize("beside", [(), (OneEnergy(),)])
def test_slopes_that_contradict_each_other_leave_no_map_usable(beside: tuple[Mapper, ...], tmp_path: Path) -> None:
    report = judged(tmp_path, Ripples(checks=MapChecks(reciprocity_percent=30.0)), *beside)
    assert not report.usable
    assert stated(report, "bad_reciprocity").values["apart_percent"] == 30.0
