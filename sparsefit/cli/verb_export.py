"""`sparsefit export`: an estimator as C99 for the processor on board."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Literal

from sparsefit.cli.options import Option, Verbs, verb
from sparsefit.cli.terminal import Reply
from sparsefit.cli.verb_estimate import read_estimator
from sparsefit.errors import InputError, one_line
from sparsefit.whole_file import write_whole

OPTIONS = (
    Option("estimator", "estimator file, .json, as sparsefit select writes", "ESTIMATOR"),
    Option("--c", "folder to write", "DIR", required=True, dest="folder"),
    Option("--flight", "recorded flight that the test replays; default: a simulated one", "FILE"),
    Option("--float", "single precision in place of double", read=None),
    Option("--force", "write into DIR although it has files", read=None),
)


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    verb(verbs, "export", run, OPTIONS)


def run(args: argparse.Namespace) -> Reply:
    """Write an estimator as C99: no heap, bounded work, with a test that replays a flight.

    example:
      sparsefit export estimator.json --c flow
      sparsefit export estimator.json --c flow --float --flight flight.csv
      cmake -S flow -B flow/build && cmake --build flow/build && ctest --test-dir flow/build
    """
    from sparsefit.logs import read_flight
    from sparsefit.onboard.c_source import package

    folder = Path(args.folder)
    if not args.folder.strip():
        raise InputError("the name of the folder to write is empty; give one")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{args.folder} is a file; choose another name for the folder")
    if folder.is_dir() and any(folder.iterdir()) and not args.force:
        raise InputError(f"{args.folder} is not empty; add --force or choose another name")
    estimator = read_estimator(args.estimator)
    flight = None if args.flight is None else read_flight(args.flight)
    source = Path(args.estimator).name
    real: Literal["double", "float"] = "float" if args.float else "double"
    content = package(estimator, real, flight, source=source)
    for path, file in content.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        write_whole(folder / path, file)
    readme = content["README.md"].decode().splitlines()
    costs = [line[4:] for line in readme if line[4:8] in ("RAM ", "work", "    ")]
    files = [str(folder / path) for path in content]
    record = {"folder": args.folder, "number": real, "written": files}
    return Reply(record, [f"{one_line(args.folder)}: {', '.join(content)}", *costs])
