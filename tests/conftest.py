"""What all tests share."""

import os
import signal

from hypothesis import settings

# A busy machine is no reason to fail: pytest's own timeout bounds a test.
settings.register_profile("fluxbench", deadline=None)
settings.load_profile("fluxbench")


# As the command line does for itself: before numpy is there, and for the programs that tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_configure() -> None:
    """Programs under test hear Ctrl-C, also where a shell started the tests in the background and had it ignored."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
