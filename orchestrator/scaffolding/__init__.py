"""`fluxbench new`: a package with a plugin that already passes its conformance kit, to be changed into one's own."""

from orchestrator.scaffolding._package import KINDS, write_package

__all__ = ["KINDS", "write_package"]
