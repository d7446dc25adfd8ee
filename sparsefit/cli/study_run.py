"""`sparsefit study run`: run, show how far it is, and leave the report behind."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sparsefit.cli.output import duration, print_json
from sparsefit.cli.parser import Parser, whole

PLAIN_SECONDS = 5.0
STOPPED = "stopped; run the same command again to continue"
STOPPED_FRESH = "stopped; run the same command without --fresh to continue"


def add_options(parser: Parser) -> None:
    """Declare what only `run` has."""
    parser.set_defaults(stopped=STOPPED)
    parser.add_argument(
        "--processes", type=whole, metavar="N", help="default: one per processor of this machine"
    )
    parser.add_argument(
        "--fresh",
        action="store_const",
        const=True,
        default=False,
        help="start over, and drop the cases that are there",
    )


def run(args: argparse.Namespace) -> int:
    """Run to the end; write and print what came out."""
    from sparsefit.study import runner
    from sparsefit.study.spec import Study

    study = Study.load(args.study)
    if args.fresh:
        args.stopped = STOPPED_FRESH
    progress = Bar() if sys.stderr.isatty() else Lines()
    try:
        summary = runner.run(
            study,
            args.results,
            processes=args.processes,
            progress=progress,
            fresh=args.fresh,
        )
    finally:
        progress.close()
    args.stopped = "stopped while writing; sparsefit study report writes it again"
    return _tell(args, study, summary)
