"use strict";
// Tables that sort by a click on a heading: figures by size, the best first, words by the alphabet, gaps last.
document.querySelectorAll("table.sortable").forEach(table => {
  const headings = [...table.tHead.rows[table.tHead.rows.length - 1].cells], body = table.tBodies[0];
  const number = text => /^-?[\d.]+(e-?\d+)?( %| mm)?$/.test(text) ? parseFloat(text) : NaN;
  headings.forEach((heading, at) => heading.querySelector("button").addEventListener("click", () => {
    const first = heading.dataset.first || "ascending", now = heading.getAttribute("aria-sort");
    const up = (now === first) !== (first === "ascending");
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
// Tables with a choice of rows for each of their columns of words.
document.querySelectorAll("table.filterable").forEach(table => {
  const controls = table.parentElement.previousElementSibling, rows = [...table.tBodies[0].rows], chosen = new Map();
  const words = [...table.tHead.rows[0].cells].filter(cell => cell.classList.contains("name"));
  words.forEach((heading, at) => {
    const values = [...new Set(rows.map(row => row.cells[at].dataset.value))];
    if (values.length < 2) return;
    const label = document.createElement("label"), select = document.createElement("select");
    label.append(heading.textContent + " ", select);
    select.append(new Option("all", ""), ...values.map(value => new Option(value, "=" + value)));
    select.addEventListener("change", () => {
      chosen.set(at, select.value);
      rows.forEach(row => row.hidden =
        [...chosen].some(([at, value]) => value && "=" + row.cells[at].dataset.value !== value));
    });
    controls.append(label);
  });
  controls.hidden = !controls.childElementCount;
});
// Tables that are wider than the page say so, and how far they are scrolled.
const wide = [...document.querySelectorAll(".scroll")];
const tell = box => {
  const rest = box.scrollWidth - box.clientWidth - box.scrollLeft;
  box.classList.toggle("more-right", rest > 1);
  box.classList.toggle("more-left", box.scrollLeft > 1);
  box.classList.toggle("wide", box.scrollWidth > box.clientWidth + 1);
};
wide.forEach(box => box.addEventListener("scroll", () => tell(box), {passive: true}));
const watch = new ResizeObserver(entries => entries.forEach(entry => tell(entry.target)));
wide.forEach(box => watch.observe(box));
