"""Recordings on disk, format version 1: read strictly, written durably."""

from orchestrator.recording._files import capture_path, remove_partial_files, replace_file, storage_error
from orchestrator.recording._json import (
    MANIFEST_NAME,
    MODEL_NAME,
    has_model,
    read_json,
    read_manifest,
    read_model,
    write_json,
    write_manifest,
    write_model,
)
from orchestrator.recording._places import RUN_FILE, has_recording, require_recording
from orchestrator.recording._reader import Recording, open_recording
from orchestrator.recording._writer import SegmentWriter, WrittenSegment

__all__ = [
    "MANIFEST_NAME",
    "MODEL_NAME",
    "RUN_FILE",
    "Recording",
    "SegmentWriter",
    "WrittenSegment",
    "capture_path",
    "has_model",
    "has_recording",
    "open_recording",
    "read_json",
    "read_manifest",
    "read_model",
    "remove_partial_files",
    "replace_file",
    "require_recording",
    "storage_error",
    "write_json",
    "write_manifest",
    "write_model",
]
