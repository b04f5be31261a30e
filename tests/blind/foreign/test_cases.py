"""Cases and their recordings: drawn from a seed, whole, and telling nothing of what is hidden."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from orchestrator.recording import open_recording
from tests.blind.foreign.__main__ import main
from tests.blind.foreign.cases import EFFECTS, KINDS, NO_CATALOGUE, Case, draw_case
from tests.blind.foreign.examine import examine
from tests.blind.foreign.judge import judge
from tests.blind.foreign.machines import FAMILIES
from tests.blind.foreign.record import captured, measured_truth, record

QUICK = "thirty_seconds"


@pytest.fixture(autouse=True)
def one_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one that is tabulated soonest."""
    monkeypatch.setattr("tests.blind.foreign.cases.FAMILIES", {"synrm": FAMILIES["synrm"]})


def quick(case: Case, plan: str = QUICK) -> Case:
    return replace(case, rig=replace(case.rig, plan=plan))


def test_a_case_follows_from_class_index_and_seed() -> None:
    def parts(case: Case) -> tuple[object, ...]:
        return case.label, case.family, case.truths, case.rig.plant, case.rig.plan

    assert parts(draw_case("clean", 2, 9)) == parts(draw_case("clean", 2, 9))
    assert parts(draw_case("clean", 2, 9)) != parts(draw_case("clean", 2, 10))
    with pytest.raises(ValueError, match="there is clean, single"):
        draw_case("odd", 0, 1)


def test_every_class_effect_and_foreigner_is_drawn() -> None:
    assert {draw_case("single", n, 1).truths[0].name for n in range(len(EFFECTS))} == set(EFFECTS)
    assert {draw_case("no_catalogue", n, 1).foreign for n in range(len(NO_CATALOGUE))} == set(NO_CATALOGUE)
    assert {draw_case(kind, 0, 1).kind for kind in KINDS} == set(KINDS)
    assert len(draw_case("ordinary", 0, 1).truths) == len(EFFECTS)


def synrm_case(name: str, seed: int = 3) -> Case:
    """One effect, the quick plan."""
    return quick(draw_case("single", list(EFFECTS).index(name), seed))


def test_a_recording_is_whole_and_tells_nothing(tmp_path: Path) -> None:
    case = synrm_case("rotor_misalignment")
    path = record(case.rig, tmp_path / "bench")
    recording = open_recording(path)
    for segment in recording.segments():
        assert len(recording.load(segment)) == segment.samples
    manifest = (path / "recording.json").read_text()
    assert "misal" not in manifest
    assert str(case.rig.plant.resistance) not in manifest


@pytest.mark.slow
def test_a_healthy_plant_agrees_with_its_own_map() -> None:
    case = synrm_case("rotor_misalignment")
    healthy = replace(case.rig, plant=case.rig.plant._replace(misaligned=0.0))
    nothing, misaligned = measured_truth(healthy), measured_truth(case.rig)
    assert nothing["flux_percent"] < 0.03
    assert nothing["voltage_percent"] < 0.02
    assert misaligned["flux_percent"] > 10 * nothing["flux_percent"]


@pytest.mark.slow
def test_gaps_split_a_segment_and_keep_its_time() -> None:
    case = quick(synrm_case("current_offset"), "gaps")
    found, drive = captured(case.rig)
    stages = [one.segment.stage for one in found]
    assert len({id(one.segment) for one in found}) < len(found)
    starts = [one.start_s for one in found]
    assert starts == sorted(starts)
    assert starts[-1] < drive.time_s
    assert set(stages) == {"resistance", "classical", "injection"}


@pytest.mark.slow
def test_a_wrong_answer_can_be_made_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--make", "single:7", "--seed", "7", "--out", str(tmp_path / "again")]) == 0
    assert "current_filter" not in capsys.readouterr().out
    assert "current_filter" in (tmp_path / "again.answer.txt").read_text()
    assert (tmp_path / "again" / "recording.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dead_time", "rotor_misalignment"])
def test_a_plain_effect_is_named_first(name: str) -> None:
    answer = examine(synrm_case(name))
    assert judge(answer).right["single: main effect named first"]
