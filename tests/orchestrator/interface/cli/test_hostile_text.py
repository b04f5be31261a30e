"""Whatever a file holds, and whatever is typed: no character of it is obeyed by the terminal."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from orchestrator.formatting.sentences import MAX_LINE_LENGTH, visible
from orchestrator.runs import Journal
from plugins.commands.mystery._command import _print_verdict
from plugins.commands.mystery._guessing import Verdict
from plugins.commands.probe._command import command as probe
from plugins.streams.report._diagnosis_figures import joint_figure
from protocols import JointEntry, Note
from tests.plugins.link.device import Script, on_a_pty
from tests.support.cases import few
from tests.support.processes import called
from tests.support.tiny import tiny_document

HOSTILE = "\x1b]0;owned\x07\x9b2J\u202egnp.\r\t\x00\u2066"
WORDS = st.text(st.characters(codec="utf-8"), min_size=1, max_size=20)


def assert_plain(text: str) -> None:
    assert [char for char in text if visible(char) != char] == []
    assert max(map(len, text.split("\n"))) < 2 * MAX_LINE_LENGTH


def tell_all(folder: Path, text: str) -> None:
    """Put a text into every place where a command would print it."""
    document = tiny_document()
    document["name"] = document["motor"]["name"] = text
    procedure = folder / "p.yaml"
    procedure.write_text(json.dumps(document), encoding="utf-8")
    unknown = folder / "u.yaml"
    unknown.write_text(json.dumps({**document, text: 1}), encoding="utf-8")
    manifest = folder / "recording.json"
    manifest.write_text(json.dumps({"format": "fluxbench-recording", "version": 1, text: text}), encoding="utf-8")
    for words in (
        ("check", procedure),
        ("check", procedure, "--json"),
        ("check", unknown),
        ("check", procedure, "--set", f"{text}=1"),
        ("check", procedure, "--drive", text),
        ("estimate", folder),
        (text,),
    ):
        done = called(*words)
        assert_plain(done.stdout)
        assert_plain(done.stderr)


@settings(max_examples=4, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=WORDS)
@example(text=HOSTILE)
def test_no_text_from_outside_is_obeyed_by_the_terminal(tmp_path: Path, text: str) -> None:
    tell_all(tmp_path, text)


def test_what_a_journal_holds_is_obeyed_by_no_terminal_and_comes_back_as_it_was(tmp_path: Path) -> None:
    text = f"\x7f{HOSTILE}\n\u2028"
    journal = Journal(tmp_path / "journal.jsonl")
    with journal:
        journal.append(Note(level="info", text=text))
    assert_plain(journal.path.read_text(encoding="utf-8"))
    (record,) = journal.read()
    assert isinstance(record.message, Note)
    assert record.message.text == text


@pytest.mark.parametrize("name", [HOSTILE, r"$\frac{$", "x" * 100_000, "a\nb"])
def test_a_name_in_a_picture_is_plain_text(name: str) -> None:
    drawn = joint_figure([JointEntry(name=name, relative_size=1.0, z=9.0)], {})
    picture = base64.b64decode(drawn.partition("base64,")[2]).decode()
    assert [char for char in picture if visible(char) != char] == []
    assert len(picture) < 100_000


def test_a_drive_says_what_it_likes_and_a_probe_prints_none_of_it_raw(capsys: pytest.CaptureFixture[str]) -> None:
    lines = HOSTILE.replace("\r", "") + "\x7f"
    for words in ([], ["--json"]):
        with on_a_pty(Script(described=f"\nmotor: {lines}\nfirmware: {lines}")) as (_, port):
            assert probe(["--serial", port, *words]) == 0
        assert_plain(capsys.readouterr().out)


def test_a_guess_is_judged_in_plain_text(capsys: pytest.CaptureFixture[str]) -> None:
    wrong = ("x" * 10_000_000, HOSTILE)
    _print_verdict(Verdict(as_good=(), right=(HOSTILE,), caused=(), wrong=wrong, still_hidden=1, sizes=()))
    assert_plain(capsys.readouterr().out)


@pytest.mark.slow
@few("text", ["x" * 2_000_000, HOSTILE * 10_000], ids=["long", "hostile"])
def test_texts_of_megabytes_are_cut(tmp_path: Path, text: str) -> None:
    document = tiny_document()
    path = tmp_path / "p.yaml"
    path.write_text(json.dumps({**document, "name": text, text: 1}), encoding="utf-8")
    done = called("check", path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert_plain(done.stderr)
