"""A command says one line of what is wrong; what libraries would add to it on their own is no answer to anybody."""

import sys
import warnings


def hush_libraries() -> None:
    """Show neither Python's warnings, unless they were asked for (``python -W``), nor what destructors complain of.

    h5netcdf, for one, prints eight lines of a destructor's error beside each file that is damaged.
    """
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        sys.unraisablehook = _pass_over


def _pass_over(complaint: object) -> None:
    """An error that could not be raised has changed nothing."""
