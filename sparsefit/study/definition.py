"""A study file, checked and resolved into frozen records: one schema for both kinds of study.

    definition = read_definition("studies/smoke.toml")

A study of flights asks its question of every flight by every reading and back-end; one of problems
(``kind = "problems"``, or ``"solvers"`` for times to a certificate alone) of every regression
problem by every solver. All that is read here is refused by file, section and key.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from sparsefit.codec import Place, build
from sparsefit.errors import InputError
from sparsefit.study import crossing, keys, schema
from sparsefit.study.contenders import ProblemDesign, read_problem_design
from sparsefit.study.crossing import FlightDesign
from sparsefit.study.draw import Logs
from sparsefit.study.schema import Section, canonical_json, read_toml


@dataclass(frozen=True, eq=False)
class Definition:
    """A study file, checked and resolved.

    hash: of all that its cases depend on; on_board: whether every estimator is flown sample by
    sample, as it would be exported.
    """

    path: str
    name: str
    kind: str
    question: str
    seed: int
    hash: str
    rules: keys.RunRule
    outputs: keys.Outputs
    selection: keys.SelectionRule
    design: FlightDesign | ProblemDesign
    on_board: bool = False

    @property
    def flights(self) -> FlightDesign:
        """The design of a study of flights."""
        if not isinstance(self.design, FlightDesign):
            words = "is a study of regression problems, and flies nothing"
            raise InputError(f"{self.path}: {words}: give a study of flights")
        return self.design


def read_definition(path: str | Path) -> Definition:
    """The study that a TOML file describes.

    Raises:
        InputError: with the file, the section and the key (or the line) of the first fault.
    """
    return definition_of(read_toml(path), str(path))


def definition_of(document: Section, path: str) -> Definition:
    """The study of these tables; files that it names lie beside ``path``."""
    place = Place(path)
    heading, _ = schema.taken(keys.Heading, document, place)
    flown = heading.kind == "flights"
    kind: type[keys.FlightFile | keys.ProblemFile] = keys.FlightFile if flown else keys.ProblemFile
    file = build(kind, document, place)
    outputs = file.outputs
    if outputs.script and not (Path(path).parent / outputs.script).is_file():
        words = f'"{outputs.script}": no such file beside {Path(path).name}'
        raise place.within("outputs").at("script").error(words)
    words = str((outputs.tables, outputs.figures, outputs.headline))
    if flown and not file.run.prediction_flights and "prediction-error" in words:
        # All its cases would count as failures.
        words = "missing: prediction-error needs other flights to predict along, 2 say"
        raise place.within("run").at("prediction_flights").error(words)
    design: FlightDesign | ProblemDesign
    if isinstance(file, keys.FlightFile):
        design = crossing.read_flight_design(file, place)
    else:
        design = read_problem_design(file, place)
    return Definition(
        path=path,
        name=file.name,
        kind="flights" if flown else "problems",
        question=file.question,
        seed=file.seed,
        hash=hashlib.sha256(canonical_json(_content(document, design)).encode()).hexdigest(),
        rules=file.run,
        outputs=outputs,
        selection=file.select,
        design=design,
    )


def _content(document: Section, design: FlightDesign | ProblemDesign) -> object:
    """All that the cases depend on: no comments, questions or words, but the files that are read.

    Of protocols and sweeps, keys bare or in quotes are one content.
    """
    shown_only = ("kind", "question", "select", "outputs")
    content: dict[str, object] = {k: v for k, v in document.items() if k not in shown_only}
    if isinstance(design, ProblemDesign):
        return [content, [source.identity for source in design.problems]]
    listed = [{"name": name, **overrides} for name, overrides in design.protocols.items()]
    flat = {"sweep": design.sweep, "protocols": listed}
    rules = (cell.setup.flights for cell in design.cells)
    logs = [piece.digest for each in rules if isinstance(each, Logs) for piece in each.pieces]
    content |= {name: flat[name] for name in flat if name in document}
    return content | ({"logs": list(dict.fromkeys(logs))} if logs else {})
