"""Whether a model explains a recording from which a map was estimated: the check without which no map is usable."""

from orchestrator.screening.model_check import check_model

__all__ = ["check_model"]
