"""`sparsefit study compare` and `sparsefit study merge`: several runs of one study."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from sparsefit.cli.output import check_folder, print_json, table_record, terminal_width
from sparsefit.cli.parser import Verbs, add_results, number, verb
from sparsefit.errors import non_negative

if TYPE_CHECKING:
    import pandas as pd

    from sparsefit.study.evidence.compared import Compared
    from sparsefit.study.evidence.solver_compared import SolversCompared
    from sparsefit.study.evidence.table import Table
    from sparsefit.study.run.merge import Part

COMPARE = """\
  sparsefit study compare results-0.2/table2 results/table2
  sparsefit study compare old/table2 studies/table2.toml --fail-on worse -o changes
"""
MERGE = """\
  sparsefit study run studies/table2.toml --only lasso          # on one machine
  sparsefit study run studies/table2.toml --only stlsq          # on another
  sparsefit study merge studies/table2.toml copied/table2
"""
FAIL_ON = ("changed", "worse", "never")


def add(actions: Verbs) -> None:
    """Declare both actions of `sparsefit study`."""
    compare_ = verb(
        actions, "compare", compare, example=COMPARE,
        summary="hold two runs of a study against each other, case by case",
    )  # fmt: skip
    for name in ("first", "second"):
        words = f"the {name} run: a results folder, or a study file whose results are there"
        compare_.add_argument(name, metavar=name.upper(), help=words)
    add_results(compare_)
    compare_.add_argument(
        "--tolerance", type=number(), default=1e-6, metavar="SHARE",
        help="a number that changed by less is the same; default: 1e-6 of itself",
    )  # fmt: skip
    compare_.add_argument(
        "--fail-on", choices=FAIL_ON, default="changed",
        help="exit code 1 when anything changed (default), when it became worse, or never",
    )  # fmt: skip
    compare_.add_argument(
        "-o", "--output", metavar="FOLDER", help="write tables and a picture there"
    )
    compare_.add_argument("--json", action="store_true", help="print JSON")
    merge_ = verb(
        actions, "merge", merge, example=MERGE,
        summary="bring parts of a study together that were run in several places",
    )  # fmt: skip
    merge_.add_argument("study", metavar="STUDY", help="study file, .toml")
    merge_.add_argument("parts", metavar="FOLDER", nargs="+", help="results folder of a part")
    add_results(merge_)
    merge_.add_argument(
        "--keep-first", action="store_true",
        help="where parts differ in a case keep the row that is there, or the first part's",
    )  # fmt: skip
    merge_.add_argument("--json", action="store_true", help="print JSON")


def compare(args: argparse.Namespace) -> int:
    """Show what changed; 1 where that is more than was asked for."""
    from sparsefit.study.evidence.compared import changes_table, compared, effects_table, worse
    from sparsefit.study.evidence.solver_compared import (
        solver_changes,
        solver_effects,
        solvers_compared,
        solvers_worse,
    )
    from sparsefit.study.report.comparison import write_comparison
    from sparsefit.study.report.render import to_text

    tolerance = non_negative("--tolerance", args.tolerance)
    folder = None if args.output is None else check_folder(args.output, own="comparison.md")
    names = (args.first, args.second)
    first, second = (_cases(name, args.results) for name in names)
    both: Compared | SolversCompared
    if {"solver", "cpu"} <= set(first.columns) & set(second.columns):
        both = solvers = solvers_compared(first, second, names)
        tables = (solver_effects(solvers), solver_changes(solvers))
        became_worse = solvers_worse(solvers, tables[0])
    else:
        both = flights = compared(first, second, names, tolerance)
        tables = (effects_table(flights), changes_table(flights))
        became_worse = worse(flights, tables[0])
    written = write_comparison(both, tables, folder) if folder else []
    if args.json:
        print_json(_record(both, tables, [str(path) for path in written]))
    else:
        shown = [to_text(one, width=terminal_width()) for one in tables if one.visible_rows]
        print("\n".join([*shown, both.sentence, *(f"written: {path}" for path in written[-1:])]))
    differs = bool(both.changed.any()) or any(both.only)
    if args.fail_on == "worse":
        return int(became_worse)
    return int(differs and args.fail_on == "changed")


def _cases(name: str, results: str) -> pd.DataFrame:
    """The rows of a results folder, or of a study file by its results."""
    from sparsefit.study.run.store import read_cases
    from sparsefit.study.spec.load import load_study

    if Path(name).is_dir():
        return read_cases(name)
    return read_cases(Path(results) / load_study(name).name)


def _record(
    both: Compared | SolversCompared, tables: tuple[Table, Table], written: list[str]
) -> dict[str, object]:
    import numpy as np

    from sparsefit.codec import finite_or_none

    record: dict[str, object] = {
        "first": both.names[0],
        "second": both.names[1],
        "cases": len(both.change),
        "changed": int(both.changed.sum()),
        "changed_status": int(both.restated.sum()),
        "only_first": both.only[0],
        "only_second": both.only[1],
        "largest_change": float(np.nanmax(both.change, initial=0.0)),
        "effects": table_record(tables[0]),
        "changes": table_record(tables[1]),
        "written": written,
    }
    cleaned: dict[str, object] = finite_or_none(record)
    return cleaned


def merge(args: argparse.Namespace) -> int:
    """Take what the parts hold; 0 also where cases are still missing, which is said."""
    from sparsefit.study.report.kind_pages import pages_of
    from sparsefit.study.run.merge import merge as merged_of
    from sparsefit.study.run.store import read_cases
    from sparsefit.study.spec.load import load_study

    study = load_study(args.study)
    pages = pages_of(study)
    pages.check()
    merged = merged_of(study, args.results, args.parts, keep_first=args.keep_first)
    if merged.finished:
        pages.write(args.results, read_cases(merged.folder))
    if args.json:
        told = [
            {
                "folder": str(part.folder),
                "rows": part.rows,
                "taken": part.taken,
                "alike": part.alike,
                "other": part.other,
            }
            for part in merged.parts
        ]
        counted = {"planned": merged.planned, "done": merged.done, "parts": told}
        print_json({"study": study.name, "folder": str(merged.folder), **counted})
        return 0
    for part in merged.parts:
        print(f"{part.folder}: {part.taken} of its {part.rows} rows were new{_beside(part)}")
    left = merged.planned - merged.done
    state = (
        "finished" if merged.finished else f"{left} left to run: sparsefit study run {args.study}"
    )
    print(f"{merged.folder}: {merged.done} of {merged.planned} cases, {state}")
    return 0


def _beside(part: Part) -> str:
    """How many rows were there already, and said the same or not."""
    counts = ((part.alike, "alike"), (part.other, "different and left out"))
    return "".join(f", {count} {words}" for count, words in counts if count)
