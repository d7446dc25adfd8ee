"""Every code block of README.md and docs/*.md runs, from an empty folder, page by page."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.docs.blocks import blocks_of, run

ROOT = Path(__file__).parents[2]
PAGES = {
    str(page.relative_to(ROOT)): blocks_of(page)
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
}

RUNS = [(page, False) for page, blocks in PAGES.items() if blocks]
RUNS += [
    pytest.param(page, True, marks=pytest.mark.slow)
    for page, blocks in PAGES.items()
    if any(block.slow for block in blocks)
]


@pytest.mark.parametrize(("page", "slow"), RUNS)
def test_the_blocks_of_a_page_run_in_order(page, slow, tmp_path, monkeypatch, capsys):
    blocks = [block for block in PAGES[page] if slow or not block.slow]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    module = ModuleType("page")  # where a dataclass of the page looks for its own names
    monkeypatch.setitem(sys.modules, "page", module)
    for block in blocks:
        if not block.missing:
            run(block, page, vars(module))
    if missing := {block.needs for block in blocks if block.missing}:
        pytest.skip(f"without {', '.join(sorted(missing))}: the other blocks ran")


def test_a_block_that_prints_another_thing_than_its_page_says_is_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```python\nprint(1 + 1)\n```\n\n```output\n3\n```\n", "utf-8")
    with pytest.raises(AssertionError, match="the page shows\n3"):
        run(blocks_of(page)[0], "page.md", {})
    page.write_text("```console\n$ sparsefit estimate nothing.csv\n```\n", "utf-8")
    with pytest.raises(AssertionError, match="ended with 2"):
        run(blocks_of(page)[0], "page.md", {})
