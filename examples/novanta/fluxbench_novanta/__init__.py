"""The drive `novanta`: a Novanta (Ingenia) servo drive on Ethernet that holds direct currents, in rows of its own."""

from fluxbench_novanta.drive import NovantaDrive, NovantaOptions

__all__ = ["NovantaDrive", "NovantaOptions"]
