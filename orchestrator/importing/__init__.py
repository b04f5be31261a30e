"""Convert CSV, MATLAB, Parquet and ASAM MF4 measurements into recordings; a mapping file describes their columns.

Implausible data are refused or noted with their place; the import repairs only what the mapping requests.
"""

from orchestrator.importing._findings import Finding
from orchestrator.importing._importing import ImportReport, import_files
from orchestrator.importing._loading import MappingFile, read_drive, read_mapping
from orchestrator.importing._mapping import CsvLayout, ImportMapping
from orchestrator.importing._matlab import inflated_size
from orchestrator.importing._merging import merge_recordings
from orchestrator.importing._opening import ENDINGS, read_table
from orchestrator.importing._signals import Column, NotZero, Scaling
from orchestrator.importing._units import FACTORS, CurrentUnit
from orchestrator.importing._vectors import TO_PEAK

__all__ = [
    "ENDINGS",
    "FACTORS",
    "TO_PEAK",
    "Column",
    "CsvLayout",
    "CurrentUnit",
    "Finding",
    "ImportMapping",
    "ImportReport",
    "MappingFile",
    "NotZero",
    "Scaling",
    "import_files",
    "inflated_size",
    "merge_recordings",
    "read_drive",
    "read_mapping",
    "read_table",
]
