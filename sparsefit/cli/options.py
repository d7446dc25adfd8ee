"""Declarations of verbs and options, and the readers of the values that are typed for them."""

from __future__ import annotations

import argparse
import inspect
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NoReturn, TypeAlias

from sparsefit.cli.terminal import Reply
from sparsefit.codec import Place
from sparsefit.errors import InputError, one_line, suggestion
from sparsefit.study.keys import SYNONYMS

Verbs: TypeAlias = "argparse._SubParsersAction[Parser]"
Run: TypeAlias = Callable[[argparse.Namespace], Reply]
PLAIN = ("NUMBER", "SHARE", "N", "X Y")  # placeholders of numbers that are no unit


class Parser(argparse.ArgumentParser):
    """A parser that refuses in one line with the nearest name, and reads `-1e-3` as a number."""

    def __init__(self, **settings: Any) -> None:
        settings |= {"formatter_class": argparse.RawDescriptionHelpFormatter, "allow_abbrev": False}
        super().__init__(**settings)
        # Before Python 3.14 argparse takes -1e-3 for an option.
        self._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$", re.I)

    def _check_value(self, action: argparse.Action, value: object) -> None:
        """Refuse a verb or choice that does not exist with the nearest one."""
        if action.choices is not None and value not in action.choices:
            kind = action.metavar if isinstance(action.metavar, str) else action.dest
            near = suggestion(str(value), map(str, action.choices))
            self.error(f'unknown {kind.lower()} "{value}"{near}')

    def error(self, message: str) -> NoReturn:
        """Exit with code 2 after one line with the cause and where the remedy stands."""
        print(f"sparsefit: error: {one_line(message)}; see {self.prog} --help", file=sys.stderr)
        sys.exit(2)

    def unrecognized(self, words: Iterable[str]) -> NoReturn:
        """Exit with code 2 after one line with the options unknown here and the nearest one."""
        unknown = " ".join(words)
        typed = unknown.split(" ")[0].partition("=")[0].removeprefix("--")
        near = suggestion(flag(SYNONYMS.get(typed, typed)), self._option_string_actions)
        near = near if unknown.startswith("-") and "did you mean" in near else ""
        self.error(f"unrecognized arguments: {unknown}{near}")


class Option:
    """An option of a verb, or a value without a flag, as argparse declares it."""

    def __init__(self, flags: str, help: str, metavar: str = "",
                 read: Callable[[str], Any] | None = str, **more: Any) -> None:  # fmt: skip
        """Say how it is typed and read.

        Args:
            flags: names as typed, `--length-scale` or `-o --output`, separated by blanks.
            help: the sentence of `--help`.
            metavar: the placeholder of the value, several for several values, of a number its unit
                or NUMBER.
            read: the type of a value, None for a flag, which is True where it is given.
            more: further arguments of `add_argument`.
        """
        self.names, count = flags.split(), len(metavar.split())
        self.dest = more.get("dest", self.names[-1].removeprefix("--").replace("-", "_"))
        number = partial(read_number, read, metavar) if read in (int, float) else read
        kind = {"type": number, "metavar": metavar or None} if read else {"action": "store_true"}
        several = {"nargs": count, "metavar": tuple(metavar.split())} if count > 1 else {}
        self.settings: dict[str, Any] = {"help": help, **kind, **several, **more}


def read_number(read: Callable[[str], float], unit: str, text: str) -> float:
    """A plain number; `4 m` is refused with the unit to drop."""
    try:
        return read(text if "_" not in text else "")
    except ValueError:
        kind = "whole number" if read is int else "number"
        remedy = "" if unit in ("", *PLAIN) else f"; give it in {unit}, without the unit"
        raise argparse.ArgumentTypeError(f'"{text}" is not a {kind}{remedy}') from None


class OptionPlace(Place):
    """The option that a refusal names."""

    def error(self, problem: str) -> InputError:
        """`--length-scale must be above 0`, keys in the words as options, too."""
        key = r"(?<!['\"\w])([a-z]+_[a-z_]+|timescale)"
        words = re.sub(key, lambda name: flag(name[0]), problem)
        return InputError(f"{flag(self.key)} {words}" if self.key else words)


def option_of(key: str, words: str, metavar: str, read: Callable[[str], Any] | None) -> Option:
    """The option of a key of a study file, with the words of the key."""
    sentence = re.sub("`([a-z]+_[a-z_]+|timescale|drag)`", lambda name: flag(name[1]), words)
    sentence = sentence.replace("`", "").replace("%", "%%").replace(" Needed.", "")
    more = {"default": None} if read is None else {}  # as a flag that was not given
    return Option(flag(key), sentence, metavar, read, **more)


def flag(key: str) -> str:
    """The option of a key, `--length-scale`."""
    return f"--{key.replace('_', '-')}"


def verb(
    verbs: Verbs,
    name: str,
    run: Run,
    options: Sequence[Option] = (),
    groups: Mapping[str, Iterable[Option]] | None = None,
    about: str = "",
) -> Parser:
    """Return the parser of a verb.

    run: its docstring is the help, a sentence and below it the examples, by default one of a study
    file; options: beside `--json`, which every verb has; groups: others by the title that they
    stand under; about: in place of the docstring.
    """
    sentence, _, below = inspect.cleandoc(about or run.__doc__ or name).partition("\n\n")
    parser = verbs.add_parser(
        name,
        help=f"{sentence[0].lower()}{sentence[1:]}".rstrip("."),
        description=sentence,
        epilog=below or f"example:\n  sparsefit study {name} studies/NAME.toml",
    )
    parser.set_defaults(run=run, parser=parser, stopped="stopped")
    # An action below does not undo a --json that stands before it.
    json = Option("--json", "print JSON", read=None, default=argparse.SUPPRESS)
    for title, members in {"": (*options, json), **(groups or {})}.items():
        group = parser.add_argument_group(title) if title else parser
        for option in members:
            group.add_argument(*option.names, **option.settings)
    if not about:
        needed = (each for each in parser._actions if each.required)
        words = (f"{' '.join([*each.option_strings[:1], str(each.metavar)])}"
                 f"{' ...' * (each.nargs == '+')}" for each in needed)  # fmt: skip
        parser.usage = " ".join(["%(prog)s", *words, "[OPTION ...]"])
    return parser


def print_help(args: argparse.Namespace) -> Reply:
    """Print the help of a verb that was given without an action."""
    text = args.parser.format_help().rstrip("\n")
    return Reply({"help": text}, [text])


def key_value(text: str) -> tuple[str, Any]:
    """An argparse type: `key=value`, the value a scalar of TOML, or text without quotes."""
    key, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not key:
        raise argparse.ArgumentTypeError(f'"{text}" is not key=value')
    try:
        parsed = tomllib.loads(f"value = {value}")
    except ValueError:  # no TOML, or an integer of more than 4300 digits
        return key, value
    scalar = len(parsed) == 1 and isinstance(parsed["value"], bool | int | float | str)
    return key, parsed["value"] if scalar else value


PAIRS: dict[str, Any] = {"action": "append", "default": []}
SETTING = Option(
    "--setting", "setting of the back-end; may be repeated", "KEY=VALUE", key_value, **PAIRS
)  # fmt: skip
RESULTS = Option(
    "--results", "folder of the results of all studies; default: results beside the study file",
    "FOLDER",
)  # fmt: skip
FORCE = Option("--force", "overwrite an existing file", read=None)
