"""What `sparsefit estimate` is told of the estimator: options, or a file."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sparsefit.cli.parser import add_setting, collected, number, whole
from sparsefit.errors import InputError, told_with

if TYPE_CHECKING:
    from sparsefit.codec import Place
    from sparsefit.estimator.estimator import Estimator

LONGEST = 16_000_000  # bytes of an estimator file


@dataclass(frozen=True)
class Option:
    """An option, and where its value stands in an estimator's record.

    Args:
        section: of the record.
        key: in the section.
        help: what `--help` says of it.
        metavar: what stands for its value there.
        type: what reads the value.
        nargs: ``+`` where there may be several values.
    """

    section: str
    key: str
    help: str
    metavar: str = "NAME"
    type: Callable[[str], Any] = str
    nargs: str | None = None


METRES = number("m")
OPTIONS = {
    "derivative": Option(
        "derivative",
        "method",
        "auto (default), forward, central, midpoint, savgol or weak",
        "METHOD",
    ),
    "window": Option("derivative", "window", "of savgol (5 samples) or weak", "N", whole),
    "order": Option("derivative", "order", "of savgol (4) or weak (8)", "N", whole),
    "grid_lower": Option(
        "library.grid", "lower", "least length scale sought; default: 1 m", "M", METRES
    ),
    "grid_upper": Option("library.grid", "upper", "largest one; default: 12 m", "M", METRES),
    "grid_step": Option("library.grid", "step", "between candidates; default: 0.2 m", "M", METRES),
    "family": Option("library", "family", "of the library: cells (default), stream or waves"),
    "groups": Option("library", "groups", "of waves: wave (default), ring or nested"),
    "target": Option(
        "library", "target", "flow-velocity (default), acceleration or state-derivative"
    ),
    "unknown": Option(
        "library",
        "unknown",
        "estimated with the flow: response_time, drag, thrust_scale, thrust_acceleration, wind",
        nargs="+",
    ),
    "length_scale_readout": Option(
        "readout", "length_scale", "group-norm (default), absolute-sum or signed-sum"
    ),
    "mean_velocity_readout": Option("readout", "mean_velocity", "rms (default), peak or paper"),
    "refine": Option(
        "readout",
        "refine",
        "ladder (default: off the grid, with shape, heading and drift), variable-projection (off "
        "the grid, steady square cells along the axes only) or none (the candidate itself)",
    ),
    "scales": Option(
        "readout",
        "scales",
        "one (default) or several: all cellular flows that are superposed, as the back-end "
        "proposes them",
    ),
    "backend": Option("backend", "name", "that picks the candidates; default: group-lasso"),
}
BESIDE = {"no_repair": ("derivative", "repair"), "setting": ("backend", "")}  # of other kinds
PLACES = {name: (option.section, option.key) for name, option in OPTIONS.items()} | BESIDE


def add_estimator(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the estimator."""
    group = parser.add_argument_group("estimator")
    group.add_argument(
        "--estimator", metavar="FILE", help="estimator.json, as written by sparsefit select"
    )
    group.add_argument(
        "--no-repair",
        action="store_false",
        default=None,
        help="leave outliers, jumps, gaps, uneven and repeated samples as they are",
    )
    for name, option in OPTIONS.items():
        group.add_argument(
            _typed(name),
            type=option.type,
            nargs=option.nargs,
            metavar=option.metavar,
            help=option.help,
        )
    add_setting(group)


def estimator_of(args: argparse.Namespace) -> Estimator:
    """The estimator that the options say, or a file holds.

    Raises:
        InputError: naming the option, or the file and its key, that is none.
    """
    given = [name for name in PLACES if getattr(args, name) is not None]
    if args.estimator is None:
        return _built(args, given)
    if given:
        raise InputError(f"{_typed(given[0])} and --estimator cannot both be given; drop one")
    return read_estimator(args.estimator)


def _built(args: argparse.Namespace, given: list[str]) -> Estimator:
    """The estimator of the options that were given; for the others its defaults hold."""
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.estimator.saved import parts_of

    values = {PLACES[name]: getattr(args, name) for name in given if name != "setting"}
    # A window or an order is one of savgol: the automatic choice has none to be told.
    if not {"window", "order"}.isdisjoint(given):
        values.setdefault(("derivative", "method"), "savgol")
    record: dict[str, dict[str, object]] = {"library": {}, "backend": {"name": "group-lasso"}}
    for (section, key), value in values.items():
        record.setdefault(section, {})[key] = value
    record["library"]["grid"] = record.pop("library.grid", {})
    record["backend"] |= collected(args.setting)
    return Estimator(**parts_of(record, _place()))


def _place() -> Place:
    """Where a value stands on the command line: the option that gave it."""
    from sparsefit.codec import Place

    class Option(Place):
        def error(self, problem: str) -> InputError:
            names = {place: name for name, place in PLACES.items()}
            name = names.get((self.section, self.key))
            return InputError(f"{_typed(name)} {problem}" if name else problem)

    return Option("")


def _typed(option: str) -> str:
    return "--" + option.replace("_", "-")


def read_estimator(path: str) -> Estimator:
    """The estimator of a file. Raises InputError, which names the file, on anything else."""
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.whole_file import read_whole

    try:
        text = read_whole(path, most=LONGEST).decode()
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text; give a file of sparsefit select") from None
    with told_with(path):
        return Estimator.from_json(text)
