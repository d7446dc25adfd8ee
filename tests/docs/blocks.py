"""The code blocks of a page of documentation, and how they are run.

A block is fenced by three backticks. A comment on the line before it may say how it is run:

    <!-- slow -->            in the gate only
    <!-- needs: pyulog -->   where that package is there
    <!-- not run: why -->    never

`python` blocks of a page share one namespace; `bash` and `console` blocks are run line by line in
the same folder, `sparsefit ...` without a new process. What stands below a `$ command` of a console
block, or in an `output` block below a python block, must be what is printed, `...` being anything.
A block with `:caption: NAME` is written to that file.
"""

from __future__ import annotations

import contextlib
import doctest
import importlib.util
import io
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sparsefit.cli import main

FENCE = re.compile(r"```(?P<open>[^`]*)$")
COMMENT = re.compile(r"<!-- (?P<word>slow|needs|not run)(?:: (?P<what>.*))? -->")
LANGUAGES = ("python", "bash", "console")
LOOSE = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
INSTALLS = ("pip install", "python -m pip install")
SHELL = frozenset("|&;<>`$(")


@dataclass(frozen=True)
class Block:
    """One block: its language, its text, where it stands and how it is run.

    output: what a python block must print, where the page says so.
    """

    language: str
    text: str
    line: int
    caption: str = ""
    slow: bool = False
    needs: str = ""
    left_out: str = ""
    output: str = ""

    @property
    def runs(self) -> bool:
        """Whether there is anything to run, or a file to write."""
        return not self.left_out and (self.language in LANGUAGES or bool(self.caption))

    @property
    def missing(self) -> bool:
        """Whether it needs a package that is not here."""
        return bool(self.needs) and importlib.util.find_spec(self.needs) is None


def blocks_of(page: Path) -> list[Block]:
    """The blocks of a page, in order."""
    found: list[Block] = []
    for block in _fenced(page.read_text("utf-8").splitlines()):
        if block.language == "output" and found and found[-1].language == "python":
            found[-1] = Block(**{**vars(found[-1]), "output": block.text})
        else:
            found.append(block)
    return [block for block in found if block.runs]


def _fenced(lines: list[str]) -> Iterator[Block]:
    opened, start, notes = "", 0, {}
    for number, line in enumerate(lines, 1):
        fence = FENCE.match(line)
        if fence and not opened:
            before = next((one for one in reversed(lines[: number - 1]) if one.strip()), "")
            comment = COMMENT.search(before)
            notes = _notes(comment["word"], comment["what"] or "") if comment else {}
            opened, start = fence["open"].strip() or "text", number
        elif fence and opened:
            words = opened.split()
            language = words[-1] if words[0] == "{code-block}" else words[0]
            options, text = _options(lines[start : number - 1])
            caption = options.get("caption", "")
            yield Block(language, "\n".join(text) + "\n", start, caption, **notes)
            opened = ""


def _notes(word: str, what: str) -> dict[str, object]:
    return {"slow": {"slow": True}, "needs": {"needs": what}, "not run": {"left_out": what}}[word]


def _options(lines: list[str]) -> tuple[dict[str, str], list[str]]:
    """The `:name: value` lines at the head of a block, and the others."""
    options: dict[str, str] = {}
    while lines and (option := re.fullmatch(r":(\w+): (.*)", lines[0])):
        options[option[1]] = option[2]
        lines = lines[1:]
    return options, lines


def run(block: Block, page: str, names: dict[str, object]) -> None:
    """Run a block in the current folder; AssertionError where it fails or prints another thing."""
    if block.caption:
        Path(block.caption).parent.mkdir(parents=True, exist_ok=True)
        Path(block.caption).write_text(block.text, "utf-8")
        return
    where = f"{page}:{block.line}"
    if block.language == "python":
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            # The lines of the page, so that a traceback names them.
            exec(compile("\n" * block.line + block.text, f"<{page}>", "exec"), names)
        _same(block.output, printed.getvalue(), where)
        return
    for command, output in _commands(block):
        if not command.startswith(INSTALLS):
            _same(output, _typed(command, where), f"{where}: {command}")


def _commands(block: Block) -> Iterator[tuple[str, str]]:
    """(command, what it must print) of a block; nothing where the page shows none."""
    text = block.text.replace("\\\n", " ")
    if block.language == "bash":
        for line in text.splitlines():
            command = line.partition(" #")[0].strip()
            if command and not command.startswith("#"):
                yield command, ""
        return
    for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
        command, _, output = part.partition("\n")
        yield command, output.strip("\n")


def _typed(command: str, where: str) -> str:
    """What a command prints; it must end with exit code 0."""
    if command.startswith("sparsefit ") and not SHELL & set(command):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            try:
                code = main(shlex.split(command)[1:])
            except SystemExit as ended:  # --help
                code = ended.code or 0
        assert code == 0, f"{where}: `{command}` ended with {code}"
        return printed.getvalue()
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    asked = ["bash", "-euo", "pipefail", "-c", command]
    done = subprocess.run(asked, capture_output=True, text=True, env=os.environ | {"PATH": path})
    assert done.returncode == 0, f"{where}: `{command}` ended with {done.returncode}: {done.stderr}"
    return done.stdout


def _same(expected: str, printed: str, where: str) -> None:
    if expected:
        same = doctest.OutputChecker().check_output(expected.strip(), printed.strip(), LOOSE)
        assert same, f"{where}: the page shows\n{expected}\nbut this was printed\n{printed}"
