"""Every code block of README.md and docs/*.md runs, from an empty folder, page by page."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.docs.blocks import Block, blocks_of, run

ROOT = Path(__file__).parents[2]
PAGES = {
    str(page.relative_to(ROOT)): blocks_of(page)
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
}

COMMENTED = """
<!-- slow -->
```python
1
```

<!-- needs: nowhere_to_be_found -->
```bash
ls
```

<!-- not run: no -->
```bash
rm
```

```{code-block} toml
:caption: a.toml

b = 1
```
"""


def run_page(page: str, blocks: list[Block], folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    missing = {block.needs for block in blocks if block.missing}
    module = ModuleType("page")  # where a dataclass of the page looks for its own names
    monkeypatch.setitem(sys.modules, "page", module)
    for block in blocks:
        if not block.missing:
            run(block, page, vars(module))
    return missing


@pytest.mark.parametrize("page", [page for page, blocks in PAGES.items() if blocks])
def test_the_blocks_of_a_page_run_in_order(page, tmp_path, monkeypatch, capsys):
    quick = [block for block in PAGES[page] if not block.slow]
    if missing := run_page(page, quick, tmp_path, monkeypatch):
        pytest.skip(f"without {', '.join(sorted(missing))}: the other blocks ran")


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [page for page, blocks in PAGES.items() if any(block.slow for block in blocks)]
)
def test_the_slow_blocks_run_too(page, tmp_path, monkeypatch, capsys):
    run_page(page, PAGES[page], tmp_path, monkeypatch)


def test_a_block_that_prints_another_thing_than_its_page_says_is_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```python\nprint(1 + 1)\n```\n\n```output\n3\n```\n", "utf-8")
    with pytest.raises(AssertionError, match="the page shows\n3"):
        run(blocks_of(page)[0], "page.md", {})
    page.write_text("```console\n$ sparsefit estimate nothing.csv\n```\n", "utf-8")
    with pytest.raises(AssertionError, match="ended with 2"):
        run(blocks_of(page)[0], "page.md", {})


def test_comments_and_captions_say_how_a_block_is_run(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(COMMENTED, "utf-8")
    first, second, third = blocks_of(page)
    assert first.slow
    assert second.missing
    assert third.caption == "a.toml"
    assert "b = 1" in third.text
