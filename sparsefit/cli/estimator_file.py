"""The estimator that options or a file describe."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from sparsefit.cli.options import PAIRS, SETTING, Option, key_value
from sparsefit.errors import InputError, told_with

if TYPE_CHECKING:
    from sparsefit.estimator.estimator import Estimator

OPTIONS = {  # the dotted key of an estimator: the option that sets it
    "library.lower": Option(
        "--grid-lower", "least length scale sought; default: 1 m", "m", float),
    "library.upper": Option("--grid-upper", "largest one; default: 12 m", "m", float),
    "library.step": Option("--grid-step", "between candidates; default: 0.2 m", "m", float),
    "library.unknown": Option(
        "--unknown", "estimated with the flow: response_time, drag, thrust_scale, "
        "thrust_acceleration, wind", "NAME", extra={"nargs": "+"}),
    "free": Option(
        "--free", "measured with the flow, as a misfit names it: latency, velocity_scale, lag ...; "
        "auto: whatever is found", "NAME", extra={"nargs": "+"}),
    "backend.name": Option(
        "--backend", "that picks the candidates; default: group-lasso", "NAME"),
}  # fmt: skip
SET = Option(
    "--set", "any other key of [derivative], [library] or [readout] of a study file, as "
    "library.family=waves; repeat it for more than one", "SECTION.KEY=VALUE", key_value, PAIRS,
)  # fmt: skip
ESTIMATOR = Option("--estimator", "estimator.json, as written by sparsefit select", "FILE")
ALL = (ESTIMATOR, *OPTIONS.values(), SETTING, SET)


def estimator_of(args: argparse.Namespace) -> Estimator:
    """The estimator of the options, or of the file that `--estimator` names.

    Raises:
        InputError: with the option, or with the file and its key, that is wrong.
    """
    from sparsefit.codec import Place
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.estimator.saved import parts_of
    from sparsefit.model import LengthScaleGrid

    given = [option for option in ALL[1:] if getattr(args, option.dest) not in (None, [])]
    if args.estimator is not None:
        if given:
            first = given[0].flags
            raise InputError(f"{first} and --estimator cannot both be given; drop one")
        return read_estimator(args.estimator)
    values = {key: getattr(args, item.dest) for key, item in OPTIONS.items() if item in given}
    values |= {f"backend.{key}": value for key, value in args.setting} | dict(args.set)

    class TypedPlace(Place):
        def error(self, problem: str) -> InputError:
            key = f"{self.section}.{self.key}".strip(".").replace("library.grid.", "library.")
            option = OPTIONS[key].flags if key in OPTIONS else f"--set {key}"
            return InputError(f"{option} {problem}" if self.key else problem)

    record: dict[str, Any] = {"library": {}, "backend": {"name": "group-lasso"}}
    grid: dict[str, Any] = {}
    for dotted, value in values.items():
        section, _, key = dotted.rpartition(".")
        of_grid = section == "library" and hasattr(LengthScaleGrid, key)
        place = grid if of_grid else record.setdefault(section, {}) if section else record
        place[key] = value
    record["library"]["grid"] = grid
    if record.get("free") == ["auto"]:
        record["free"] = "auto"
    return Estimator(**parts_of(record, TypedPlace("")))


def read_estimator(path: str) -> Estimator:
    """The estimator of a file. Raises InputError with the name of the file on anything else."""
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.whole_file import read_whole

    text = read_whole(path, most=16_000_000).decode(errors="replace")
    with told_with(path):
        return Estimator.from_json(text)
