"""What all tests share."""

import gc
import os
import signal

import pytest
from hypothesis import settings

from tests.support.budget import Budget
from tests.support.undrawn import draw_nothing

# A busy machine is no reason to fail: pytest's own timeout bounds a test. The fast suite draws the same examples every
# time, so that a change is judged by what it changes; the thorough one draws new ones.
settings.register_profile("fast", deadline=None, max_examples=15, derandomize=True)
settings.register_profile("thorough", deadline=None, max_examples=150)
settings.load_profile("fast")


# As the command line does for itself: before numpy is there, and for the programs that tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_configure(config: pytest.Config) -> None:
    """Programs under test hear Ctrl-C, also where a shell started the tests in the background and had it ignored.

    With the slow tests, more examples are tried too.
    """
    config.pluginmanager.register(Budget())
    if hasattr(config, "workerinput") and hasattr(os, "setsid"):
        os.setsid()  # Linux shares the processors among sessions first: no other worker's work delays this one's links
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if config.getoption("markexpr") != "not slow":
        settings.load_profile("thorough")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes long begins first: at the end no worker waits for another."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


def pytest_collection_finish() -> None:
    """What is imported by now stays: it need not be looked through for garbage again and again."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages and files have their pictures, on which nothing is drawn."""
    draw_nothing(monkeypatch)
