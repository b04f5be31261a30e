"""Who decides: procedures, the state machine, runs, recordings and what is read out of them."""
