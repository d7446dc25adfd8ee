"""Declarations of verbs and options, and the readers of the values that are typed for them."""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, NoReturn, TypeAlias

from sparsefit.errors import InputError, one_line, suggestion

Verbs: TypeAlias = "argparse._SubParsersAction[Parser]"
Value: TypeAlias = bool | int | float | str


class Reply(NamedTuple):
    """The outcome of a verb: a JSON-ready record, lines that say it, and the exit code."""

    record: Any
    lines: Iterable[str] = ()
    code: int = 0


Run: TypeAlias = Callable[[argparse.Namespace], Reply]


class Parser(argparse.ArgumentParser):
    """A parser that refuses in one line with the nearest name, and reads `-1e-3` as a number."""

    def __init__(
        self, prog: str | None = None, *, description: str = "", epilog: str = "", help: str = ""
    ) -> None:
        super().__init__(
            prog=prog,
            description=description,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        # Before Python 3.14 argparse takes -1e-3 for an option.
        self._negative_number_matcher = re.compile(
            r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$", re.IGNORECASE
        )

    def _check_value(self, action: argparse.Action, value: object) -> None:
        """Refuse a verb or choice that does not exist with the nearest one."""
        if action.choices is not None and value not in action.choices:
            name = action.metavar or action.dest.replace("_", "-")
            kind = name.lower() if isinstance(name, str) else action.dest
            self.error(
                f'unknown {kind} "{value}"{suggestion(str(value), map(str, action.choices))}'
            )

    def error(self, message: str) -> NoReturn:
        """Exit with code 2 after one line with the cause and where the remedy stands."""
        print(f"sparsefit: error: {one_line(message)}; see {self.prog} --help", file=sys.stderr)
        sys.exit(2)

    def unrecognized(self, words: Iterable[str]) -> NoReturn:
        """Exit with code 2 after one line with the options unknown here and the nearest one."""
        unknown = " ".join(words)
        first = unknown.split(" ")[0].partition("=")[0]
        near = suggestion(first, self._option_string_actions) if first.startswith("-") else ""
        near = near if "did you mean" in near else ""
        self.error(f"unrecognized arguments: {unknown}{near}")


@dataclass(frozen=True)
class Option:
    """An option of a verb, or a value without a flag.

    flags: names as typed, `--length-scale` or `-o --output`, separated by blanks; help: the
    sentence of `--help`; metavar: the placeholder of the value, several for several values; read:
    the argparse type of a value, None for a flag, which is True where it is given; extra: further
    arguments of `add_argument`.
    """

    flags: str
    help: str
    metavar: str = ""
    read: Callable[[str], Any] | None = str
    extra: Mapping[str, Any] | None = None

    @property
    def dest(self) -> str:
        """The name of the value among the arguments."""
        return self.flags.split()[-1].removeprefix("--").replace("-", "_")


def option_of(key: str, words: str, metavar: str, read: Callable[[str], Any] | None) -> Option:
    """The option of a key of a study file, with the words of the key."""
    sentence = words.replace("`", "").replace("%", "%%").removesuffix(" Needed.")
    extra = {"default": None} if read is None else None  # as a flag that was not given
    return Option(f"--{key.replace('_', '-')}", sentence, metavar, read, extra)


def declare(parser: argparse._ActionsContainer, options: Iterable[Option]) -> None:
    """Declare options in a parser or a group of one."""
    for option in options:
        settings: dict[str, Any] = {"help": option.help, **(option.extra or {})}
        if option.read is None:
            settings.setdefault("action", "store_true")
        else:
            names = tuple(option.metavar.split())
            settings["type"] = option.read
            if names:
                settings["metavar"] = names if len(names) > 1 else names[0]
            if len(names) > 1:
                settings["nargs"] = len(names)
        parser.add_argument(*option.flags.split(), **settings)


def verb(verbs: Verbs, name: str, run: Run, example: str, summary: str = "") -> Parser:
    """The parser of a verb; its help is the docstring of what runs it, the example stands below."""
    sentence = summary or (run.__doc__ or "").split("\n")[0].rstrip(".")
    parser = verbs.add_parser(
        name,
        help=f"{sentence[0].lower()}{sentence[1:]}",
        description=f"{sentence[0].upper()}{sentence[1:]}.",
        epilog=f"example:\n{example}",
    )
    parser.set_defaults(run=run, parser=parser, stopped="stopped")
    return parser


def print_help(args: argparse.Namespace) -> Reply:
    """Print the help of a verb that was given without an action."""
    return Reply({}, [args.parser.format_help().rstrip("\n")])


def number(unit: str = "") -> Callable[[str], float]:
    """An argparse type: a plain number; `4 m` is refused with the unit to drop."""

    def read(text: str) -> float:
        try:
            return float(text if "_" not in text else "")
        except ValueError:
            remedy = f"give it in {unit}, without the unit" if unit else "give a number"
            raise argparse.ArgumentTypeError(f'"{text}" is not a number; {remedy}') from None

    return read


def whole(text: str) -> int:
    """An argparse type: a whole number."""
    try:
        return int(text if "_" not in text else "")
    except ValueError:
        raise argparse.ArgumentTypeError(f'"{text}" is not a whole number') from None


def key_value(text: str) -> tuple[str, Value]:
    """An argparse type: `key=value`, the value a TOML number, true, false or text."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise argparse.ArgumentTypeError(f'"{text}" is not key=value')
    return key.strip(), scalar(value.strip())


def scalar(text: str) -> Value:
    """A scalar of TOML, `0.1`, `true` or `"text"`; anything else is text without quotes."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    except ValueError:  # Python reads no decimal integer of more than 4300 digits
        raise argparse.ArgumentTypeError("more than 4300 digits are no number") from None
    value = parsed["value"]
    return value if len(parsed) == 1 and isinstance(value, bool | int | float | str) else text


def collected(pairs: Iterable[tuple[str, Value]] | None) -> dict[str, Value]:
    """Settings by key, empty where the option was not given. Raises InputError on repeated keys."""
    settings: dict[str, Value] = {}
    for key, value in pairs or ():
        if key in settings:
            raise InputError(f"setting {key} is given twice; keep one")
        settings[key] = value
    return settings


SETTING = Option(
    "--setting", "setting of the back-end; repeat it for more than one", "KEY=VALUE", key_value,
    {"action": "append"},
)  # fmt: skip
RESULTS = Option(
    "--results", "folder of the results of all studies; default: results beside the study file",
    "FOLDER",
)  # fmt: skip
JSON = Option("--json", "print JSON", read=None)
FORCE = Option("--force", "overwrite what is written there", read=None)
