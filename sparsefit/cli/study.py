"""`sparsefit study`: check, plan, run and read a study."""

from __future__ import annotations

import argparse

import sparsefit.cli.study_compare as study_compare
import sparsefit.cli.study_plan as study_plan
import sparsefit.cli.study_read as study_read
import sparsefit.cli.study_run as study_run
from sparsefit.cli.parser import Parser, Run, Verbs, add_results, verb

EXAMPLE = """\
  sparsefit study check studies/NAME.toml
  sparsefit study run studies/NAME.toml --processes 4
  sparsefit study show studies/NAME.toml
"""
SUMMARIES: dict[str, tuple[str, bool]] = {  # action -> what it does, whether it reads results
    "check": ("check a study file, and say on one line what it plans", False),
    "plan": ("count what a study will do and write", False),
    "run": ("run a study, or go on with one that was stopped", True),
    "status": ("tell how far a study is, also while it runs", True),
    "errors": ("list the cases that are not ok, grouped by reason", True),
    "show": ("print the tables of a study, also unfinished; or run one case again", True),
    "report": ("write tables, figures and report again from the stored cases", True),
}
HAVE_JSON = ("check", "plan", "run", "status", "errors", "show")


def add(verbs: Verbs) -> None:
    """Declare the verb and its actions."""
    parser = verb(
        verbs,
        "study",
        _no_action,
        summary="check, plan, run and read a study",
        example=EXAMPLE,
    )
    actions = parser.add_subparsers(metavar="ACTION", title="actions", dest="action", required=True)
    runs: dict[str, Run] = {**study_plan.RUNS, "run": study_run.run, **study_read.RUNS}
    for name, (summary, reads) in SUMMARIES.items():
        example = f"  sparsefit study {name} studies/NAME.toml\n"
        _add_common(
            verb(actions, name, runs[name], summary=summary, example=example),
            name,
            reads=reads,
        )
    study_run.add_options(actions.choices["run"])
    study_read.add_options(actions.choices["show"])
    study_compare.add(actions)


def _add_common(parser: Parser, name: str, *, reads: bool) -> None:
    parser.add_argument("study", metavar="STUDY", help="study file, .toml")
    if reads:
        add_results(parser)
    if name in HAVE_JSON:
        parser.add_argument("--json", action="store_true", help="print JSON")


def _no_action(args: argparse.Namespace) -> int:
    raise AssertionError("argparse asks for an action")
