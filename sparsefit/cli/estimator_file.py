"""The estimator that options or a file describe."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from sparsefit.cli.options import SETTING, Option, collected, number, whole
from sparsefit.errors import InputError, told_with

if TYPE_CHECKING:
    from sparsefit.estimator.estimator import Estimator

LONGEST = 16_000_000  # bytes of an estimator file
METRES = number("m")
OPTIONS = {  # (section, key) of an estimator's record: the option that sets it
    ("derivative", "method"): Option(
        "--derivative", "auto (default), forward, central, midpoint, savgol or weak", "METHOD"),
    ("derivative", "window"): Option("--window", "of savgol (5 samples) or weak", "N", whole),
    ("derivative", "order"): Option("--order", "of savgol (4) or weak (8)", "N", whole),
    ("derivative", "repair"): Option(
        "--no-repair", "leave outliers, gaps and uneven steps as they are",
        read=None, extra={"action": "store_false", "default": None}),
    ("library.grid", "lower"): Option(
        "--grid-lower", "least length scale sought; default: 1 m", "M", METRES),
    ("library.grid", "upper"): Option("--grid-upper", "largest one; default: 12 m", "M", METRES),
    ("library.grid", "step"): Option(
        "--grid-step", "between candidates; default: 0.2 m", "M", METRES),
    ("library", "family"): Option(
        "--family", "of the library: cells (default) or waves", "NAME"),
    ("library", "groups"): Option("--groups", "of waves: wave (default), ring or nested", "NAME"),
    ("library", "target"): Option(
        "--target", "flow-velocity (default), acceleration or state-derivative", "NAME"),
    ("library", "unknown"): Option(
        "--unknown", "estimated with the flow: response_time, drag, thrust_scale, "
        "thrust_acceleration, wind", "NAME", extra={"nargs": "+"}),
    ("readout", "length_scale"): Option(
        "--length-scale-readout", "group-norm (default), absolute-sum or signed-sum", "NAME"),
    ("readout", "mean_velocity"): Option(
        "--mean-velocity-readout", "rms (default) or paper", "NAME"),
    ("readout", "refine"): Option(
        "--refine", "ladder (default: off the grid, with shape, heading and drift), "
        "variable-projection (off the grid, steady square cells along the axes only) or none "
        "(the candidate itself)", "NAME"),
    ("readout", "scales"): Option(
        "--scales", "one (default) or several: all cellular flows that are superposed, as the "
        "back-end proposes them", "NAME"),
    ("backend", "name"): Option(
        "--backend", "that picks the candidates; default: group-lasso", "NAME"),
    ("backend", ""): SETTING,
    ("", "free"): Option(
        "--free", "measured with the flow, as a misfit names it: latency, velocity_scale, lag ...; "
        "auto: whatever is found", "NAME", extra={"nargs": "+"}),
}  # fmt: skip
ESTIMATOR = Option("--estimator", "estimator.json, as written by sparsefit select", "FILE")


def estimator_of(args: argparse.Namespace) -> Estimator:
    """The estimator of the options, or of the file that `--estimator` names.

    Raises:
        InputError: with the option, or with the file and its key, that is wrong.
    """
    names = {place: option.flags.removeprefix("--") for place, option in OPTIONS.items()}
    values = {
        place: value
        for place, name in names.items()
        if (value := getattr(args, name.replace("-", "_"))) is not None
    }
    if args.estimator is not None:
        if values:
            first = names[next(iter(values))]
            raise InputError(f"--{first} and --estimator cannot both be given; drop one")
        return read_estimator(args.estimator)
    return _built(values)


def _built(values: dict[tuple[str, str], Any]) -> Estimator:
    """The estimator with the given values by section and key, and defaults for the others."""
    from sparsefit.codec import Place
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.estimator.saved import parts_of

    class TypedPlace(Place):
        def error(self, problem: str) -> InputError:
            option = OPTIONS.get((self.section, self.key))
            return InputError(f"{option.flags} {problem}" if option else problem)

    # A window or an order belongs to savgol: the automatic choice has neither.
    if {("derivative", "window"), ("derivative", "order")} & set(values):
        values.setdefault(("derivative", "method"), "savgol")
    settings = collected(values.pop(("backend", ""), None))
    free = values.pop(("", "free"), [])
    record: dict[str, Any] = {"library": {}, "backend": {"name": "group-lasso"}}
    for (section, key), value in values.items():
        record.setdefault(section, {})[key] = value
    record["library"]["grid"] = record.pop("library.grid", {})
    record["backend"] |= settings
    record["free"] = "auto" if free == ["auto"] else free
    return Estimator(**parts_of(record, TypedPlace("")))


def read_estimator(path: str) -> Estimator:
    """The estimator of a file. Raises InputError with the name of the file on anything else."""
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.whole_file import read_whole

    try:
        text = read_whole(path, most=LONGEST).decode()
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text; give a file of sparsefit select") from None
    with told_with(path):
        return Estimator.from_json(text)
