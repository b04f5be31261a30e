"""What a search's result is worth: the verdict and its reasons, intervals, the map's band, what is left."""
