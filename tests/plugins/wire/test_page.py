"""The protocol's page: what docs/wire.md says is what the DBC and the register table say."""

from __future__ import annotations

from pathlib import Path

import pytest

from plugins.wire import AckStatus, Fault, Op, registers
from plugins.wire._command import command
from plugins.wire._dbc import dbc_text, layouts
from plugins.wire._page import page

PAGE = Path(__file__).parents[3] / "docs" / "wire.md"


def test_the_page_in_docs_is_the_generated_one() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "write it anew: fluxbench wire > docs/wire.md"


def test_every_message_signal_and_register_is_on_the_page() -> None:
    text = page()
    for name, layout in layouts().items():
        assert f"### {name}" in text
        assert all(f"| {signal.name} |" in text for signal in layout.signals if not signal.name.startswith("data_"))
    assert all(f"| {register.index} | {name} |" in text for name, register in registers().items())
    assert all(member.name.lower() in text for kind in (Op, AckStatus, Fault) for member in kind)


def test_the_command_prints_page_and_dbc(capsys: pytest.CaptureFixture[str]) -> None:
    assert command([]) == 0
    assert capsys.readouterr().out == page()
    assert command(["--dbc"]) == 0
    assert capsys.readouterr().out == dbc_text()
