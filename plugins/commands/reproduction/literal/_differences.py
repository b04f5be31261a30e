"""Everything in which the paper, its literal reproduction and fluxbench differ, as rows of a table."""

DIFFERENCES = (
    (
        "motor",
        "a 400 W motor on a bench",
        "a simulated one of the same nameplate that saturates as such motors do; its fluxes are its own",
        "any",
    ),
    (
        "amplitudes",
        "not given; torque without 3/2 goes with power-invariant vectors",
        "printed amperes and volts are peak values",
        "amplitude-invariant vectors, torque with 3/2",
    ),
    (
        "alignment",
        "frames made to coincide by a d current, then the brake",
        "the run's; exact in the single benches",
        "as the paper",
    ),
    (
        "trapezoids",
        "2 s, 3 A; the shape is in a figure",
        "0.25 s up, 0.5 s rest, 0.5 s down, 0.5 s rest, 0.25 s up",
        "the same, scaled to the motor",
    ),
    (
        "R_s",
        "v/i where the current is constant; printed in amperes",
        "v/i of all rests of a sweep, one value a sweep: what the inverter keeps is in it",
        "slope over several currents, with the inverter's loss beside it; one value a rest",
    ),
    (
        "inverter",
        '"compensation by a suitable model", not given',
        "none",
        "estimated from the loops of the sweeps, or as an effect by the diagnosis",
    ),
    (
        "integration",
        "all points of one current averaged over ten periods",
        "the same; beside it with each sweep's drift taken out, or ten periods run away",
        "rising and falling branches averaged, by levels; hysteresis and loss open the loop, not the mean",
    ),
    (
        "zero flux",
        "at zero current; silent on paths that do not pass it",
        "those begin where they cross the axis' path that does",
        "constants of all paths by least squares at all crossings",
    ),
    (
        "base voltage",
        '"a suitable choice"; currents not controlled during injection',
        "settled under control, its mean voltage frozen",
        "as this page",
    ),
    (
        "Omega",
        "in Hz, as f is 1-periodic",
        "in Hz",
        "in Hz, found in the voltage",
    ),
    (
        "demodulator",
        "leading Omega too many; i shifted by half a period and F not, which turns a square wave's sign",
        "F at the same instant as the ripple, no leading Omega",
        "ripple regressed on injected flux, charge, squares and cubes: H, its slopes, and no R_s in it",
    ),
    (
        "start of a point",
        "5 s from the first sample on",
        "the same; the decaying offset of the switched-on wave stays in",
        "five time constants left out",
    ),
    (
        "H",
        "from a vector that turns, or two that stand; the matrices are printed with H_kl, or 11, in all entries",
        "both vectors; H_11, H_12, H_22 by least squares",
        "the turning one",
    ),
    (
        "where H belongs",
        "at the mean current",
        "at the mean current",
        "at the current of the mean flux, from which curvature moves the mean",
    ),
    (
        "sums",
        "rectangles, the inductance at the end of each step",
        "the same, from zero current outwards",
        "trapezoids with their end correction over the graph of all neighbours, least squares",
    ),
    (
        "parity",
        "its second relation is printed with the wrong index; claimed to be satisfied",
        "checked in H and L",
        "checked in the flux; built into the energy",
    ),
    (
        "figures in percent",
        '"maximum relative error"',
        "of the rated flux, and of the flux at the crossing",
        "of the rated flux",
    ),
    (
        "psi_M",
        "plotted as psi_d - psi_M, which a locked rotor cannot tell",
        "zero flux at zero current",
        "the nameplate's, or measured on a turning rotor",
    ),
    (
        "energy",
        "H(psi), polynomial in the papers that it cites; recommended to be fitted to derivatives",
        "seven terms, fitted to H_kl",
        "co-energy of splines, even and reciprocal, on fluxes and derivatives; the polynomial beside it",
    ),
    (
        "which model for sensorless control",
        "left open",
        "left open",
        "both delivered, by frequency and amplitude, with their difference",
    ),
)
