"""Pictures that are drawn when the documentation is built: `{picture} track`.

`docs/pictures/NAME.py` draws with Matplotlib what its docstring says; the page shows the picture,
the docstring and the source. Where neither that nor what sparsefit computes has changed, a picture
is not drawn again.
"""

from __future__ import annotations

import ast
import hashlib
import runpy
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from written import parsed

from sparsefit.study.run.version import version_of

SOURCES = Path(__file__).parents[1] / "pictures"
DRAWN = "_drawn"


class Picture(SphinxDirective):
    """A picture, what it shows, and how it is drawn."""

    required_arguments = 1
    option_spec: ClassVar = {"alone": directives.flag}

    def run(self) -> list[nodes.Node]:
        source = SOURCES / f"{self.arguments[0]}.py"
        self.env.note_dependency(str(source))
        text = source.read_text("utf-8")
        told = ast.get_docstring(ast.parse(text)) or ""
        title, _, words = told.partition("\n")
        image = f"{DRAWN}/{drawn(source, Path(self.env.app.outdir)).name}"
        shown = [
            f'<img class="drawn" src="{image}" alt="{title}">',
            "",
            *([title] if "alone" in self.options else [f"**{title}** {' '.join(words.split())}"]),
        ]
        code = text.split('"""', 2)[2].strip()
        listing = nodes.literal_block(code, code, language="python")
        details = [
            nodes.raw("", "<details><summary>How it is drawn</summary>", format="html"),
            listing,
            nodes.raw("", "</details>", format="html"),
        ]
        return [*parsed(self, shown), *(details if "alone" not in self.options else [])]


def drawn(source: Path, output: Path) -> Path:
    """The SVG file of a picture in the folder `_drawn` of the output, made where it is not."""
    told = version_of("group-lasso").encode() + source.read_bytes()
    digest = hashlib.sha256(told).hexdigest()[:12]
    path = output / DRAWN / f"{source.stem}-{digest}.svg"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        _draw(source, path)
    return path


def _draw(source: Path, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    with matplotlib.rc_context(STYLE):
        runpy.run_path(str(source))
        pyplot.savefig(path, bbox_inches="tight")
        pyplot.close("all")


STYLE = {
    "font.size": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "sparsefit",
    "font.family": "sans-serif",
    "figure.constrained_layout.use": True,
    "savefig.facecolor": "white",
}


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("picture", Picture)
    return {"parallel_read_safe": False, "parallel_write_safe": True}
