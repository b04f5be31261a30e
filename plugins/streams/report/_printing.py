"""A page as PDF, by a browser that is installed on this machine; nothing is fetched, and no window opens."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from protocols import InputError, StorageError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")
PRINT_TIMEOUT_S = 120.0
_WORDS = ("--headless", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--no-pdf-header-footer")


def print_page(page: Path, to: Path, browsers: tuple[str, ...] = BROWSERS) -> Path:
    """Print a page that needs nothing beside it.

    Raises
    ------
    InputError
        Where none of the browsers is on the path.
    StorageError
        Where the browser made no file.
    """
    program = next((path for name in browsers if (path := shutil.which(name))), None)
    if program is None:
        advice = f"no browser to print with; install one of {', '.join(browsers)}, or print {page} from yours"
        raise InputError("--pdf", "", advice)
    with tempfile.TemporaryDirectory(prefix="printing-", ignore_cleanup_errors=True) as folder:
        pdf = Path(folder) / "page.pdf"
        # The page has no scripts and its own policy refuses whatever is not in it; the sandbox needs rights that
        # containers and root do not have.
        words = [program, *_WORDS, "--no-sandbox", f"--user-data-dir={folder}/profile", f"--print-to-pdf={pdf}"]
        try:
            done = subprocess.run(
                [*words, page.resolve().as_uri()], capture_output=True, text=True, timeout=PRINT_TIMEOUT_S, check=False
            )
            shutil.copyfile(pdf, to)
        except subprocess.TimeoutExpired:
            raise StorageError(f"{to}: the browser did not print within {PRINT_TIMEOUT_S:g} s") from None
        except FileNotFoundError:
            reason = (done.stderr.strip().splitlines() or ["without a word"])[-1]
            raise StorageError(f"{to}: the browser made no file: {reason[:200]}") from None
    return to
