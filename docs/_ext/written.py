"""Markdown that a directive has written, as nodes."""

import re

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective


def parsed(directive: SphinxDirective, lines: list[str]) -> list[nodes.Node]:
    """The nodes of these lines of Markdown, headings among them."""
    source, _ = directive.get_source_info()
    holder = nodes.section()
    holder.document = directive.state.document
    directive.state.nested_parse(StringList(lines, source), 0, holder)
    return holder.children


BAR = re.compile(r"(``[^`]*``)|\|")


def escaped(docstring: str) -> str:
    """A docstring whose |w| is a size, where reStructuredText sees a substitution."""
    return BAR.sub(lambda found: found[1] or r"\|", docstring)
