"""What drives behind every link share: the host's conversation, the receive loop, uploads, faults, ways out."""

from plugins.drives._link._drive import LinkDrive
from plugins.drives._link._errors import link_errors
from plugins.drives._link._host import Host
from plugins.drives._link._link import Link
from plugins.drives._link._options import LinkOptions
from plugins.drives._link._port import Port

__all__ = ["Host", "Link", "LinkDrive", "LinkOptions", "Port", "link_errors"]
