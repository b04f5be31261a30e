"""Shared by the drives on every link: requests of the host, receive loop, uploads, faults, shutdown."""

from plugins.link._drive import LinkDrive, LinkOptions
from plugins.link._drive_line import DriveLine
from plugins.link._errors import link_errors
from plugins.link._host import Host
from plugins.link._line import Line
from plugins.link._link import Link
from plugins.link._port import Port
from plugins.link._timeouts import ProcessClock

__all__ = ["DriveLine", "Host", "Line", "Link", "LinkDrive", "LinkOptions", "Port", "ProcessClock", "link_errors"]
