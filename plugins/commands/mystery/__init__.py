"""Motors with hidden effects nobody chose by hand, to practise the diagnosis on: `fluxbench mystery N`."""

from plugins.commands.mystery._drawing import Mystery, draw
from plugins.commands.mystery._guessing import Effects, Guess, GuessedSize, Verdict, judge, read_guess, sealed_effects

__all__ = ["Effects", "Guess", "GuessedSize", "Mystery", "Verdict", "draw", "judge", "read_guess", "sealed_effects"]
