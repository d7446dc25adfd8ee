"use strict";
// Tables that sort and filter, pictures whose lines hide and whose axes turn linear.
document.documentElement.classList.add("js");

// A cell as a number: undefined where it is words, NaN where it is nothing; "≥ 8" is 8.
function number(text) {
  if (text === "–" || text === "") return NaN;
  if (text === "∞" || text === "-∞") return text === "∞" ? Infinity : -Infinity;
  const found = text.replace(/^[≥≤<>]\s*/, "").match(/^[-+]?\d+(\.\d+)?(e[-+]?\d+)?/i);
  return found ? Number(found[0]) : undefined;
}

// Nothing comes last whichever way; numbers before words.
function order(a, b, sign) {
  const [x, y] = [number(a), number(b)];
  const [gone, lost] = [Number.isNaN(x), Number.isNaN(y)];
  if (gone || lost) return gone - lost;
  if (x !== undefined && y !== undefined) return x === y ? 0 : sign * (x < y ? -1 : 1);
  if (x !== undefined || y !== undefined) return x !== undefined ? -1 : 1;
  return sign * a.localeCompare(b, undefined, { numeric: true });
}

for (const table of document.querySelectorAll("table.sorts")) {
  const body = table.tBodies[0];
  const first = [...body.rows];
  const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells];
  heads.forEach((head, place) => {
    head.firstElementChild.addEventListener("click", () => {
      const wanted = { ascending: "descending", descending: null }[head.ariaSort];
      const next = wanted === undefined ? "ascending" : wanted;
      for (const other of heads) other.removeAttribute("aria-sort");
      if (next) head.setAttribute("aria-sort", next);
      const text = (row) => row.cells[place].textContent.trim();
      const sign = next === "descending" ? -1 : 1;
      body.append(...(next ? [...first].sort((a, b) => order(text(a), text(b), sign)) : first));
    });
  });
}

// Columns under one heading (a tolerance, a summary) hide and show together.
for (const button of document.querySelectorAll("button[data-group]")) {
  const table = document.getElementById(button.getAttribute("aria-controls"));
  button.addEventListener("click", () => {
    const shown = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(shown));
    let place = 0;
    for (const head of table.tHead.rows[0].cells) {
      const span = head.colSpan;
      if (head.textContent === button.dataset.group) {
        head.hidden = !shown;
        for (const row of [table.tHead.rows[1], ...table.tBodies[0].rows]) {
          for (let at = place; at < place + span; at += 1) row.cells[at].hidden = !shown;
        }
      }
      place += span;
    }
  });
}

for (const field of document.querySelectorAll("input[type=search]")) {
  const rows = [...document.getElementById(field.getAttribute("aria-controls")).tBodies[0].rows];
  const texts = rows.map((row) => row.textContent.toLowerCase());
  field.addEventListener("input", () => {
    const words = field.value.toLowerCase().split(/\s+/);
    rows.forEach((row, place) => {
      row.hidden = !words.every((word) => texts[place].includes(word));
    });
  });
}

for (const figure of document.querySelectorAll("figure")) {
  for (const button of figure.querySelectorAll("button[data-line]")) {
    button.addEventListener("click", () => {
      const shown = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", String(shown));
      for (const line of figure.querySelectorAll(`[id="${button.dataset.line}"]`)) {
        line.style.display = shown ? "" : "none";
      }
    });
  }
  const scale = figure.querySelector("button[data-scale]");
  if (scale) {
    scale.addEventListener("click", () => {
      const linear = figure.classList.toggle("linear");
      scale.setAttribute("aria-pressed", String(linear));
    });
  }
}
