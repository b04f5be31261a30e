"""Compiled code on disk belongs to the sources that it was made from."""

from __future__ import annotations

from plugins.drives.simulated._energy import current
from plugins.drives.simulated._numba import _fingerprint
from plugins.drives.simulated._run import run


def test_compiled_functions_are_kept_under_the_fingerprint_of_their_sources() -> None:
    assert len(_fingerprint()) == 12
    for function in (run, current):
        assert function.__qualname__.endswith(_fingerprint())
