"""The operator's page: start, monitor, answer and stop procedures from a browser on this machine.

The run is a separate process (`fluxbench run --remote page`). The server displays its output and forwards answers. If
the server ends, the run stops by itself.
"""
