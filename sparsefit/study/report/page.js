"use strict";
// Tables that sort and filter, points that tell their case. Without it the page still says all.
document.documentElement.classList.add("js");

// A cell as a number: undefined where it is words, NaN where it is nothing.
function number(text) {
  if (text === "–" || text === "") return NaN;
  if (text === "∞" || text === "-∞") return text === "∞" ? Infinity : -Infinity;
  if (text.startsWith("< ")) return 0;
  const found = text.match(/^[-+]?\d+(\.\d+)?(e[-+]?\d+)?/i);
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

// Up, down, and as it was.
function sortable(table) {
  const body = table.tBodies[0];
  const first = [...body.rows];
  const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells];
  heads.forEach((head, place) => {
    head.firstElementChild.addEventListener("click", () => {
      const now = head.ariaSort;
      const next = { ascending: "descending", descending: null }[now];
      const wanted = next === undefined ? "ascending" : next;
      for (const other of heads) other.removeAttribute("aria-sort");
      if (wanted) head.setAttribute("aria-sort", wanted);
      const sign = wanted === "descending" ? -1 : 1;
      const text = (row) => row.cells[place].textContent.trim();
      const rows = wanted ? [...first].sort((a, b) => order(text(a), text(b), sign)) : first;
      body.append(...rows);
    });
  });
}

// Rows that hold every word.
function filterable(field) {
  const rows = [...document.getElementById(field.getAttribute("aria-controls")).tBodies[0].rows];
  const texts = rows.map((row) => row.textContent.toLowerCase());
  const count = field.closest(".filter").querySelector("output");
  field.addEventListener("input", () => {
    const words = field.value.toLowerCase().split(/\s+/);
    rows.forEach((row, place) => {
      row.hidden = !words.every((word) => texts[place].includes(word));
    });
    const left = rows.filter((row) => !row.hidden).length;
    count.textContent = left === rows.length ? "" : `${left} of ${rows.length} rows`;
  });
}

const data = JSON.parse(document.getElementById("points").textContent);
const tip = document.getElementById("tip");
let pinned = null;

function pointOf(target) {
  return target instanceof Element ? target.closest("figure svg a") : null;
}

function linesOf(point) {
  const name = decodeURIComponent(point.getAttribute("href").slice(1));
  const told = Object.hasOwn(data.points, name) ? data.points[name] : [];
  return [told.map((place) => data.words[place]), data.command ? `${data.command} ${name}` : name];
}

function show(point) {
  const [lines, command] = linesOf(point);
  tip.replaceChildren();
  for (const line of lines) {
    tip.append(Object.assign(document.createElement("div"), { textContent: line }));
  }
  tip.append(Object.assign(document.createElement("code"), { textContent: command }));
  tip.hidden = false;
  const box = point.getBoundingClientRect();
  const widest = document.documentElement.clientWidth - tip.offsetWidth - 8;
  const below = box.bottom + 8 + tip.offsetHeight < window.innerHeight;
  const top = below ? box.bottom + 8 : box.top - tip.offsetHeight - 8;
  tip.style.left = `${window.scrollX + Math.max(8, Math.min(box.left, widest))}px`;
  tip.style.top = `${window.scrollY + Math.max(8, top)}px`;
}

function hide() {
  pinned = null;
  tip.hidden = true;
}

// One stop for the Tab key in each picture; arrows go from point to point.
function reachable(picture) {
  const points = [...picture.querySelectorAll("a")];
  points.forEach((point, place) => {
    point.setAttribute("tabindex", place ? "-1" : "0");
    point.setAttribute("aria-describedby", "tip");
    point.setAttribute("aria-label", linesOf(point)[0].join(", "));
  });
  picture.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    const place = points.indexOf(document.activeElement);
    if (!step || place < 0) return;
    event.preventDefault();
    const next = points[(place + step + points.length) % points.length];
    points[place].setAttribute("tabindex", "-1");
    next.setAttribute("tabindex", "0");
    next.focus();
    show(next);
  });
}

document.querySelectorAll("table.sorts").forEach(sortable);
document.querySelectorAll("input[type=search]").forEach(filterable);
document.querySelectorAll("figure svg").forEach(reachable);
document.addEventListener("pointerover", (event) => {
  const point = pointOf(event.target);
  if (point) show(point);
  else if (!pinned && !tip.contains(event.target)) hide();
});
document.addEventListener("focusin", (event) => {
  const point = pointOf(event.target);
  if (point) show(point);
});
document.addEventListener("click", (event) => {
  const point = pointOf(event.target);
  if (point) {
    event.preventDefault();
    pinned = point;
    show(point);
  } else if (!tip.contains(event.target)) hide();
});
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") hide();
});
