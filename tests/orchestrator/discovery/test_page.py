"""What docs/discover.md shows: the written effect keeps the contract, and the commands have the options."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from pathlib import Path

from typer.testing import CliRunner

from orchestrator.discovery import places as at
from orchestrator.discovery import quantities as of
from orchestrator.discovery.bases import CurveBasis
from orchestrator.discovery.forms import CURVES, FormFit
from orchestrator.discovery.hypotheses import KINDS, A, Hypothesis
from orchestrator.discovery.law import Law
from orchestrator.discovery.laws import loaded
from orchestrator.discovery.writing import NamedLaw, source_of
from orchestrator.interface.cli._app import app
from orchestrator.testing import EffectConformance, exciting_signals
from protocols import Effect, Signals
from tests.orchestrator.testing.kit_runner import failures

PAGE = (Path(__file__).parents[3] / "docs" / "discover.md").read_text(encoding="utf-8")
EFFECT = re.findall(r"^```python\n(.*?)^```", PAGE, flags=re.DOTALL | re.MULTILINE)[0]


def test_the_effect_of_the_page_passes_the_kit(tmp_path: Path) -> None:
    class Kit(EffectConformance):
        def make_effect(self) -> Effect:
            return loaded(EFFECT)

        def signals(self) -> Signals:
            return replace(exciting_signals(), start_s=30.0)

    failed = failures(Kit(), tmp_path)
    failed.pop("test_entry_point_leads_to_the_effect", None)
    assert failed == {}


def test_the_effect_of_the_page_is_what_is_written_today() -> None:
    form = next(f for f in CURVES if f.name == "bump")
    hypothesis = Hypothesis(at.LEG_VOLTAGE, of.PHASE_CURRENT, A, CurveBasis(0.0, 4.5, 9, "odd", 0.1), 0.1)
    law = Law(hypothesis, FormFit(form, 0.8652, 0.4043, 1.0, 0.0))
    story = EFFECT.split('"""')[1].split("\n\n")[1:]
    paragraphs = [paragraph.replace("\n", " ").strip() for paragraph in story]
    text = source_of([NamedLaw(law, "poor_joint", paragraphs)], {}, False)
    assert EFFECT.split("\n", 1)[1].strip() == text.strip()


def test_the_commands_of_the_page_have_these_options() -> None:
    commands = [
        shlex.split(line.split("  ")[0]) for line in re.findall(r"^ {4}(fluxbench .*)$", PAGE, flags=re.MULTILINE)
    ]
    assert {words[1] for words in commands} == {"discover", "add", "diagnose"}
    for words in commands:
        text = CliRunner().invoke(app, [words[1], "--help"]).output
        assert [option for option in words if option.startswith("--") and option not in text] == []


def test_the_table_of_the_page_has_every_place() -> None:
    rows = PAGE.split("| place |")[1]
    assert [p.name for p, *_ in KINDS if p.name.replace("_", " ") not in rows] == []


def test_the_page_counts_the_forms() -> None:
    assert f"compared with {len(CURVES)} forms" in PAGE
