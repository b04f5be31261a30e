"""What the command line refuses, in one line that says why."""

from __future__ import annotations

from pathlib import Path

import pytest

from plugins.commands.emulator._command import command
from protocols import FluxbenchError


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "give either --serial PATH or --can"),
        (["--serial", "x", "--can", "virtual:0"], "give either"),
        (["--serial", "x", "--speed", "quick"], "expected a number from 0.01"),
        (["--serial", "x", "--set", "plant.resistence_ohm=5"], "did you mean 'resistance_ohm'"),
        (["--serial", "x", "--set", "plant.resistance_ohm=-5"], "greater than 0"),
        (["--serial", "x", "--set", "realtime_factor=1"], "use --speed"),
        (["--serial", "x", "--set", "watchdog_s=1"], "use --watchdog"),
        (["--can", "virtual"], "expected INTERFACE:CHANNEL"),
        (["--can", "nothing:0"], "cannot be opened"),
        (["--can", "serial:x", "--fd"], "classic only"),
        (["--can", "virtual:0", "--can-set", "port"], "expected key=value"),
        (["--serial", "x", "--motor", "nowhere.yaml"], "cannot be read"),
        (["--serial", "x", "--log", "/nowhere/log"], "cannot be written"),
    ],
)
def test_what_cannot_be_emulated_is_reported(
    words: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FluxbenchError, match=message):
        command(words)
    assert not list(tmp_path.iterdir())
