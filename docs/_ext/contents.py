"""Contents that take what is there: `?online` names a page where it exists, `?*` all the others."""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx

ENTRY = re.compile(r"^\?(\S+)$", re.MULTILINE)


def filled(text: str, folder: Path) -> str:
    """The index with the names of pages that exist in place of `?NAME` and `?*`."""
    there = {page.stem for page in folder.glob("*.md")} - {"index"}
    named = set(re.findall(r"^\??([a-z-]+)$", text, re.MULTILINE))
    others = "\n".join(sorted(there - named))
    return ENTRY.sub(
        lambda found: others if found[1] == "*" else found[1] if found[1] in there else "", text
    )


def _read(app: Sphinx, name: str, source: list[str]) -> None:
    if name == "index":
        source[0] = filled(source[0], Path(app.srcdir))


def setup(app: Sphinx) -> dict[str, bool]:
    """Read the index on every build, as pages may have come and gone."""
    app.connect("source-read", _read)
    app.connect("env-get-outdated", lambda *_: ["index"])
    return {"parallel_read_safe": True, "parallel_write_safe": True}
