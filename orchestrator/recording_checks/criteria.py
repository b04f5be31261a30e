"""Thresholds of the recording checks, with their units and sources."""

from __future__ import annotations

from orchestrator.thresholds import threshold
from protocols import Strict


class ConventionCriteria(Strict):
    """When something is taken for a wrong convention of manifest or logger, and not for the motor's doing.

    An effect of the catalogue moves a gain by some percent and a delay by half a sample; conventions are off by a
    third, an axis or a whole sample. The limits lie between, nearer to the conventions: a false one costs more than
    one that is not found.
    """

    looked_at_samples: int = threshold(240_000, "1", "budget")
    """Of each kind of stage that are looked at."""
    looked_at_of_a_segment: int = threshold(20_000, "1", "budget")
    """Of one segment."""
    looked_at_segments: int = threshold(6, "1", "practice")
    """Of each kind of stage that are looked at in any case."""
    least_looked_at: int = threshold(100, "1", "practice")
    """Samples of a segment below which it says nothing of conventions."""
    alike: float = threshold(0.04, "1", "practice")
    """Error, relative to the vectors, within which readings are what a hypothesis makes of their set-points."""
    unlike: float = threshold(0.15, "1", "practice")
    """Error beyond which they are not what was asked for: no catalogued effect moves a controlled current so far."""
    lost: float = threshold(0.5, "1", "practice")
    """Part of the largest set-point by which the current misses its own where the drive has lost it."""
    at_its_limit: float = threshold(0.8, "1", "practice")
    """Part of the largest voltage of a bus, V_dc / sqrt 3, that a drive which has lost its current gives."""
    least_set_point: float = threshold(0.3, "1", "practice")
    """Part of the largest set-point below which one tells nothing: offsets are as large."""
    least_turns: float = threshold(0.9, "1", "theory")
    """Turns of an injected direction that show from where and which way it turns."""
    wrong_way: float = threshold(0.5, "1", "theory")
    """Part of the resistive voltage that goes the wrong way round where phases are exchanged; imbalance makes 0.1."""
    right_way: float = threshold(0.2, "1", "simulated")
    """Part that may be left of it where a hypothesis is right: dead time and imbalance."""
    right_angle_rad: float = threshold(0.25, "rad", "simulated")
    """Angle between voltage and current at rest that may be left where a hypothesis is right."""
    borne_out: float = threshold(0.33, "1", "practice")
    """Part of a scale, as a logarithm, that R_s has to be off the nameplate by to bear it out: less, and the set-points
    alone are in other units."""
    turned_rad: float = threshold(0.1, "rad", "practice")
    """Turn of set-points against readings that counts: the drive does not know of a misalignment, and makes none."""
    flat: float = threshold(0.02, "1", "theory")
    """Width of a line of readings, relative to its length, that one channel alone can draw."""
    silent: float = threshold(0.05, "1", "theory")
    """Share of a channel's steps that the voltage explains, below which it shows no motor's current."""
    speaking: float = threshold(0.3, "1", "theory")
    """The same of another channel beside it."""
    least_piled: float = threshold(0.002, "1", "practice")
    """Part of moving readings that stand at their very limit where they are clipped."""
    piled_up: float = threshold(0.2, "1", "theory")
    """Readings that stay at their limit, over all in the strip below it: the tail of any noise has next to none."""
    strip: float = threshold(0.02, "1", "practice")
    """Width of that strip, relative to the limit."""
    bus_spike: float = threshold(0.5, "1", "theory")
    """Step of single readings of the bus, relative to it, that its capacitors cannot make within a sample."""
    bridge_limit: float = threshold(0.45, "1", "theory")
    """Voltage, in bus voltages, from which on it may be the bridge that ends it: 1/2 to 2/3, as it is modulated."""
    edge: float = threshold(0.3, "1", "theory")
    """Step of a voltage, relative to the largest, that is one of an injected square's edges, or half of one."""
    still: float = threshold(0.02, "1", "practice")
    """And the step that it may have in between, where its direction turns."""
    irregular: float = threshold(0.01, "1", "practice")
    """Part of an injection's edges that come a row early or late where rows are lost or doubled."""
    few_early: int = threshold(3, "1", "practice")
    """Edges that come early where rows were lost here and there, none being late: where all rows are, there is none."""
    repeated: float = threshold(0.005, "1", "practice")
    """Part of rows under a ripple that repeat the row before, or lie in the very middle of their neighbours."""
    few_repeated: int = threshold(3, "1", "theory")
    """Rows that repeat the row before where the current must have moved, up to which they may be chance."""
    several_steps: float = threshold(4.0, "1", "theory")
    """Step of the current that the voltage makes, over the median size of what scatters in it (and over a converter's
    step), from which on a reading repeats by chance once in 65,000 rows: exp(-(4 x 1.18)^2 / 2)."""
    by_chance: float = threshold(3.0, "1", "practice")
    """How many times as many as chance makes, by the same count two rows apart."""
    many_repeated: float = threshold(0.3, "1", "simulated")
    """Part by which held currents may repeat more often than moving ones: more is a converter's dead band, not rows."""
    rate_off: float = threshold(1.8, "1", "practice")
    """Ratio of two time bases that is no clock's error."""
    same_rate: float = threshold(0.03, "1", "practice")
    """Relative difference of a time base to the factor that is named."""
    delay_lags: int = threshold(3, "1", "practice")
    """Samples before and after the declared delay at which the current's answer to the voltage is looked for."""
    uneven: float = threshold(3.0, "1", "practice")
    """How many times as uneven in i_q as in i_d iron is where the magnet lies across. Of 33 recordings of six plants
    with their axes right the most uneven one is a third as much so in i_q as in i_d."""
    least_uneven: float = threshold(0.04, "1", "practice")
    """Part of an inductance, rms and odd in i_q, from which on it is asked; those had 0.03 at most."""
    told_apart: float = threshold(1e3, "1", "theory")
    """Condition of the voltages at these lags up to which they are told apart; a square of ten samples has fifty."""
    no_answer: float = threshold(0.12, "1", "simulated")
    """Part of the whole answer to a step of voltage that is none."""
    answer: float = threshold(0.3, "1", "simulated")
    """Part of it that is one: half a sample's delay leaves a half in either."""
    part_of_a_sample: float = threshold(0.3, "sample", "practice")
    """Further off whole samples than this, a sine's phase is turned by something else, iron loss or a filter."""
    nameplate: float = threshold(0.2, "1", "practice")
    """Relative difference to the nameplate's R and L that tolerance, temperature and saturation make."""
    least_resistive: float = threshold(0.3, "1", "practice")
    """Part of the voltage at rest that R_s i has to make for R_s to be held against the nameplate's: where an
    inverter's loss is most of it, what is left is no R_s."""
    least_scale: float = threshold(1.35, "1", "practice")
    """Ratio to the nameplate, of R and L alike, from which on it is no tolerance's."""
    hot_winding: float = threshold(1.7, "1", "theory")
    """Ratio to the nameplate's R that 100 K of copper (0.39 %/K) and a tolerance of 20 % make."""
    saturated_iron: float = threshold(2.5, "1", "theory")
    """Ratio to the nameplate's L that iron makes which saturates by 60 %."""
