"""How much the viewer's pictures show, and how finely: enough for a screen, little enough to be watched live."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Detail:
    """Measures of the viewer's pictures.

    Attributes
    ----------
    bin_s : float
        Of waveforms, stretches of this length keep their least and greatest value: several periods of a ripple.
    limits_every_s : float
        Limits are straight lines: two points a second are enough.
    block_rows, block_s : int, float
        Waveforms are handed on at so many rows of them, so long after the last ones, and when a point is done.
    ripple_periods : int
        Of the injection, drawn at each point.
    windows : int
        Of the residual, as many as are drawn in one picture.
    inner_part : float
        Part of the residuals that the scale of the first step holds.
    excerpts, loops : int
        Waveforms and flux loops that have a view of their own.
    map_pixels, surface_nodes : int
        Along each axis of an inductance's picture and of a flux surface.
    box_half_height : float
        Of the box that flux surfaces stand in; it is 2 wide.
    ladder_steps : int
        Of the error, shown before the cursor: as many as a diagnosis has and a few more.
    margin_s : float
        Of the time axes, after the latest sample.
    """

    bin_s: float = 0.02
    limits_every_s: float = 1.0
    block_rows: int = 1000
    block_s: float = 0.1
    ripple_periods: int = 4
    windows: int = 3000
    inner_part: float = 0.98
    excerpts: int = 4
    loops: int = 4
    map_pixels: int = 96
    surface_nodes: int = 61
    box_half_height: float = 0.7
    ladder_steps: int = 8
    margin_s: float = 1.0


DETAIL = Detail()
