"""The code blocks of a page of documentation, and how they are run.

A block is fenced by three backticks. A comment on the line before it may say how it is run:

    <!-- slow -->            in the gate only
    <!-- needs: pyulog -->   where that package is there
    <!-- not run: why -->    never

`python` blocks of a page share one namespace; `bash` and `console` blocks are run line by line in
the same folder, `sparsefit ...` without a new process. What stands below a `$ command` of a console
block, or in an `output` block below a python block, must be what is printed, `...` being anything.
A block with `:caption: NAME` is written to that file, of a `{literalinclude}` what it includes.
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

BLOCK = re.compile(
    r"(?:^<!-- (?P<word>slow|needs|not run)(?:: (?P<what>.*))? -->\n+)?"
    r"^```(?!`)(?:\{code-block\} )?(?P<language>\S*) *(?P<more>.*)\n"
    r"(?P<options>(?::\w+: .*\n)*)\n?(?P<text>(?:.*\n)*?)^```$",
    re.MULTILINE,
)
LANGUAGES = ("python", "bash", "console")
LOOSE = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
INSTALLS = ("pip install", "python -m pip install")
SHELL = frozenset("|&;<>`$(")


@dataclass
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
    output: str = ""

    @property
    def missing(self) -> bool:
        return bool(self.needs) and importlib.util.find_spec(self.needs) is None


def blocks_of(page: Path) -> list[Block]:
    """The blocks of a page that run or are files, in order."""
    every, content = [], page.read_text("utf-8")
    for part in BLOCK.finditer(content):
        word, language, text = part["word"], part["language"], part["text"]
        caption = re.search(r"^:caption: (.*)", part["options"], re.MULTILINE)
        if caption and language == "{literalinclude}":
            language, text = "python", (page.parent / part["more"]).read_text("utf-8")
        if language == "output" and every:
            every[-1].output = text
        elif word != "not run" and (language in LANGUAGES or (caption and "{" not in language)):
            line = content.count("\n", 0, part.start("text"))
            needs = part["what"] if word == "needs" else ""
            name = caption[1] if caption else ""
            every.append(Block(language, text, line, name, word == "slow", needs))
    return every


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
