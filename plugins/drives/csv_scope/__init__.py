"""A drive that is a folder: requests are written as files, and measurements are read back as files."""

from plugins.drives.csv_scope.drive import CsvScopeDrive, CsvScopeOptions

__all__ = ["CsvScopeDrive", "CsvScopeOptions"]
