"""The page of runs: listed, compared, followed and labelled, whatever is in their folders."""

from __future__ import annotations

import json
from collections.abc import Iterator
from urllib.parse import urlencode

import pytest

from orchestrator.shelf import RunFacts, read_facts
from tests.orchestrator.shelf.example_runs import a_run
from tests.plugins.commands.serve.served import Served, serving

pytestmark = pytest.mark.timeout(150)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("bench")
    for k in range(3):
        a_run(
            folder / "runs" / f"line-{k}",
            r_s=4.2 + 0.1 * k,
            about={"serial": "PM-7"},
            accept={"max_resistance_ohm": 4.35},
        )
    a_run(folder / "runs" / "other", motor={"name": "<b>other</b>"}, about={"tags": ["cold"], "notes": ["a; b", "c"]})
    a_run(folder / "runs" / "nested" / "hidden")
    (folder / "runs" / "broken").mkdir()
    (folder / "runs" / "broken" / "run.json").write_text("{")
    with serving(folder) as served:
        yield served


def facts_of(served: Served, name: str) -> RunFacts:
    return read_facts(served.folder / "runs" / name, name)


def test_runs_are_listed_sorted_and_searched(served: Served) -> None:
    found = served.get("/listed?sort=-resistance_ohm").content
    assert [row["run"] for row in found["rows"]] == ["line-2", "line-1", "other", "line-0"]
    assert found["count"] == 4
    assert "broken/run.json" in found["unreadable"][0]
    first = found["rows"][0]
    assert (first["accepted"], first["resistance_ohm"], first["verdict"]) == ("fail", "4.400 Ω", "explained")
    assert first["objections"].startswith("R_s 4.400 Ω")
    assert [row["run"] for row in served.get("/listed?words=COLD+other").content["rows"]] == ["other"]
    assert served.get("/listed?skip=3").content["count"] == 4
    assert len(served.get("/listed?skip=3").content["rows"]) == 1


def test_a_motor_s_results_are_followed_over_its_runs(served: Served) -> None:
    query = urlencode({"motor": "400 W test PMSM", "serial": "PM-7"})
    trend = served.get(f"/trend?{query}").content
    assert [point["run"] for point in trend["points"]] == ["line-0", "line-1", "line-2"]
    value, low, high = trend["points"][0]["resistance_ohm"]
    assert (low, value, high) == (4.19, 4.2, 4.21)
    assert trend["points"][0]["rated_flux_wb"][0] == facts_of(served, "line-0").rated_flux_wb
    assert served.get(f"/trend?{urlencode({'motor': 'none'})}").content["points"] == []


def test_runs_are_compared_with_curves_and_what_changed_beyond_noise(served: Served) -> None:
    compared = served.get("/compared?runs=line-0&runs=line-2").content
    assert compared["names"] == ["line-0", "line-2"]
    assert "line-2: changed beyond noise: R_s" in compared["remarks"]
    runs, changes = compared["tables"]
    assert runs[0] == ["run", "motor", "measured", "map", "verdict"]
    assert changes[1][:2] == ["R_s", "changed"]
    assert [(curve["run"], curve["axis"]) for curve in compared["curves"]] == [(0, "d"), (0, "q"), (1, "d"), (1, "q")]
    assert all(len(curve["current_a"]) == len(curve["flux_wb"]) > 20 for curve in compared["curves"])


def test_a_comparison_of_a_run_without_results_is_one_line(served: Served) -> None:
    a_run(served.folder / "runs" / "empty", r_s=None, verdict=None)
    reply = served.get("/compared?runs=line-0&runs=empty")
    assert reply.status == 400
    assert "fluxbench estimate" in reply.content["problem"]


def test_labels_are_edited_one_by_one_and_kept_in_the_run_s_folder(served: Served) -> None:
    assert served.get("/labels?run=other").content == {"tags": ["cold"], "notes": ["a; b", "c"]}
    assert served.post("/label", {"run": "other", "tags": ["returned"], "notes": ["a; b", "<i>"]}).status == 200
    assert served.get("/labels?run=other").content == {"tags": ["returned"], "notes": ["a; b", "<i>"]}
    file = json.loads((served.folder / "runs" / "other" / "labels.json").read_text())
    assert file["tags"] == ["returned"]
    assert served.get("/listed?words=returned").content["count"] == 1
    for wrong in (
        {"run": "other", "tags": [""]},
        {"run": "other", "notes": ["a\0b"]},
        {"run": "broken", "tags": ["a"]},
    ):
        assert served.post("/label", wrong).status == 400
    assert served.get("/labels?run=other").content["tags"] == ["returned"]


def test_a_damaged_result_and_a_damaged_index_keep_no_run_from_the_list(served: Served) -> None:
    damaged = a_run(served.folder / "runs" / "damaged")
    (damaged / "results" / "flux_map.nc").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(200))
    (served.folder / "runs" / ".index.sqlite").write_bytes(b"damaged" * 1000)
    found = served.get("/listed?words=damaged").content
    assert [row["outcome"] for row in found["rows"]] == ["finished"]
    assert any("flux_map.nc" in problem for problem in found["unreadable"])


def test_the_first_page_lists_the_newest_runs_of_the_folder_itself(served: Served) -> None:
    listed = served.get("/choices").content
    names = {row["run"] for row in listed["runs"]}
    assert {"line-0", "other"} <= names
    assert not any("hidden" in name or name == "broken" for name in names)
    assert "broken/run.json" in listed["unreadable"][0]
