"""The operator's page: procedures started, followed, answered and stopped from a browser on this machine.

The run is a process of its own (`fluxbench run --remote page`); the server here only shows what that says, and hands on
what a person answers. Where the server is gone, the run stops by itself.
"""
