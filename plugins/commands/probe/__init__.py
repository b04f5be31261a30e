"""`fluxbench probe`: finds drives on this machine's ports and buses; reads only, moves nothing."""

from plugins.commands.probe._finding import Found, can_bus, found_on, links_of_this_machine, serial_line

__all__ = ["Found", "can_bus", "found_on", "links_of_this_machine", "serial_line"]
