"""Judgement of a search's result: verdict and reasons, intervals, the map's band, the residual's pattern."""
