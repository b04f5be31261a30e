"""`fluxbench import --guess`: a mapping written from a measurement file alone, each line with its reason.

An ambiguous file is refused with one line. Each mapping has passed a trial import before it is returned.
"""

from orchestrator.importing.guessing._columns import columns_of
from orchestrator.importing.guessing._guessing import guess_mapping
from orchestrator.importing.guessing._map_names import MapRoles, map_unit, roles_of_map

__all__ = ["MapRoles", "columns_of", "guess_mapping", "map_unit", "roles_of_map"]
