"""What the documentation says of the package itself is complete: keys, options, public names."""

import re
import sys
from pathlib import Path

import pandas as pd
import pytest

import sparsefit
from sparsefit.backends import BACKENDS, PUBLIC

DOCS = Path(__file__).parents[2] / "docs"
EXTENSIONS = DOCS / "_ext"


@pytest.fixture
def directives(monkeypatch):
    pytest.importorskip("sphinx", reason="`make docs` itself refuses a key without words")
    monkeypatch.syspath_prepend(EXTENSIONS)
    import directives

    yield directives
    sys.modules.pop("directives")


def test_every_key_of_a_study_file_has_words(directives):
    for section in (*directives.RECORDS, *directives.crossing.SECTION_KEYS):
        rows = directives.study_keys(section)
        assert len(rows) > 2
        assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} == {3}  # no mark cuts a cell


def test_a_key_without_words_is_refused_by_name(directives, monkeypatch):
    words = directives.meanings("run") | {"tolerance": ""}
    monkeypatch.setattr(directives, "meanings", lambda _: words)
    with pytest.raises(ValueError, match=r"\[run\].*tolerance"):
        directives.study_keys("run")


def test_a_sentence_that_its_table_contradicts_is_refused(directives):
    figure = "table2/errors; n; max; {}; title=default: lasso alpha_fraction=0.1"
    assert directives.measured(figure.format(">= 95")) == "95"
    with pytest.raises(ValueError, match="the page claims <= 90"):
        directives.measured(figure.format("<= 90"))
    with pytest.raises(ValueError, match="no column"):
        directives.measured("table2/errors; nothing; max; -")


def test_the_table_of_the_readme_is_that_of_the_results():
    errors = pd.read_csv(DOCS.parent / "results" / "table2" / "errors-absolute.csv", index_col=0)
    columns = [*(f"mean |error| {name} [%]" for name in ("U0", "L_w", "τ_w")), "failures"]
    page = (DOCS.parent / "README.md").read_text("utf-8")
    rows = re.findall(r"^\| (.*) \| `(.*)` \|(.*)\|$", page, re.MULTILINE)
    assert len(rows) == 5
    for reading, backend, cells in rows:
        values = errors.loc[f"{reading}: {backend}", columns]
        for text, value in zip(cells.split("|"), values, strict=True):
            if "<" in text:
                assert value < float(text.replace("<", ""))
            else:
                assert round(value, len(text.strip().partition(".")[2])) == float(text), backend


def test_every_back_end_has_a_line_where_one_chooses():
    page = (DOCS / "choosing.md").read_text("utf-8")
    for name in (*BACKENDS, *PUBLIC):
        assert f"| `{name}`" in page or f", `{name}`" in page, name


LINK = re.compile(r"\]\(([\w./-]+\.(?:md|svg|png|toml|csv|json))(?:#[\w-]*)?\)")
MODULE = re.compile(r"`(?:sparsefit/)?([\w/]+\.py)`")
MODULES = [str(path) for path in Path(sparsefit.__file__).parent.rglob("*.py")]


@pytest.mark.parametrize(
    "page", [DOCS.parent / "README.md", *sorted(DOCS.glob("*.md"))], ids=lambda page: page.stem
)
def test_links_work_where_a_page_is_read_as_a_file_and_modules_that_it_names_are_there(page):
    text = page.read_text("utf-8")
    assert [to for to in LINK.findall(text) if not (page.parent / to).exists()] == []
    for name in MODULE.findall(text):
        ours = any(path.endswith(f"/{name}") for path in MODULES)
        assert ours or (DOCS.parent / name).is_file(), name
