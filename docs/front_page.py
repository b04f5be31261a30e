"""The site's front page is the README: one text, seen from the repository and from the site."""

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files


def on_files(files: Files, *, config: Any) -> Files:
    """Add index.md, the README with its links led from here."""
    text = (Path(config.config_file_path).parent / "README.md").read_text(encoding="utf-8")
    content = text.replace("](docs/notebooks)", "](python.md)").replace("](docs/", "](")
    files.append(File.generated(config, "index.md", content=content))
    return files
