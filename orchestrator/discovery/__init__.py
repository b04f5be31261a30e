"""When no effect of the library explains a recording: the law that is missing, found and written as an effect.

A flexible law is tried at every place where something may be missing, over every quantity that it may depend on; the
best is put into a short form, and written as an effect plugin of one class.
"""

from orchestrator.discovery.discover import Learned, discover_laws
from orchestrator.discovery.memory import cooled, earlier, fading_memory, lagged, play, slopes, unknown_memory
from orchestrator.discovery.pictures import curve_picture, draw_law, form_values
from orchestrator.discovery.report import Discovery, FoundForm, FoundLaw
from orchestrator.discovery.saving import load_discovery, require_name, save_discovery, write_law

__all__ = [
    "Discovery",
    "FoundForm",
    "FoundLaw",
    "Learned",
    "cooled",
    "curve_picture",
    "discover_laws",
    "draw_law",
    "earlier",
    "fading_memory",
    "form_values",
    "lagged",
    "load_discovery",
    "play",
    "require_name",
    "save_discovery",
    "slopes",
    "unknown_memory",
    "write_law",
]
