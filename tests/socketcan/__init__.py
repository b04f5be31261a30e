"""Tests on the kernel's own CAN buses, in a virtual machine that brings such a kernel: `make test-socketcan`.

Where the buses of `buses.py` are not there, pytest passes over this directory.
"""
