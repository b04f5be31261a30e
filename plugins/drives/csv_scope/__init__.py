"""A drive that is a folder: what is to be played goes out as a file, and what was measured comes back as one."""

from plugins.drives.csv_scope.drive import CsvScopeDrive, CsvScopeOptions

__all__ = ["CsvScopeDrive", "CsvScopeOptions"]
