"""Input from outside: strict files, quantities with units, plausible numbers, errors in one line."""
