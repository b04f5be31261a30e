"""The report is one page that needs nothing beside it, and says what is missing instead of drawing it."""

from __future__ import annotations

import base64
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from markupsafe import Markup
from matplotlib import pyplot
from matplotlib.figure import Figure

from plugins.streams.report import ReportStream, _figures, write_report
from plugins.streams.report import _sensorless_content as sensorless
from plugins.streams.report._collect import collect
from plugins.streams.report._content import (
    checks,
    events,
    formulas,
    is_estimated,
    magnet_note,
    map_rows,
    remarks,
    why_no_check,
    why_no_map,
)
from plugins.streams.report._figures import (
    HELD_COLOURS,
    _colours_of,
    flux_figure,
    held_currents,
    inductance_figure,
)
from plugins.streams.report._page import _shown, _with_code, render
from protocols import (
    AxisPercent,
    Basis,
    ClosedForm,
    Coefficient,
    DeliveredModel,
    MapChecks,
    MapReport,
    Motor,
    NoOptions,
    RecordingError,
    Remark,
    RunEnded,
    SeenByInjection,
    SegmentStage,
    StorageError,
    StreamSetup,
)
from tests.orchestrator.tuning.test_words import a_report as a_tuning
from tests.plugins.streams.example_run import a_map, a_report, a_run_directory
from tests.plugins.streams.report.example_diagnosis import some_steps
from tests.support.cases import few

HOSTILE = "<script>alert(1)</script>\"><img src=x onerror=alert(2)> & 'motor' {{ 7*7 }}"
VOID = {"meta", "img", "br", "hr", "link"}
PICTURES = 12


class Page(HTMLParser):
    """Reads a page, and fails where tags do not nest."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        assert len(dict(attrs)) == len(attrs), f"an attribute of {tag} is given twice"
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open[-1] == tag, f"</{tag}> closes {self.open[-1]}"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.words.append(data.strip())

    @property
    def text(self) -> str:
        return " ".join(filter(None, self.words))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run with its report; not to be changed."""
    run = a_run_directory(tmp_path_factory.mktemp("report") / "pm400-example")
    write_report(run)
    return run


@pytest.fixture
def run(undrawn: None, finished: Path, tmp_path: Path) -> Path:
    """A copy of the finished run without its report."""
    copy = tmp_path / finished.name
    shutil.copytree(finished, copy)
    (copy / "report.html").unlink()
    return copy


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of texts beside pictures: figures are not even made."""
    for name in [name for name in vars(_figures) if name.endswith("_figure") and name != "new_figure"]:
        monkeypatch.setattr(_figures, name, lambda *_: "data:image/svg+xml;base64,")


def page_of(run: Path) -> Page:
    return Page(write_report(run).read_text(encoding="utf-8"))


def test_page_is_well_formed_and_complete(finished: Path) -> None:
    page = Page((finished / "report.html").read_text(encoding="utf-8"))
    assert len(page.all("img")) == PICTURES
    for wanted in (
        "400 W test PMSM",
        "4.470 Ω (95 %: 4.455 to 4.485)",
        "d 0.42 % q 1.2 %",
        "the paper’s: 1.3 % on d, 2.9 % on q",
        "the loop is open by 1.1 mWb",
        "locked: moved 0.0004 rad",
        "finished: every stage is done",
        "the bus sagged by 2 %",
        "SHA-256",
        "results/flux_map.nc",
    ):
        assert wanted in page.text, wanted


def test_page_refers_to_nothing_outside_itself(finished: Path) -> None:
    text = (finished / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert all(str(image["src"]).startswith("data:image/svg+xml;base64,") for image in page.all("img"))
    for tag in ("script", "link", "iframe", "object", "embed", "base", "form"):
        assert not page.all(tag), f"the page holds <{tag}>"
    assert all(str(link["href"]).startswith("#") for link in page.all("a"))
    without_pictures = re.sub(r'src="data:[^"]*"', "", text)
    assert not re.search(r"https?:|//|url\(|@import|javascript:", without_pictures)
    policy = next(meta for meta in page.all("meta") if meta.get("http-equiv"))
    assert str(policy["content"]).startswith("default-src 'none'")


def test_page_is_small_and_fits_a_phone(finished: Path) -> None:
    report = finished / "report.html"
    assert report.stat().st_size < 3_000_000
    page = Page(report.read_text(encoding="utf-8"))
    assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in page.all("meta")
    assert sum(div.get("class") == "wide" for div in page.all("div")) == len(page.all("table"))


def test_every_picture_has_words_for_those_who_cannot_see_it(finished: Path) -> None:
    page = Page((finished / "report.html").read_text(encoding="utf-8"))
    assert all(image.get("alt") for image in page.all("img"))


@pytest.mark.usefixtures("without_figures")
def test_hostile_names_stay_text(tmp_path: Path) -> None:
    page = page_of(a_run_directory(tmp_path / "run", motor=HOSTILE))
    assert not page.all("script")
    assert len(page.all("img")) == PICTURES
    assert HOSTILE in page.text
    assert not [tag for tag, attributes in page.tags if any(name.startswith("on") for name in attributes)]


@pytest.mark.slow
@pytest.mark.usefixtures("without_figures")
def test_report_goes_where_it_is_requested_to(run: Path, tmp_path: Path) -> None:
    before = sorted(p.relative_to(run) for p in run.rglob("*"))
    assert write_report(run, tmp_path / "elsewhere.html") == tmp_path / "elsewhere.html"
    assert sorted(p.relative_to(run) for p in run.rglob("*")) == before


@pytest.mark.usefixtures("without_figures")
def test_stream_writes_the_report_at_the_end(run: Path) -> None:
    stream = ReportStream(StreamSetup(run=run, options=NoOptions()))
    assert not (run / "report.html").exists()
    stream.close()
    assert Page((run / "report.html").read_text(encoding="utf-8")).text


def test_stream_writes_nothing_where_there_is_nothing(tmp_path: Path) -> None:
    ReportStream(StreamSetup(run=tmp_path, options=NoOptions())).close()
    assert not list(tmp_path.iterdir())


def test_a_directory_that_is_no_run_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"neither run\.json nor recording\.json"):
        write_report(tmp_path)


@pytest.mark.usefixtures("without_figures")
def test_a_file_that_cannot_be_written_is_reported(run: Path, tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="report"):
        write_report(run, tmp_path / "no" / "such" / "folder" / "report.html")


def test_a_run_without_results_says_so_and_draws_what_was_measured(run: Path) -> None:
    shutil.rmtree(run / "results")
    page = page_of(run)
    assert len(page.all("img")) == 2  # the paths, and R_s from the journal
    assert f"Flux map not estimated yet: fluxbench estimate {run.name}" in page.text
    assert page.text.count(f"Not drawn: not estimated yet: fluxbench estimate {run.name}") == 1
    assert f"No flux map: not estimated yet: fluxbench estimate {run.name}" in page.text
    assert "not measured" not in page.text.lower()
    assert f"fluxbench report {run.name} draws where it fails" in page.text


@pytest.mark.usefixtures("without_figures")
def test_a_recording_without_run_or_journal_is_reported(run: Path) -> None:
    for name in ("run.json", "journal.jsonl"):
        (run / name).unlink()
    page = page_of(run)
    assert "a recording that was not made by a run" in page.text
    assert "No journal" in page.text
    assert "there are no single readings over time" in page.text
    assert "69 injection points and 8 classical trajectories" in page.text


@pytest.mark.slow
def test_one_method_alone_is_drawn_alone(run: Path) -> None:
    (run / "results" / "flux_map_classical.nc").unlink()
    page = page_of(run)
    assert "By injection alone." in page.text
    assert "Not drawn: it needs the maps by both methods; there is none by sweeps." in page.text


@pytest.mark.usefixtures("without_figures")
@few(
    "name, content, message",
    [
        ("results/estimates.json", b"{", "estimates.json"),
        ("results/estimates.json", b'{"usable": 1}', "estimates.json"),
        ("results/flux_map.nc", b"no NetCDF", "flux_map.nc"),
        ("run.json", b"[]", "run.json"),
        ("recording.json", b"\xff", "recording.json"),
        ("journal.jsonl", b"nonsense\n" * 2, "journal.jsonl"),
    ],
    fast=2,
)
def test_a_damaged_file_is_named_and_the_rest_reported(run: Path, name: str, content: bytes, message: str) -> None:
    (run / name).write_bytes(content)
    page = page_of(run)
    material = collect(run)
    assert len(material.problems) == 1
    assert message in material.problems[0]
    assert material.problems[0] in page.text


@pytest.mark.slow
def test_a_lost_capture_costs_the_picture_of_the_paths_only(run: Path) -> None:
    (run / "captures" / "classical-003.parquet").unlink()
    page = page_of(run)
    assert "classical-003.parquet" in page.text
    assert len(page.all("img")) >= PICTURES - 1


@pytest.mark.slow
@pytest.mark.usefixtures("without_figures")
def test_a_run_that_was_killed_is_reported_as_not_ended(tmp_path: Path) -> None:
    page = page_of(a_run_directory(tmp_path / "run", ended=False))
    assert "not ended: interrupted from outside, or still under way" in page.text


def test_an_event_that_the_journal_has_twice_on_end_is_one_row(finished: Path) -> None:
    material = collect(finished, reads_paths=False)
    ended = next(entry for entry in material.journal if isinstance(entry.message, RunEnded))
    (event,) = events(replace(material, journal=(ended, ended)))
    assert (event.kind, event.text) == ("finished", "every stage is done")


def test_unmeasured_checks_are_stated_not_to_be_measured(run: Path) -> None:
    file = run / "results" / "estimates.json"
    file.write_text(re.sub(r'"parity": \{[^}]*\}', '"parity": null', file.read_text()), encoding="utf-8")
    material = collect(run)
    parity = next(c for c in checks(material) if c.name == "Parity")
    assert [bar.text for bar in parity.bars] == ["no figure", "no figure"]
    assert parity.limit == "this recording’s maps do not allow it"


def test_checks_that_no_estimator_made_name_the_command_that_makes_them(run: Path) -> None:
    material = collect(run, reads_paths=False)
    assert material.estimates is not None
    assert material.estimates.resistance is not None
    alone = {
        "model": DeliveredModel(title="saturated", segments="", resistance=material.estimates.resistance),
        "estimators": None,
        "crossings": None,
    }
    lacking = replace(material, estimates=material.estimates.model_copy(update=alone))
    crossings = next(check for check in checks(lacking) if check.name == "Crossings")
    assert crossings.limit == f"`fluxbench estimate {run.name}` computes it from this recording"


def test_where_no_check_has_a_figure_one_sentence_says_why(run: Path) -> None:
    material = collect(run, reads_paths=False)
    assert why_no_check(material) == ""
    estimates = material.estimates
    assert estimates is not None
    nothing = {"crossings": None, "classical_against_injection_percent": None, "recommended": None}
    without: dict[str, object] = {"parity": None, "reciprocity_percent": None, "maps": {}, "method": None}
    model = DeliveredModel(title="saturated", segments="", resistance=estimates.resistance)
    bare = estimates.model_copy(update={**nothing, **without, "model": model, "estimators": None})
    reason = why_no_check(replace(material, estimates=bare))
    assert reason == f"`fluxbench estimate {run.name}` computes it from this recording"


def test_a_check_that_lacks_a_stage_names_it(run: Path) -> None:
    material = collect(run, reads_paths=False)
    assert material.estimates is not None
    assert material.manifest is not None
    held = [s for s in material.manifest.segments if s.stage is not SegmentStage.CLASSICAL]
    lacking = replace(
        material,
        manifest=material.manifest.model_copy(update={"segments": tuple(held)}),
        estimates=material.estimates.model_copy(update={"crossings": None}),
    )
    crossings = next(check for check in checks(lacking) if check.name == "Crossings")
    assert crossings.limit == "needs a stage classical in the procedure: this recording has none"


def test_remarks_on_maps_that_are_not_recommended_are_folded(run: Path) -> None:
    material = collect(run, reads_paths=False)
    report = material.estimates
    assert report is not None
    other = next(name for name in report.maps if name != report.method)
    findings = (Remark(code=f"{report.method}.noisy", text="noisy"), Remark(code=f"{other}.coarse", text="coarse"))
    usable = replace(material, estimates=report.model_copy(update={"remarks": findings, "usable": True}))
    assert (remarks(usable).main, remarks(usable).others) == (["noisy"], ["coarse"])
    page = render(usable, draws=False)
    assert "Remarks on the maps that are not recommended (1)" in page
    objected = replace(material, estimates=report.model_copy(update={"remarks": findings, "usable": False}))
    assert (remarks(objected).main, remarks(objected).others) == (["noisy", "coarse"], [])


def test_commands_of_a_text_are_set_as_code_and_nothing_else_of_it_is_obeyed() -> None:
    assert _with_code("run `fluxbench <x>` & go") == "run <code>fluxbench &lt;x&gt;</code> &amp; go"
    assert _with_code("a ` alone <b>") == "a ` alone &lt;b&gt;"


def test_a_figure_beyond_its_limit_is_marked(run: Path) -> None:
    material = collect(run, reads_paths=False)
    assert material.estimates is not None
    wide = material.estimates.model_copy(update={"crossings": AxisPercent(d_percent=6.0, q_percent=0.1)})
    crossings = next(check for check in checks(replace(material, estimates=wide)) if check.name == "Crossings")
    assert [bar.is_beyond for bar in crossings.bars] == [True, False]
    assert crossings.limit.startswith("tick: the limit, 5 %; the paper’s: 1.3 % on d")


def test_a_run_that_was_stopped_is_reported_without_waiting_for_pictures(run: Path) -> None:
    stream = ReportStream(StreamSetup(run=run, options=NoOptions()))
    stream.receive(RunEnded(outcome="aborted", reason="signal SIGINT", run=str(run)))
    stream.close()
    page = Page((run / "report.html").read_text(encoding="utf-8"))
    assert page.all("img") == []
    assert any(f"fluxbench report {run}" in word for word in page.words)


@pytest.mark.slow
def test_a_motor_without_saturation_is_drawn() -> None:
    found = a_map("injection")
    flat = found.model_copy(update={"l_dd": np.full_like(found.l_dd, 0.043), "l_dq": np.zeros_like(found.l_dq)})
    assert inductance_figure(flat, "l_dd").startswith("data:image/svg+xml")
    assert inductance_figure(flat, "l_dq").startswith("data:image/svg+xml")


def test_a_map_of_a_single_line_is_drawn() -> None:
    found = a_map("injection")
    line = {"i_q": found.i_q[6:7]} | {
        name: getattr(found, name)[:, 6:7]
        for key in ("psi_d", "psi_q", "l_dd", "l_dq", "l_qq")
        for name in (key, f"{key}_std")
    }
    thin = found.model_copy(update=line)
    assert inductance_figure(thin, "l_dd").startswith("data:image/svg+xml")
    assert flux_figure({"injection": thin}, "d").startswith("data:image/svg+xml")


def test_tables_give_as_many_digits_as_the_uncertainty_bears() -> None:
    rows = map_rows(a_map("injection"), None)
    assert ["0.00", "0.00", "300.0 ± 0.8", "0.0 ± 0.8", "43.0 ± 0.8", "0.0 ± 0.8", "69.0 ± 0.8"] in rows
    assert ["−3.00", "−3.00", *["not measured"] * 5] in rows


def test_the_flux_at_zero_current_is_the_nameplate_s_and_has_no_interval() -> None:
    motor = Motor(name="m", pole_pairs=2, pm_flux_wb=0.3)
    rows = map_rows(a_map("injection"), motor)
    assert ["0.00", "0.00", "300 (nameplate)", "0.0 ± 0.8", "43.0 ± 0.8", "0.0 ± 0.8", "69.0 ± 0.8"] in rows
    assert "not measured: a locked rotor does not show it" in magnet_note(motor)
    assert "no magnet flux was given" in magnet_note(motor.model_copy(update={"pm_flux_wb": None}))


def test_one_colour_means_one_held_current_in_both_pictures() -> None:
    maps = [a_map("injection")]
    assert held_currents(maps, "d") == held_currents(maps, "q") == (-3.0, -1.5, 0.0, 1.5, 3.0)
    assert _colours_of((-3.0, -1.5, 0.0, 1.5, 3.0)) == list(HELD_COLOURS)
    reached = np.array([-2.9, -2.9, -1.45, 0.001, 1.45, 2.9])
    assert held_currents(maps, "d", reached) == (-2.9, -1.45, 0.0, 1.45, 2.9)
    assert held_currents(maps, "d", np.array([-0.01, 0.02])) == (-3.0, -1.5, 0.0, 1.5, 3.0)  # noise about zero
    assert _colours_of((-3.0, 0.0, 3.0)) == [HELD_COLOURS[0], HELD_COLOURS[2], HELD_COLOURS[4]]


def test_the_legend_of_held_currents_has_the_line_of_the_first_map(monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr(_figures, "uri", figures.append)
    for basis, line in ((Basis.ENERGY, ":"), (Basis.INJECTION, "-")):
        flux_figure({"map": a_map("map").model_copy(update={"basis": basis})}, "d", np.array([-2.9, -1.45, 1.45, 2.9]))
        legend = figures[-1].axes[0].get_legend()
        assert legend is not None
        assert [handle.get_linestyle() for handle in legend.get_lines()] == [line] * 5
        assert [text.get_text() for text in legend.get_texts()] == ["−2.9 A", "−1.45 A", "0 A", "+1.45 A", "+2.9 A"]


def test_the_legend_of_several_maps_names_each_line(monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr(_figures, "uri", figures.append)
    bases = {
        "model": Basis.ENERGY,
        "injection": Basis.INJECTION,
        "energy": Basis.ENERGY,
        "classical": Basis.INTEGRATION,
    }
    maps = {name: a_map("map").model_copy(update={"basis": basis}) for name, basis in bases.items()}
    flux_figure(maps, "d", np.array([-2.9, -1.45, 1.45, 2.9]))
    (legend,) = figures[-1].legends
    assert [handle.get_linestyle() for handle in legend.get_lines()] == [":", "-", "--"]
    assert [text.get_text() for text in legend.get_texts()] == ["model, energy", "injection", "classical"]
    held = figures[-1].axes[0].get_legend()
    assert held is not None
    assert [handle.get_linestyle() for handle in held.get_lines()] == ["-"] * 5


@pytest.mark.usefixtures("without_figures")
def test_the_caption_says_how_far_the_ripple_reaches_beyond_the_currents_that_were_held(finished: Path) -> None:
    material = collect(finished)
    means = 0.8 * material.paths.injection
    page = render(replace(material, paths=replace(material.paths, injection=means)))
    assert re.search(r"i_d was held at up to 2\.\d A; with the ripple it reached 3 A\.", page)
    assert "with the ripple" not in render(material)


def test_pictures_are_svg_and_leave_no_figure_behind(finished: Path) -> None:
    page = Page((finished / "report.html").read_text(encoding="utf-8"))
    for image in page.all("img"):
        svg = base64.b64decode(str(image["src"]).split(",", 1)[1])
        assert svg.rstrip().endswith(b"</svg>")
    assert pyplot.get_fignums() == []


POLYNOMIAL = ClosedForm(
    formula="H = x^2/2L_d + y^2/2L_q + sum of alpha_mn x^m y^n, x = psi_d - psi_M, i = grad H",
    coefficients=(
        Coefficient(name="L_d", value=0.0432, std=0.0001, unit="H"),
        Coefficient(name="alpha30", value=-12.5, std=0.31, unit="A/Wb^2"),
    ),
)


def estimated(run: Path, **changes: object) -> Path:
    """The run with other estimates."""
    report = collect(run).estimates
    assert report is not None
    file = run / "results" / "estimates.json"
    file.write_text(report.model_copy(update=changes).model_dump_json(), encoding="utf-8")
    return run


@pytest.mark.slow
def test_the_polynomials_coefficients_are_a_table_and_no_wall_of_words(run: Path) -> None:
    made = {"polynomial": MapReport(checks=MapChecks(), form=POLYNOMIAL)}
    flux_error = (Remark(code="energy.flux_error", text="energy: known to +-0.1 %"),)
    material = collect(estimated(run, maps=made, remarks=flux_error))
    (formula,) = formulas(material)
    assert formula.rows == (("L_d", "43.20 mH", "0.10 mH"), ("α30", "−12.5 A/Wb²", "0.3 A/Wb²"))
    assert "sum of α_mn x^m y^n, x = ψ_d - ψ_M" in formula.text
    assert remarks(material).main == ["energy: known to ±0.1 %"]
    page = render(material, draws=False)
    assert "By polynomial" in page
    assert "−12.5" in page


SEEN = SeenByInjection(
    method="energy",
    frequency_hz=500.0,
    amplitude_v=40.0,
    points=25,
    l_dd_percent=-2.1,
    l_qq_percent=-4.25,
    saliency_low=1.2,
    saliency_high=2.1,
    map_saliency_low=1.25,
    map_saliency_high=2.15,
    angle_error_rad=0.2,
    left_by_map_rad=0.01,
)


@pytest.mark.slow
def test_what_sensorless_control_sees_is_a_section_with_what_it_means(run: Path) -> None:
    assert "For sensorless control" not in render(collect(run), draws=False)
    page = render(collect(estimated(run, seen_by_injection=(SEEN,))), draws=False)
    assert "For sensorless control" in page
    assert "up to 4.2 % off the slopes of the large-signal map by energy" in page
    assert "by up to 11.5°" in page
    assert "<td>−2.10 %</td><td>−4.25 %</td><td>1.20 to 2.10</td>" in page.replace("\n", "")
    alike = SEEN.model_copy(update={"l_dd_percent": 0.3, "l_qq_percent": -0.4})
    assert "one map serves both" in render(collect(estimated(run, seen_by_injection=(alike,))), draws=False)


def test_a_turn_beyond_the_rated_current_is_stated_within_it_too(finished: Path) -> None:
    material = collect(finished, reads_paths=False)
    at = {"method": "injection", "angle_error_i_d_a": 0.0, "angle_error_i_q_a": -9.0}
    seen = SEEN.model_copy(update=at)
    rated = sensorless._within_rated(material, seen)
    assert re.fullmatch(r", beyond the rated current of 2\.35 A, and by up to \d+\.\d° within it", rated)
    assert sensorless._within_rated(material, seen.model_copy(update={"angle_error_i_q_a": 2.0})) == ""


def test_results_of_a_model_alone_are_no_estimates(finished: Path) -> None:
    material = collect(finished, reads_paths=False)
    assert material.estimates is not None
    assert is_estimated(material)
    model = DeliveredModel(title="saturated + phase drop", segments="", resistance=material.estimates.resistance)
    alone = replace(material, estimates=material.estimates.model_copy(update={"model": model, "estimators": None}))
    assert why_no_map(alone).startswith("not estimated yet: `fluxbench estimate")
    assert why_no_map(material) == "no estimator could make one; their remarks say why"


@pytest.mark.usefixtures("without_figures")
def test_before_a_diagnosis_the_page_may_show_where_the_bare_model_fails(finished: Path) -> None:
    material = replace(collect(finished, reads_paths=False), diagnosis=None)
    assert "Where the model fails" not in render(material, draws=False)
    page = Page(render(replace(material, bare=some_steps()[0]), draws=False))
    bare, present = some_steps()
    added = Page(render(replace(material, bare=bare, present=present, modelled=("dead_time",)), draws=False)).text
    assert "Before: R_s and a saturated map alone" in added
    assert "After: model.json as it is now, with dead time: error 4.1 mV rms" in added
    assert "Where the model fails R_s and a saturated map alone, without any effect: error " in page.text
    assert "Residual against each phase's own current" in page.text
    assert (
        "voltage_bias The inverter keeps a constant voltage back from the commanded one. Residual against each"
        in page.text
    )
    assert "draws where it fails" not in page.text


def test_of_two_figures_for_one_error_the_page_says_why_they_differ(finished: Path) -> None:
    estimates = a_report().model_copy(update={"seen_by_injection": (SEEN,)})
    material = replace(collect(finished, reads_paths=False), estimates=estimates)
    assert "section on the drive" not in sensorless.note(material)
    beside = sensorless.note(replace(material, tuning=a_tuning(current_limit_a=2.35, injection_error_deg=23.5)))
    assert "other figures (23.5°, 0.295° corrected by the map)" in beside
    assert "at its references of least current (MTPA) up to 2.35 A" in beside


@pytest.mark.slow
def test_what_an_energy_has_by_construction_is_not_shown_as_a_check(run: Path) -> None:
    energy = {"energy": MapReport(basis=Basis.ENERGY, checks=MapChecks())}
    given = {"method": "energy", "parity": None, "reciprocity_percent": None}
    shown = {check.name: check for check in checks(collect(estimated(run, **given, maps=energy | a_report().maps)))}
    assert "Of the map by injection" in shown["Parity"].meaning
    assert [bar.text for bar in shown["Parity"].bars] == ["0.31 %", "0.88 %"]
    assert [bar.text for bar in shown["Reciprocity"].bars] == ["0.66 %"]
    alone = checks(collect(estimated(run, **given, maps=energy)))
    assert any("an energy, obeys it exactly" in check.meaning for check in alone)


def test_nothing_in_the_page_is_obeyed_rather_than_shown() -> None:
    assert _shown("\x1b[2J\u202egnp.\n\x9b") == "\\u001b[2J\\u202egnp.\n\\u009b"
    assert len(str(_shown("x" * 10_000_000))) < 5000
    assert _shown(Markup("<svg>\u202e</svg>")) == Markup("<svg>\u202e</svg>")
