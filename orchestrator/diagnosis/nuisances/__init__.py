"""Nuisances of a measurement, which are modelled but not named as causes: rounding, ripple, scatter."""
