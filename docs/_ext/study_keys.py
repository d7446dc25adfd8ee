"""Directives that write what the package itself knows: keys, settings, measures, comparisons."""

from __future__ import annotations

import inspect

import key_tables
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from written import escaped, parsed

from sparsefit import backends
from sparsefit.study.evidence.answers import ANSWERS
from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.evidence.summary import SUMMARY_WORDS
from sparsefit.study.evidence.tables import TABLES
from sparsefit.study.report.figures import FIGURES


class StudyKeys(SphinxDirective):
    """The keys of one section of a study file."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        self.env.note_dependency(str(key_tables.MEANINGS))
        try:
            key_tables.checked()
            return parsed(self, key_tables.table(self.arguments[0]))
        except (KeyError, ValueError) as error:
            raise self.error(str(error)) from None


class BackendSettings(SphinxDirective):
    """Every back-end: what it minimises, in its own words, and its settings."""

    def run(self) -> list[nodes.Node]:
        lines: list[str] = []
        for name in (*backends.BACKENDS, *backends.PUBLIC):
            kind = backends.load(name)
            lines += [f"### `{name}`", "", "````{eval-rst}"]
            lines += [*escaped(inspect.getdoc(kind) or "").splitlines(), "````", ""]
            keys = key_tables.settings(name)
            lines += [f"Certificate: {kind.certificate_kind.replace('_', ' ')}.", ""]
            if keys:
                lines += ["| setting | may be | default |", "|---|---|---|"]
                lines += [f"| `{key.name}` | {key.kind} | {key.default or '–'} |" for key in keys]
            lines.append("")
        return parsed(self, lines)


class Shown(SphinxDirective):
    """The names that [outputs] may hold: of tables, figures, answers, summaries or measures."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        kinds = {"tables": TABLES, "figures": FIGURES, "answers": ANSWERS}
        asked = self.arguments[0]
        if asked in kinds:
            kind = kinds[asked]
            return parsed(
                self,
                [
                    f"Names: {_code(kind.named)}.",
                    "",
                    f"Comparisons (`compare = ...`): {_code(kind.compares)}.",
                ],
            )
        if asked == "summaries":
            return parsed(self, [f"{_code(SUMMARY_WORDS)}."])
        lines = ["| measure | what it is | told by | a failure is |", "|---|---|---|---|"]
        for measure in MEASURES.values():
            words = measure.noun.replace("|", "\\|")
            unit = f" [{measure.unit}]" if measure.unit else ""
            lines.append(
                f"| `{measure.name}` | {words}{unit} | {measure.summary} | {measure.failure} |"
            )
        return parsed(self, lines)


def _code(names: object) -> str:
    return ", ".join(f"`{name}`" for name in names)  # type: ignore[attr-defined]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("study-keys", StudyKeys)
    app.add_directive("backend-settings", BackendSettings)
    app.add_directive("study-names", Shown)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
