"""What all tests share."""

from hypothesis import settings

# A busy machine is no reason to fail: pytest's own timeout bounds a test.
settings.register_profile("fluxbench", deadline=None)
settings.load_profile("fluxbench")
