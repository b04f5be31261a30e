"""Base of all kits: the entry point, and tolerances with an upper bound."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any, ClassVar

import pytest

from orchestrator.registry.plugins import PLUGIN_NAME
from orchestrator.testing._faults import judged


class Kit:
    """Base of the kits."""

    registered: ClassVar[bool] = True
    """False for a plugin that is not installed, such as an example within a test."""

    max_seconds: ClassVar[float] = 300.0
    """Time for one check."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name in (name for name in dir(cls) if name.startswith("test_")):
            check = getattr(cls, name)
            if getattr(check, "__module__", "").startswith(__package__) and not hasattr(check, "__wrapped__"):
                setattr(cls, name, judged(check))

    def require_entry_point(self, group: str, plugin: type) -> None:
        """Fail unless the plugin's class stands under its own name in this entry-point group."""
        name = str(getattr(plugin, "name", ""))
        assert PLUGIN_NAME.match(name), f"name is {name!r}; expected lower-case letters, digits and underscores"
        if not self.registered:
            pytest.skip("the kit's author declared that this plugin is not installed")
        entries = [entry for entry in entry_points(group=group) if entry.name == name]
        assert entries, (
            f"no entry point {name!r} in the group {group!r}: install the package (pip install -e .), or, for a file "
            "alone, set registered = False in the test class"
        )
        assert entries[0].load() is plugin, f"the entry point {name!r} leads to {entries[0].value}, not to {plugin!r}"


def bounded(name: str, value: float, largest: float) -> float:
    """The tolerance that a subclass has set, refused where it would make the check worthless."""
    assert 0.0 < value <= largest, f"{name} = {value} is no tolerance; it may be widened up to {largest}"
    return value
