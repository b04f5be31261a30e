"""Every built-in effect keeps the contract of effects: one class of checks for each that is registered."""

from __future__ import annotations

import functools
from collections.abc import Callable

import pytest

from orchestrator.registry.plugins import PluginKind, installed, load_plugin
from orchestrator.testing import EffectConformance

READ_ONLY = ("test_input_is_not_modified", "test_a_batch_is_not_modified")
"""Every kernel is compiled anew for arrays that cannot be written to. `test_batches` guards ordinary ones."""


def _slow(check: str) -> Callable[[EffectConformance], None]:
    inherited: Callable[[EffectConformance], None] = getattr(EffectConformance, check)

    @functools.wraps(inherited)
    def test(self: EffectConformance) -> None:
        inherited(self)

    marked: Callable[[EffectConformance], None] = pytest.mark.slow(test)
    return marked


def _kit(name: str) -> type[EffectConformance]:
    members: dict[str, object] = {check: _slow(check) for check in READ_ONLY}
    members["make_effect"] = lambda self: load_plugin(PluginKind.EFFECTS, name)()
    return type(f"Test_{name}", (EffectConformance,), members)


for _info in installed(PluginKind.EFFECTS):
    if _info.module.startswith("plugins."):
        globals()[f"Test_{_info.name}"] = _kit(_info.name)


def test_none_is_left_out() -> None:
    assert sum(issubclass(kit, EffectConformance) for n, kit in globals().items() if n.startswith("Test_")) == 24
