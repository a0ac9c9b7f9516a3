"""Write the examples as notebooks: `python scripts/write_notebooks.py [FOLDER]`, into `notebooks` by default."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from sphinx_gallery.gen_gallery import DEFAULT_GALLERY_CONF
from sphinx_gallery.notebook import jupyter_notebook
from sphinx_gallery.py_source_parser import split_code_and_text_blocks

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def make_notebook(example: Path) -> dict[str, Any]:
    """The notebook of the example at that path, as the format's JSON."""
    _, blocks = split_code_and_text_blocks(str(example))
    notebook: dict[str, Any] = jupyter_notebook(blocks, dict(DEFAULT_GALLERY_CONF), str(example.parent))
    return notebook


def main(folder: Path) -> int:
    """Write all of them."""
    folder.mkdir(parents=True, exist_ok=True)
    for example in sorted(EXAMPLES.glob("[0-9]*.py")):
        path = folder / f"{example.stem}.ipynb"
        path.write_text(json.dumps(make_notebook(example), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "notebooks")))
