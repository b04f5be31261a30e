"""The plugins of a run's stages, each loaded once before energising."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from orchestrator.registry.plugins import Installed, PluginKind
from protocols import Stage


class UsedPlugins:
    """Instances of the plugins that stages use.

    Parameters
    ----------
    stages : iterable of Stage

    Raises
    ------
    PluginError
        One of them is not installed, or broken.
    """

    def __init__(self, stages: Iterable[Stage]) -> None:
        self._loaded: dict[tuple[str, str], Any] = {}
        self.take(stages)

    def take(self, stages: Iterable[Stage]) -> None:
        """Load what these stages use as well; raises `PluginError`."""
        uses = [use for stage in stages for use in stage.uses()]
        for kind in {PluginKind(use.kind) for use in uses}:
            installed = Installed(kind)
            named = {use.name for use in uses if use.kind == kind}
            if None in named:
                named |= {info.name for info in installed.plugins}
            for name in named - {None} - {loaded for loaded_kind, loaded in self._loaded if loaded_kind == kind}:
                self._loaded[kind, str(name)] = installed.load(str(name))()

    def of(self, kind: str) -> list[Any]:
        """Plugins of a kind, sorted by name."""
        return [self._loaded[key] for key in sorted(self._loaded) if key[0] == kind]
