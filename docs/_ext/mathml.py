"""Formulas as MathML, which browsers draw themselves: nothing is fetched from elsewhere."""

from typing import Any

from docutils import nodes
from docutils.utils.math import latex2mathml
from sphinx.application import Sphinx


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(_mathml(node.astext(), block=False))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    text = _mathml(node.astext(), block=True)
    translator.body.append(f'<div class="math-block">{text}</div>\n')
    raise nodes.SkipNode


def _mathml(latex: str, *, block: bool) -> str:
    formula = latex2mathml.tex2mathml(latex, as_block=block)
    return str(formula)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer under the name `mathml`."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
