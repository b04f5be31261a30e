"""Recordings on disk, format version 1: read strictly, written durably. Nothing here interprets a waveform."""

from orchestrator.recording._files import remove_partial_files, replace_file
from orchestrator.recording._manifest import MANIFEST_NAME, capture_path, read_manifest, write_manifest
from orchestrator.recording._reader import Recording, open_recording
from orchestrator.recording._writer import SegmentWriter, WrittenSegment

__all__ = [
    "MANIFEST_NAME",
    "Recording",
    "SegmentWriter",
    "WrittenSegment",
    "capture_path",
    "open_recording",
    "read_manifest",
    "remove_partial_files",
    "replace_file",
    "write_manifest",
]
