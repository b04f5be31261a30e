"""Pictures of the viewer and of the report, made from a run for the documentation: `python -m tests.pictures RUN`."""
