"""The command line, from the parsers themselves: `{verb} estimate`."""

from __future__ import annotations

import argparse

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from written import parsed

from sparsefit.cli import parser


def parsers() -> dict[str, argparse.ArgumentParser]:
    """Every verb, and the actions of those that have some, by what is typed: `study run`."""
    return dict(_below("", parser()))


def _below(above: str, one: argparse.ArgumentParser) -> list[tuple[str, argparse.ArgumentParser]]:
    found: list[tuple[str, argparse.ArgumentParser]] = []
    for action in one._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, inner in action.choices.items():
                typed = f"{above} {name}".strip()
                found += [(typed, inner), *_below(typed, inner)]
    return found


class Commands(SphinxDirective):
    """Every verb with its options and an example."""

    def run(self) -> list[nodes.Node]:
        lines: list[str] = []
        for typed, one in parsers().items():
            level = "###" if " " in typed else "##"
            lines += [f"{level} sparsefit {typed}", "", one.description or "", ""]
            lines += ["```text", *_usage(one), "```", ""]
            for group in one._action_groups:
                actions = [a for a in group._group_actions if _told(a)]
                if actions:
                    lines += [f"| {group.title} | |", "|---|---|"]
                    lines += [f"| {_name(action)} | {_help(action)} |" for action in actions]
                    lines.append("")
            if one.epilog:
                lines += ["```text", *one.epilog.strip().splitlines(), "```", ""]
        return parsed(self, lines)


def _told(action: argparse.Action) -> bool:
    hidden = action.help == argparse.SUPPRESS or isinstance(action, argparse._HelpAction)
    return not hidden and not isinstance(action, argparse._SubParsersAction)


def _usage(one: argparse.ArgumentParser) -> list[str]:
    formatter = argparse.HelpFormatter(one.prog, width=84)
    formatter.add_usage(one.usage, one._actions, one._mutually_exclusive_groups, "")
    return formatter.format_help().strip().splitlines()


def _name(action: argparse.Action) -> str:
    shown = action.metavar or (action.dest.upper() if action.nargs != 0 else "")
    value = " ".join(shown) if isinstance(shown, tuple) else str(shown)
    if not action.option_strings:
        return f"`{value}`"
    several = " ..." if action.nargs in ("+", "*") else ""
    value = "" if action.nargs == 0 else f" {value}{several}"
    return ", ".join(f"`{option}{value}`" for option in action.option_strings)


def _help(action: argparse.Action) -> str:
    text = (action.help or "").replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;")
    return text % {**vars(action), "prog": ""} if "%(" in text else text.replace("%%", "%")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
