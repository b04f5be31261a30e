"""`fluxbench import --guess`: a mapping written from a measurement file alone, each line with its reason.

What cannot be told is refused with one line; what was written has been imported once before it is handed out.
"""

from orchestrator.importing.guessing._guessing import Guess, guess_mapping

__all__ = ["Guess", "guess_mapping"]
