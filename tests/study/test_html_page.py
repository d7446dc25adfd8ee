"""The page of a study: what stands in it, and in a browser where one is installed."""

import base64
import hashlib
import html
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import pytest

from sparsefit.study.evidence.table import SIGNIFICANT, Column, Table
from sparsefit.study.report.html_page import Code, Page, Picture, Points, Section, to_html
from sparsefit.study.report.vector import inlined, linked_names, settled

HOSTILE = """</script><script>document.title="owned"</script><img src=x onerror="alert(1)">'&"""
TABLE = Table(
    f"Errors {HOSTILE}",
    (
        Column("name", align="left"),
        Column("mean", "%", SIGNIFICANT, group="error", least=1e-6),
        Column("n", format="d", group="error"),
    ),
    tuple(
        (name, value, place)
        for place, (name, value) in enumerate(
            [
                *[("b", 12.5), ("a", 1e-9), (HOSTILE, None), ("c", 2.0), ("d", float("inf"))],
                *[("ten", 10.0), ("two", 1e-5), ("e", 3e6), ("f", float("nan"))],
            ]
        )
    ),
    ("A note.",),
)
SVG = """<?xml version="1.0"?><svg xmlns="x" width="9pt" viewBox="0 0 90 60" version="1.1">
 <metadata>x</metadata><defs><style type="text/css">*{fill: red}</style></defs>
 <g id="axes_1"><path d="M 0 0 " style="fill: #ffffff"/>
  <path id="C0_0_0123456789" d="M 0 1.23456 " style="fill: #0072b2"/>
  <text style="fill: #0072b2">0.123456 style="fill: #0072b2" } &lt;b&gt; </text>
  <a xlink:href="#0001-ab" target="_blank">
   <g clip-path="url(#pabcdef0123)"><use xlink:href="#C0_0_0123456789" x="1.23456" y="2"/></g>
  </a>
  <a xlink:href="#0002-cd"><use xlink:href="#C0_0_0123456789" x="30" y="20"/></a>
 </g></svg>"""
POINTS = Points({"0001-ab": ("flight 1", HOSTILE), "0002-cd": ("flight 2", "ok")}, "show --case")


def page():
    picture = Picture(inlined(SVG, "p1", html.escape(HOSTILE)), HOSTILE, HOSTILE)
    sections = (
        Section("Pictures", (picture,)),
        Section("Tables", (HOSTILE, TABLE)),
        Section("This run", (Code(HOSTILE, HOSTILE),), folded=True),
    )
    return Page(HOSTILE, HOSTILE, (HOSTILE,), sections, HOSTILE, POINTS)


class TestInlined:
    SVG = inlined(SVG, "p1", "title")

    def test_a_point_is_a_link_to_its_case(self):
        assert '<a href="#0001-ab"><use href="#p1C1" x="1.23" y="2"/></a>' in self.SVG
        assert linked_names(self.SVG) == ["0001-ab", "0002-cd"]

    def test_a_label_stays_letter_for_letter(self):
        assert '>0.123456 style="fill: #0072b2" } &lt;b&gt; </text>' in self.SVG

    def test_nothing_of_it_reaches_beyond_the_picture(self):
        assert "*{" not in self.SVG
        assert set(re.findall(r'id="([^"]*)"', self.SVG)) == {"p1", "p1C1"}
        assert ".p1s0{fill: #0072b2}" in self.SVG
        assert "#ffffff" not in self.SVG

    def test_a_mark_that_only_leads_is_no_part_of_a_file(self):
        svg = SVG.replace("#0002-cd", "#~0002-cd")
        assert inlined(svg, "p1", "title") == self.SVG
        assert settled(svg).count("<use") == settled(SVG).count("<use") - 1

    def test_a_file_has_no_links(self):
        assert "<a" not in settled(SVG)
        assert "0.123456 style" in settled(SVG)


class Elements(HTMLParser):
    def __init__(self):
        super().__init__()
        self.seen, self.text, self.inside = [], [], []

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text.append(data)


class TestPage:
    TEXT = to_html(page())

    def test_is_the_same_each_time(self):
        assert to_html(page()) == self.TEXT

    def test_hostile_names_are_text(self):
        elements = Elements()
        elements.feed(self.TEXT)
        tags = [tag for tag, _ in elements.seen]
        assert tags.count("script") == 2
        assert "img" not in tags
        assert not [name for _, attrs in elements.seen for name in attrs if name.startswith("on")]
        assert "".join(elements.text).count("onerror") >= 8

    def test_no_script_but_its_own_may_run_and_nothing_is_fetched(self):
        script = re.findall(r"<script>(.*?)</script>", self.TEXT, re.DOTALL)[-1]
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        policy = re.search(r'Content-Security-Policy" content="([^"]*)"', self.TEXT)[1]
        assert f"script-src 'sha256-{digest}'" in policy
        assert policy.startswith("default-src 'none'")
        assert not re.search(r'(?:src|href)="(?!#)', self.TEXT.replace("data:", "#"))
        assert script.count("\n") <= 200

    def test_points_are_json_in_which_nothing_ends_a_script(self):
        text = re.search(r'id="points">(.*?)</script>', self.TEXT, re.DOTALL)[1]
        data = json.loads(text)
        assert data["words"][data["points"]["0001-ab"][1]] == HOSTILE
        assert "<" not in text


BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
DRIVER = """
const out = [];
const column = (place) => [...document.querySelectorAll("tbody tr")]
  .filter((row) => !row.hidden).map((row) => row.cells[place].textContent);
const heads = [...document.querySelectorAll("th button")];
const tipText = () => document.getElementById("tip").textContent;
for (const times of [1, 2, 3]) { heads[1].click(); out.push(column(2)); }
heads[0].click(); out.push(column(0));
const field = document.querySelector("input[type=search]");
field.value = "ONERROR"; field.dispatchEvent(new Event("input")); out.push(column(2));
out.push(document.querySelector("output").textContent);
const points = [...document.querySelectorAll("figure svg a")];
points[0].focus();  // a window in the background does not tell of it
points[0].dispatchEvent(new FocusEvent("focusin", { bubbles: true })); out.push(tipText());
points[0].dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
out.push(document.activeElement === points[1], tipText());
document.dispatchEvent(new KeyboardEvent("keydown", { key: "Escape" }));
out.push(document.getElementById("tip").hidden);
points[0].dispatchEvent(new PointerEvent("pointerover", { bubbles: true })); out.push(tipText());
out.push([document.images.length, document.scripts.length]);
out.push(document.documentElement.scrollWidth <= window.innerWidth);
out.push(getComputedStyle(document.body).backgroundColor);
document.body.dataset.out = JSON.stringify(out);
"""


@pytest.mark.skipif(BROWSER is None, reason="no Chromium to open the page in")
@pytest.mark.parametrize(
    ("width", "scheme", "paper"),
    [(360, 1, "255, 255, 255"), (800, 0, "17, 17, 17"), (1400, 1, "255, 255, 255")],
)
def test_in_a_browser(tmp_path, width, scheme, paper):
    text = to_html(page())
    script = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)[-1]
    driven = script + DRIVER
    digests = [
        base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in (script, driven)
    ]
    file = tmp_path / "page.html"
    file.write_text(text.replace(script, driven).replace(*digests), "utf-8")
    command = [
        BROWSER,
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        f"--window-size={width},800",
    ]
    options = [
        "--enable-logging=stderr",
        f"--blink-settings=preferredColorScheme={scheme}",
        f"--user-data-dir={tmp_path / 'profile'}",
        "--dump-dom",
    ]
    done = subprocess.run(
        [*command, *options, file.as_uri()], capture_output=True, text=True, timeout=60, check=True
    )
    assert "CONSOLE" not in done.stderr
    told = re.search(r'data-out="([^"]*)"', done.stdout)
    up, down, first, names, kept, count, tip, moved, next_tip, hidden, hover, *rest = json.loads(
        html.unescape(told[1])
    )
    nothing = ["2", "8"]
    assert up == ["1", "6", "3", "5", "0", "7", "4", *nothing]
    assert down == ["4", "7", "0", "5", "3", "6", "1", *nothing]
    assert first == [str(place) for place in range(9)]
    assert names[1:4] == ["a", "b", "c"]
    assert (kept, count) == (["2"], "1 of 9 rows")
    assert tip == hover == f"flight 1{HOSTILE}show --case 0001-ab"
    assert (moved, next_tip, hidden) == (True, "flight 2okshow --case 0002-cd", True)
    images_and_scripts, fits, behind = rest
    assert images_and_scripts == [0, 2]
    assert fits
    assert behind == f"rgb({paper})"
