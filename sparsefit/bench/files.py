"""The files of a benchmark under results/solvers/: tables, picture, README, manifest."""

from __future__ import annotations

import json
import platform
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from sparsefit.bench.figure import time_against_gap
from sparsefit.bench.report import TITLES, tables
from sparsefit.bench.result import BenchResult
from sparsefit.study.report.drawing import to_png, to_svg
from sparsefit.study.report.render import to_csv, to_latex, to_markdown
from sparsefit.study.run.manifest import git_commit, versions

FOLDER = "solvers"
PEERS = ("scikit-learn", "celer", "skglm", "spams-bin", "pysindy", "numba")
IN_README = ("targets", "times", "beside", "scaling")


def write(result: BenchResult, results_dir: Path | str) -> Path:
    """Write everything a reader wants to see, and return the folder."""
    folder = Path(results_dir) / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for name, found in tables(result).items():
        pieces = {
            "md": "\n".join(map(to_markdown, found)),
            "tex": "\n".join(to_latex(t, label=f"tab:{name}-{i}") for i, t in enumerate(found)),
            "csv": "\n".join(map(to_csv, found)),
        }
        for suffix, text in pieces.items():
            if (name, suffix) not in (("runs", "md"), ("runs", "tex")):
                (folder / f"{name}.{suffix}").write_text(text, encoding="utf-8")
    figure = time_against_gap(result)
    (folder / "times.svg").write_bytes(to_svg(figure))
    (folder / "times.png").write_bytes(to_png(figure))
    (folder / "README.md").write_text(_readme(result), encoding="utf-8")
    text = json.dumps(_manifest(result), indent=2) + "\n"
    (folder / "manifest.json").write_text(text, encoding="utf-8")
    return folder


def _readme(result: BenchResult) -> str:
    sizes = ", ".join(
        f"{s.name} (m = {s.samples}, k = {s.columns}, rank {s.rank})" for s in result.sizes
    )
    quick = "**A quick run: small problems, no figures to quote.**\n\n" if result.quick else ""
    found = tables(result)
    body = "\n".join(to_markdown(table) for name in IN_README for table in found[name])
    forms = "\n".join(f"- {c.name}: {c.form}" for c in result.contenders)
    absent = "\n".join(f"- {name}: {reason}" for name, reason in result.absent.items())
    return (
        "# Solvers and peers\n\nWritten by `sparsefit bench`; do not edit.\n\n"
        f"{quick}Problems: {sizes}.\n\n![time against gap](times.svg)\n\n"
        "Large marker: median over the problems; small ones: single runs. A line ends where half "
        f"of the problems do not reach the gap. Panels: {'; '.join(TITLES.values())}.\n\n"
        f"{body}\nTime to gaps of 1e-4, 1e-6 and 1e-8: [gaps.md](gaps.md). Every run: "
        f"[runs.csv](runs.csv).\n\n## Forms\n\n{forms}\n\n## Not here\n\n{absent}\n"
    )


def _manifest(result: BenchResult) -> dict[str, object]:
    return {
        "benchmark": FOLDER,
        "quick": result.quick,
        "repeats": result.repeats,
        "points": result.points,
        "problems": list(result.problems),
        "absent": dict(result.absent),
        "wall_seconds": round(result.seconds, 3),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {**versions(), **{name: _version(name) for name in PEERS}},
        "platform": platform.platform(),
        "machine": platform.machine(),
        "git_commit": git_commit(),
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
