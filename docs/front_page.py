"""Files beside docs/ that belong to the site: the README as its front page, CONTRIBUTING, LICENSE and CITATION.cff."""

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

PAGES = {"index.md": "README.md", "contributing.md": "CONTRIBUTING.md"}
PLAIN = ("LICENSE", "CITATION.cff")


def on_files(files: Files, *, config: Any) -> Files:
    """Add the pages, with their links led from docs/, and the plain files."""
    root = Path(config.config_file_path).parent
    for page, source in PAGES.items():
        text = (root / source).read_text(encoding="utf-8")
        content = text.replace("](docs/", "](").replace("](CONTRIBUTING.md", "](contributing.md")
        files.append(File.generated(config, page, content=content))
    for name in PLAIN:
        files.append(File.generated(config, name, content=(root / name).read_text(encoding="utf-8")))
    return files
