"""Procedures, the state machine, runs, recordings and their analysis."""
