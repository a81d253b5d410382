"use strict";
// Long tables: all rows are data; those that match the search and the choices are shown, a page at a time.
document.querySelectorAll(".listing").forEach(listing => {
  const {size, links, rows} = JSON.parse(listing.querySelector("script[type='application/json']").textContent);
  const find = selector => listing.querySelector(selector), body = find("tbody");
  const search = find("input"), selects = [...listing.querySelectorAll("select")];
  const [before, next, shown] = [".before", ".next", ".shown"].map(find);
  const lower = rows.map(row => row.join("\n").toLowerCase());
  let matching = rows, start = 0;
  const cell = (text, column) => {
    const made = document.createElement(column ? "td" : "th");
    made.className = "name";
    if (!column && Object.hasOwn(links, text)) {
      const link = document.createElement("a");
      link.href = links[text];
      link.textContent = text;
      made.append(link);
    } else made.textContent = text;
    return made;
  };
  const show = at => {
    start = Math.max(0, Math.min(at, matching.length - 1));
    const end = Math.min(start + size, matching.length);
    body.replaceChildren(...matching.slice(start, end).map(row => {
      const made = document.createElement("tr");
      made.append(...row.map(cell));
      return made;
    }));
    shown.textContent = matching.length ? `${start + 1} to ${end} of ${matching.length}` : "none";
    before.disabled = start === 0;
    next.disabled = end >= matching.length;
  };
  const choose = () => {
    const words = search.value.toLowerCase().split(/\s+/);
    const chosen = selects.filter(select => select.value).map(select => [+select.dataset.column, select.value.slice(1)]);
    matching = rows.filter((row, at) =>
      chosen.every(([column, value]) => row[column] === value) && words.every(word => lower[at].includes(word)));
    show(0);
  };
  search.addEventListener("input", choose);
  selects.forEach(select => select.addEventListener("change", choose));
  before.addEventListener("click", () => show(start - size));
  next.addEventListener("click", () => show(start + size));
  find(".controls").hidden = false;
  choose();
});
