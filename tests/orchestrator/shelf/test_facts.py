"""What the index keeps of a run stands in the run's own files."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.estimation import load_flux_map, load_own_flux_map
from orchestrator.runs import RunDirectory
from orchestrator.shelf import RunFacts, cells, read_facts, relabel
from tests.orchestrator.shelf.example_runs import a_run, write_journal


def facts_of(folder: Path) -> RunFacts:
    return read_facts(folder, folder.name)


def test_a_run_s_facts_are_those_of_its_files(tmp_path: Path) -> None:
    about = {"serial": "PM-7", "tags": ["cold"], "notes": ["new brake"], "ambient_c": 21.0}
    facts = facts_of(a_run(tmp_path / "one", about=about))
    assert (facts.run, facts.motor, facts.drive, facts.outcome) == ("one", "400 W test PMSM", "simulated", "finished")
    assert (facts.serial, facts.tags, facts.notes, facts.ambient) == ("PM-7", "cold", "new brake", "21 °C")
    assert (facts.verdict, facts.causes, facts.map_error_percent) == ("explained", "dead time", 0.3)
    assert (facts.resistance_low_ohm, facts.resistance_ohm, facts.resistance_high_ohm) == (4.24, 4.25, 4.26)
    assert facts.l_dd_h == pytest.approx(0.043, rel=1e-3)
    assert facts.l_qq_h == pytest.approx(0.069, rel=1e-3)
    assert facts.rated_flux_wb == pytest.approx(0.142, rel=1e-2)
    assert facts.l_dd_low_h is not None
    assert facts.l_dd_low_h < 0.043
    assert facts.problem == facts.accepted == ""


def test_a_run_without_results_has_none(tmp_path: Path) -> None:
    facts = facts_of(a_run(tmp_path / "one", r_s=None, verdict=None, outcome=None))
    assert (facts.outcome, facts.verdict, facts.resistance_ohm, facts.usability) == ("not ended", "", None, "")
    assert cells(facts, ["resistance_ohm", "map_error_percent"]) == ("–", "–")


def test_numbers_are_printed_with_the_digits_that_their_intervals_support(tmp_path: Path) -> None:
    facts = facts_of(a_run(tmp_path / "one"))
    assert cells(facts, ["run", "resistance_ohm", "l_dd_h", "map_error_percent"]) == (
        "one",
        "4.250 Ω",
        "43.00 mH",
        "0.3 %",
    )


def test_limits_in_the_procedure_are_judged_once_the_run_has_finished(tmp_path: Path) -> None:
    accept = {"max_resistance_ohm": 4.3}
    assert facts_of(a_run(tmp_path / "good", accept=accept)).accepted == "pass"
    bad = facts_of(a_run(tmp_path / "bad", accept=accept, r_s=4.4))
    assert bad.accepted == "fail"
    assert bad.objections.startswith("R_s 4.400 Ω")
    assert facts_of(a_run(tmp_path / "faulted", accept=accept, outcome="faulted")).accepted == ""


def test_time_between_two_sessions_is_no_work(tmp_path: Path) -> None:
    folder = a_run(tmp_path / "one", outcome="aborted")
    write_journal(RunDirectory.open(folder), "finished")
    lines = (folder / "journal.jsonl").read_text().splitlines()
    times = ["10:00:00", "10:00:05", "12:00:00", "12:00:07"]
    changed = [
        f'{{"t":"2026-01-01T{t}.000+00:00"{line[line.index(",") :]}' for t, line in zip(times, lines, strict=True)
    ]
    (folder / "journal.jsonl").write_text("\n".join(changed) + "\n")
    assert facts_of(folder).duration_s == pytest.approx(12.0)


def test_labels_given_later_replace_those_of_the_start(tmp_path: Path) -> None:
    folder = a_run(tmp_path / "one", about={"tags": ["cold", "old"], "notes": ["first"]})
    relabel(folder, tags=["returned", "cold"], untag=["old"], notes=["second"])
    facts = facts_of(folder)
    assert (facts.tags, facts.notes) == ("cold, returned", "first; second")


@pytest.mark.parametrize(
    "file", ["results/estimates.json", "results/diagnosis.json", "results/flux_map.nc", "labels.json"]
)
def test_a_damaged_result_is_named_and_the_run_is_listed_all_the_same(tmp_path: Path, file: str) -> None:
    folder = a_run(tmp_path / "one")
    (folder / file).write_text("{")
    facts = facts_of(folder)
    assert facts.outcome == "finished"
    assert file in facts.problem


@pytest.mark.parametrize("file", ["run.json", "journal.jsonl"])
def test_a_run_without_a_readable_record_or_journal_is_only_named(tmp_path: Path, file: str) -> None:
    folder = a_run(tmp_path / "one")
    (folder / file).write_text("{\n{\n")
    facts = facts_of(folder)
    assert not facts.is_readable
    assert file in facts.problem


def test_a_map_is_read_quickly_as_it_is_read_thoroughly(tmp_path: Path) -> None:
    file = a_run(tmp_path / "one") / "results" / "flux_map.nc"
    quick, thorough = load_own_flux_map(file), load_flux_map(file)
    for name in type(quick).model_fields:
        assert repr(getattr(quick, name)) == repr(getattr(thorough, name))
