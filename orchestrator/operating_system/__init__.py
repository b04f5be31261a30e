"""What differs between Linux, macOS and Windows: locks, files, signals, processes, memory.

Modules of Python that only some systems have are imported here alone, each where it is used.
"""
