"""Every built-in effect keeps the contract of effects: one class of checks for each that is registered."""

from __future__ import annotations

from orchestrator.registry.plugins import PluginKind, installed, load_plugin
from orchestrator.testing import EffectConformance


def _kit(name: str) -> type[EffectConformance]:
    made = {"make_effect": lambda self: load_plugin(PluginKind.EFFECTS, name)()}
    return type(f"Test_{name}", (EffectConformance,), made)


for _info in installed(PluginKind.EFFECTS):
    if _info.module.startswith("plugins."):
        globals()[f"Test_{_info.name}"] = _kit(_info.name)


def test_none_is_left_out() -> None:
    assert sum(issubclass(kit, EffectConformance) for n, kit in globals().items() if n.startswith("Test_")) == 23
