"""SVG of Matplotlib: as every machine writes it to a file, and as a part of a page.

A point that stands for a case is a link to `#CASE_ID` (`linked`). A file leaves links out; in a
page they are what a pointer and the keyboard find.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping

import pandas as pd
from matplotlib.collections import PathCollection

# Labels are names from files: nothing but what stands in a tag is ever changed.
TAG = re.compile(r"<[a-zA-Z][^>]*>")
NUMBER = re.compile(r"scale\([^)]*\)|-?\d+\.\d{3,}")
# What Matplotlib names by a hash of unrounded numbers: clips, markers, hatches, images.
HASHED = re.compile(r"\b[a-zA-Z]\w*[0-9a-f]{10}\b")
DEFINED = re.compile(r'\bid="([a-zA-Z]\w*[0-9a-f]{10})"')
UNSEEN = "~"
HIDDEN = re.compile(rf'<a xlink:href="#{UNSEEN}[^"]*"[^>]*>.*?</a>\s*', re.DOTALL)
LINKS = re.compile(r'<a xlink:href="#[^"]*"[^>]*>|</a>')
POINT = re.compile(r'(<a xlink:href="#)~?([^"]*")[^>]*>(?:<g[^>]*>)?(<use[^>]*>)(?:</g>)?</a>')
UNTURNED = re.compile(r' transform="rotate\(-?0 [^"]*"')
LINKED = re.compile(r'<a href="#([^"]*)">')
HEAD = re.compile(r"^.*?<svg[^>]*?viewBox=\"([^\"]*)\"[^>]*>", re.DOTALL)
DROPPED = re.compile(r"<!--.*?-->|<metadata>.*?</metadata>|<style.*?</style>", re.DOTALL)
WHITE = re.compile(r'<path d="[^"]*" style="fill: #ffffff"/>')
OWN_IDS = re.compile(r' id="(?:figure|axes|patch|line2d|text|matplotlib|xtick|ytick|legend|\w+Col'
                     r'lection)[\w.]*"')  # fmt: skip
NAMED = re.compile(r'(\bid="|url\(#|\bhref="#)([a-zA-Z]\d+)\b')
STYLED = re.compile(r' style="([^"]*)"')
BLANKS = re.compile(r">\s*\n\s*<")


def linked(points: PathCollection, cases: pd.DataFrame, *, unseen: bool = False) -> None:
    """Let every point, in the order of the cases, stand for its case.

    unseen: they lie over marks that are drawn already; only a page has them.
    """
    before = f"#{UNSEEN if unseen else ''}"
    points.set_urls([f"{before}{name}" for name in cases["case_id"]] if "case_id" in cases else [])


def linked_names(svg: str) -> list[str]:
    """Return what the points of an inlined SVG stand for."""
    return list(dict.fromkeys(LINKED.findall(svg)))


def settled(svg: str) -> str:
    """Return an SVG of Matplotlib whose last digits no longer tell on which machine it was drawn.

    Labels and scales keep their digits; parts named by a hash get their number instead.
    """
    return _rounded(LINKS.sub("", HIDDEN.sub("", svg)))


def inlined(svg: str, name: str, title: str) -> str:
    """Return an SVG of Matplotlib as an element of a page, `title` (HTML) what it is called.

    name: of letters, digits, `-` and `_`, which no other picture of the page has. Repeated styles
    become classes of this picture; links stay, and what is white shows the page.
    """
    match = HEAD.match(svg)
    if not match:
        raise ValueError("no SVG with a viewBox")
    body = WHITE.sub("", DROPPED.sub("", svg[match.end() :]))
    body = POINT.sub(r"\1\2>\3</a>", BLANKS.sub("><", _rounded(body)).strip())
    counted = Counter(style for tag in TAG.findall(body) for style in STYLED.findall(tag))
    often = [style for style, times in counted.items() if times > 1]
    places = {style: f"{name}s{place}" for place, style in enumerate(often)}
    rules = "".join(f".{label}{{{style}}}" for style, label in places.items())
    body = TAG.sub(lambda tag: _adopted(tag[0], name, places), body)
    head = f'<svg id="{name}" viewBox="{match[1]}" role="group" aria-label="{title}">'
    return f"{head}<style>{rules}</style>{body}"


def _adopted(tag: str, name: str, places: Mapping[str, str]) -> str:
    """The tag with ids of this picture, and a class where its style has one."""
    tag = UNTURNED.sub("", OWN_IDS.sub("", tag)).replace("xlink:href=", "href=").replace("\n", " ")
    tag = NAMED.sub(lambda found: f"{found[1]}{name}{found[2]}", tag)
    return STYLED.sub(
        lambda style: f' class="{places[style[1]]}"' if style[1] in places else style[0], tag
    )


def _rounded(svg: str) -> str:
    defined = list(dict.fromkeys(DEFINED.findall(svg)))
    names = {name: f"{name[0]}{place}" for place, name in enumerate(defined, 1)}

    def changed(tag: re.Match[str]) -> str:
        renamed = HASHED.sub(lambda found: names.get(found[0], found[0]), tag[0])
        return NUMBER.sub(_number, renamed)

    return TAG.sub(changed, svg)


def _number(match: re.Match[str]) -> str:
    text = match[0]
    if text.startswith("scale") or abs(float(text)) >= 1e4:
        return text
    return f"{round(float(text), 2) + 0.0:g}"
