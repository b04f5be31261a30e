"""Recordings on disk, format version 1: read strictly, written durably."""

from orchestrator.recording._files import remove_partial_files, replace_file, storage_error, sync_folder
from orchestrator.recording._json import read_json
from orchestrator.recording._manifest import MANIFEST_NAME, capture_path, read_manifest, write_manifest
from orchestrator.recording._model_file import MODEL_NAME, has_model, read_model, write_model
from orchestrator.recording._reader import Recording, open_recording
from orchestrator.recording._writer import SegmentWriter, WrittenSegment

__all__ = [
    "MANIFEST_NAME",
    "MODEL_NAME",
    "Recording",
    "SegmentWriter",
    "WrittenSegment",
    "capture_path",
    "has_model",
    "open_recording",
    "read_json",
    "read_manifest",
    "read_model",
    "remove_partial_files",
    "replace_file",
    "storage_error",
    "sync_folder",
    "write_manifest",
    "write_model",
]
