"""Both systems' ways, here: Windows' modules are models."""

from __future__ import annotations

import select
import signal
import sys

import pytest

from tests.support.without_posix import msvcrt_model, winapi_model


@pytest.fixture(params=["posix", "windows"])
def system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The system that the room takes this one for."""
    if request.param == "windows":
        monkeypatch.setitem(sys.modules, "fcntl", None)
        monkeypatch.setitem(sys.modules, "msvcrt", msvcrt_model())
        monkeypatch.setitem(sys.modules, "_winapi", winapi_model())
        monkeypatch.delattr(signal, "setitimer")
        monkeypatch.delattr(select, "poll")
    return str(request.param)
