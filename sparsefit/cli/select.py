"""`sparsefit select`: from a finished study to one estimator."""

from __future__ import annotations

import argparse

from sparsefit.cli.parser import Verbs, number, verb

EXAMPLE = """\
  sparsefit select studies/NAME.toml
  sparsefit select studies/NAME.toml --max-failure-rate 0.02 --max-seconds 0.5
  sparsefit estimate flight.csv --estimator estimator.json
"""


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verb(
        verbs,
        "select",
        run,
        summary="choose one estimator from the cases of a finished study, and write it",
        example=EXAMPLE,
    )
    parser.add_argument("study", metavar="STUDY", help="study file, .toml")


def run(args: argparse.Namespace) -> int:
    """Choose, write, and show the evidence."""
    raise NotImplementedError
