"""`fluxbench new`: a package with a new plugin that passes its conformance kit from the start."""

from orchestrator.interface.scaffolding._package import KINDS, write_package

__all__ = ["KINDS", "write_package"]
