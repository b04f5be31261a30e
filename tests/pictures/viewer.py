"""The viewer's layouts as it draws them: pictures for the documentation. Needs a graphics driver, software will do."""

from __future__ import annotations

import io
import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from orchestrator.recording import open_recording
from plugins.streams.rerun import RerunOptions, RerunStream
from plugins.streams.rerun._replay import replay
from plugins.streams.rerun._shooting import Shot, headless_viewer, shoot
from plugins.streams.rerun._tape import FILE_NAME
from protocols import Compared, Diagnosed, DiagnosisStep, ExperimentProposed, Message, RecordingError, StreamSetup

OF_DIAGNOSIS = (Compared, DiagnosisStep, Diagnosed, ExperimentProposed)
NAMES = ("viewer-commissioning", "viewer-flux", "viewer-diagnosis")
SIZE = (1600, 1000)
LARGEST_BYTES = 400_000
GREETING_S = 6.0
"""How long the viewer shows its greeting in a corner."""


def viewer_pictures(run: Path, folder: Path) -> tuple[Path, ...]:
    """Shoot both layouts: `viewer-commissioning.png`, `viewer-flux.png`, `viewer-diagnosis.png`.

    Raises
    ------
    RecordingError
        Where the run was not diagnosed.
    """
    open_recording(run)
    messages = list(replay(run))
    of_diagnosis = [m for m in messages if isinstance(m, OF_DIAGNOSIS)]
    if not any(isinstance(m, DiagnosisStep) for m in of_diagnosis):
        raise RecordingError(str(run), "results/diagnosis.npz", "missing: `fluxbench diagnose` makes it")
    folder.mkdir(parents=True, exist_ok=True)
    commissioning = [m for m in messages if not isinstance(m, OF_DIAGNOSIS)]
    return (
        _shot(commissioning, "What is it doing?", folder / "viewer-commissioning.png"),
        _shot(commissioning, "What is the flux?", folder / "viewer-flux.png"),
        _shot(of_diagnosis, "Which effect is missing?", folder / "viewer-diagnosis.png"),
    )


def _shot(messages: Sequence[Message], tab: str, to: Path) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="pictures-"))
    try:
        stream = RerunStream(StreamSetup(run=folder, options=RerunOptions()), ripple_every_s=0.0)
        for message in messages:
            stream.receive(message)
        stream.close()
        with headless_viewer(SIZE) as viewer:
            time.sleep(GREETING_S)
            (shot,) = shoot(viewer, folder / FILE_NAME, tab)
    finally:
        shutil.rmtree(folder)
    to.write_bytes(_small(shot))
    return to


def _small(shot: Shot) -> bytes:
    """The picture in so few colours that it stays below `LARGEST_BYTES`; nothing of the machine it was made on."""
    picture = Image.open(io.BytesIO(shot.png)).convert("RGB")
    pixels = np.asarray(picture).copy()
    across, down = picture.width / SIZE[0], picture.height / SIZE[1]
    # The viewer's warnings about a software renderer.
    pixels[: int(35 * down), int(48 * across) : int(260 * across)] = pixels[int(12 * down), int(400 * across)]
    for colours in (256, 128, 64, 32):
        out = io.BytesIO()
        Image.fromarray(pixels).quantize(colours, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
        if out.tell() <= LARGEST_BYTES:
            break
    return out.getvalue()
