"""What several tests of the Python interface look at."""

from pathlib import Path

import pytest

from tests.support.tiny import run_tiny


@pytest.fixture(scope="package")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with its estimates; a test that changes it takes a copy."""
    return run_tiny(tmp_path_factory.mktemp("measured")).path
