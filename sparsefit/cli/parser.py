"""How every verb is declared, and how numbers and settings are read from the command line."""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
from collections.abc import Callable, Iterable
from typing import NoReturn, TypeAlias

from sparsefit.errors import InputError, one_line

Verbs: TypeAlias = "argparse._SubParsersAction[Parser]"
Value: TypeAlias = bool | int | float | str
Run: TypeAlias = Callable[[argparse.Namespace], int]


class Parser(argparse.ArgumentParser):
    """argparse that says what is wrong on one line, and takes `-1e-3` for a number."""

    def __init__(
        self,
        prog: str | None = None,
        *,
        description: str = "",
        epilog: str = "",
        help: str = "",
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

    def error(self, message: str) -> NoReturn:
        """Exit 2 with the cause and where the remedy stands."""
        print(f"sparsefit: error: {one_line(message)}; see {self.prog} --help", file=sys.stderr)
        sys.exit(2)


def verb(verbs: Verbs, name: str, run: Run, *, summary: str, example: str) -> Parser:
    """Declare a verb; `example` is shown under its options."""
    parser = verbs.add_parser(
        name, help=summary, description=_sentence(summary), epilog=f"example:\n{example}"
    )
    parser.set_defaults(run=run, parser=parser, stopped="stopped")
    return parser


def _sentence(summary: str) -> str:
    return f"{summary[0].upper()}{summary[1:]}."


def number(unit: str = "") -> Callable[[str], float]:
    """An argparse type: a plain number; `4 m` is told to drop the unit."""

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


def add_setting(parser: argparse._ActionsContainer) -> None:
    """Declare `--setting KEY=VALUE`, of which `collected` makes the settings of a back-end."""
    parser.add_argument(
        "--setting",
        type=key_value,
        action="append",
        metavar="KEY=VALUE",
        help="setting of the back-end; repeat it for more than one",
    )


def add_results(parser: argparse.ArgumentParser) -> None:
    """Declare `--results FOLDER`, where the results of all studies are."""
    parser.add_argument(
        "--results",
        default="results",
        metavar="FOLDER",
        help="folder of the results of all studies; default: results",
    )


def scalar(text: str) -> Value:
    """`0.1`, `true`, `"text"` as in TOML; anything else is text without quotes."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    except ValueError:  # Python reads no decimal integer of more than 4300 digits
        raise argparse.ArgumentTypeError("more than 4300 digits are no number") from None
    value = parsed["value"]
    return value if len(parsed) == 1 and isinstance(value, bool | int | float | str) else text


def collected(pairs: Iterable[tuple[str, Value]] | None) -> dict[str, Value]:
    """Settings by key, none where the option was not given; InputError on one given twice."""
    settings: dict[str, Value] = {}
    for key, value in pairs or ():
        if key in settings:
            raise InputError(f"setting {key} is given twice; keep one")
        settings[key] = value
    return settings


def shown(settings: dict[str, object]) -> str:
    """Settings as they are typed: `alpha_fraction=0.1 separate=false`."""
    return " ".join(f"{key}={_typed(value)}" for key, value in settings.items())


def _typed(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) or value is None else str(value)
