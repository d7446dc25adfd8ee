"""SVG as every machine writes it: hundredths of a point, names of parts in order."""

from __future__ import annotations

import re

NUMBERS = re.compile(r"<!--.*?-->|scale\([^)]*\)|-?\d+\.\d{3,}", re.DOTALL)
# What Matplotlib names by a hash of unrounded numbers: clips, markers, hatches, images.
HASHED = re.compile(r"\b([a-zA-Z]+)([0-9a-f]{10})\b")
DEFINED = re.compile(r'\bid="([a-zA-Z]+[0-9a-f]{10})"')


def settled(svg: str) -> str:
    """Return an SVG of Matplotlib whose last digits no longer tell on which machine it was drawn.

    Labels and scales keep their digits; parts named by a hash get their number instead.
    """
    names = {name: f"{name[0]}{place}" for place, name in enumerate(_defined(svg), 1)}
    renamed = HASHED.sub(lambda match: names.get(match[0], match[0]), svg)
    return NUMBERS.sub(_rounded, renamed)


def _defined(svg: str) -> list[str]:
    return list(dict.fromkeys(DEFINED.findall(svg)))


def _rounded(match: re.Match[str]) -> str:
    text = match[0]
    if text.startswith(("<!--", "scale")):
        return text
    return f"{round(float(text), 2) + 0.0:g}" if abs(float(text)) < 1e4 else text
