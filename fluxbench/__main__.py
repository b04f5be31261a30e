"""`python -m fluxbench`: the command line."""

from orchestrator.interface.cli import main

if __name__ == "__main__":
    main()
