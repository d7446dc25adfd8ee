"""What makes a row another version's: what computes, not what is said of it."""

import ast
from pathlib import Path

import pytest

import sparsefit
from sparsefit.study.run.version import _sources, without_words

SOURCE = '''"""A room."""

def area(side: float) -> float:
    return side * side
'''
WORDY = '''"""A room that says more, "quoted" too."""

# Why it is here.

def area(side: float) -> float:  # a comment
    """The area."""
    return side * side  # of a square
'''


def test_words_change_no_version():
    silent = SOURCE.replace("float:\n", 'float:\n    ""\n')
    assert without_words(WORDY) == without_words(silent)
    assert without_words(SOURCE.replace("side * side", "side + side")) != without_words(SOURCE)
    assert "# no comment" in without_words('X = """\n  # no comment\n"""\n')


SOURCES = list(_sources(Path(sparsefit.__file__).parent))


@pytest.mark.parametrize("path", SOURCES[:: len(SOURCES) // 8], ids=lambda path: path.stem)
def test_what_computes_is_left(path):
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    for node in ast.walk(tree):
        holds = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        if holds and ast.get_docstring(node) is not None:
            node.body[0].value.value = ""
    assert ast.dump(ast.parse(without_words(source))) == ast.dump(tree)
