"""Names that come from files, made harmless for Markdown and LaTeX."""

from __future__ import annotations

import re

_MARKDOWN = {"&": "&amp;", "<": "&lt;", ">": "&gt;"} | {sign: "\\" + sign for sign in "\\|`*~$"}
_TEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "|": r"\textbar{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    '"': "''",
    "–": "--",
    "—": "---",
    "…": r"\ldots{}",
    "×": r"$\times$",
    "±": r"$\pm$",
    "∞": r"$\infty$",
    "−": r"$-$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "→": r"$\rightarrow$",
    "²": r"$^2$",
    "³": r"$^3$",
    "°": r"$^\circ$",
    "�": "?",
} | {sign: "\\" + sign for sign in "&%$#_{}"}
_GREEK = (
    "αalpha βbeta γgamma δdelta εepsilon ζzeta ηeta θtheta κkappa λlambda μmu νnu ξxi πpi ρrho "
    "σsigma τtau φphi χchi ψpsi ωomega ΔDelta ΘTheta ΛLambda ΣSigma ΦPhi ΩOmega"
)
_TEX |= {letter: f"$\\{name}$" for letter, name in ((one[0], one[1:]) for one in _GREEK.split())}


def escape_markdown(text: str) -> str:
    """`text` so that a Markdown table cell shows it letter for letter."""
    escaped = "".join(_MARKDOWN.get(one, one) for one in text)
    escaped = re.sub(r"\](?=[(\[])", r"\\]", escaped)
    return re.sub(r"(?<!\w)_|_(?!\w)", r"\\_", escaped)


def escape_tex(text: str) -> str:
    """`text` so that LaTeX prints it letter for letter, Greek letters as mathematics."""
    return "".join(_TEX.get(one, one) for one in text)
