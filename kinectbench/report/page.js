"use strict";
// Tables that sort by a click on a heading: figures by size, words by the alphabet, gaps last.
document.querySelectorAll("table.sortable").forEach(table => {
  const headings = [...table.tHead.rows[table.tHead.rows.length - 1].cells], body = table.tBodies[0];
  const number = text => /^-?[\d.]+(e-?\d+)?( %| mm)?$/.test(text) ? parseFloat(text) : NaN;
  headings.forEach((heading, at) => heading.querySelector("button").addEventListener("click", () => {
    const up = heading.getAttribute("aria-sort") !== "ascending";
    headings.forEach(other => other.removeAttribute("aria-sort"));
    heading.setAttribute("aria-sort", up ? "ascending" : "descending");
    const key = row => row.cells[at].dataset.value;
    const rows = [...body.rows].sort((a, b) => {
      const x = key(a), y = key(b), p = number(x), q = number(y);
      return !x - !y || (isNaN(p) || isNaN(q) ? x.localeCompare(y) : p - q) * (up ? 1 : -1);
    });
    body.append(...rows);
  }));
});
// Methods of the legend that are pressed stand out in the charts.
document.querySelectorAll(".charts").forEach(charts => {
  const buttons = [...charts.querySelectorAll(".legend button")];
  buttons.forEach(button => button.addEventListener("click", () => {
    button.setAttribute("aria-pressed", button.getAttribute("aria-pressed") !== "true");
    const on = new Set(buttons.filter(b => b.getAttribute("aria-pressed") === "true").map(b => b.dataset.series));
    charts.querySelectorAll(".series").forEach(series =>
      series.classList.toggle("dim", on.size > 0 && !on.has(series.dataset.series)));
  }));
});
