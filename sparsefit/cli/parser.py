"""Names that the verbs on studies still take from here; they move with their room."""

from __future__ import annotations

import argparse

from sparsefit.cli.options import (
    RESULTS,
    SETTING,
    Parser,
    Run,
    Verbs,
    collected,
    number,
    verb,
    whole,
)
from sparsefit.cli.terminal import typed as shown

__all__ = [
    "Parser",
    "Run",
    "Verbs",
    "add_results",
    "add_setting",
    "collected",
    "number",
    "shown",
    "verb",
    "whole",
]


def add_setting(parser: argparse._ActionsContainer) -> None:
    """Declare `--setting KEY=VALUE`, of which `collected` makes the settings of a back-end."""
    SETTING.declare(parser)


def add_results(parser: argparse.ArgumentParser) -> None:
    """Declare `--results FOLDER`, where the results of all studies are."""
    RESULTS.declare(parser)
    parser.set_defaults(results="results")
