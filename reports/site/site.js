// Sortable tables and the browser of candidates; nothing is fetched, so that pages open from a folder.
"use strict";

function valueOf(cell) {
  const text = (cell.dataset.value ?? cell.textContent).trim();
  const number = parseFloat(text.replace(/,/g, ""));
  return { text, number: /^[-<]?[\d.,]+/.test(text) ? number : NaN };
}

function compare(a, b) {
  if (!Number.isNaN(a.number) && !Number.isNaN(b.number)) return a.number - b.number;
  if (Number.isNaN(a.number) !== Number.isNaN(b.number)) return Number.isNaN(a.number) ? 1 : -1;
  return a.text.localeCompare(b.text);
}

function withButton(th, onSort) {
  const button = document.createElement("button");
  button.type = "button";
  button.append(...th.childNodes);
  th.append(button);
  button.addEventListener("click", () => {
    const direction = th.getAttribute("aria-sort") === "ascending" ? "descending" : "ascending";
    for (const other of th.parentNode.children) other.removeAttribute("aria-sort");
    th.setAttribute("aria-sort", direction);
    onSort(direction === "ascending" ? 1 : -1);
  });
}

for (const table of document.querySelectorAll("table.sortable")) {
  if (!table.tHead || !table.tBodies.length) continue;
  [...table.tHead.rows[0].cells].forEach((th, column) => withButton(th, (sign) => {
    const rows = [...table.tBodies[0].rows];
    rows.sort((a, b) => sign * compare(valueOf(a.cells[column]), valueOf(b.cells[column])));
    table.tBodies[0].append(...rows);
    table.dispatchEvent(new Event("sorted"));
  }));
}

// Rows come by pages of a hundred. The answer is to be told how many rows there are; show is told the first of a page and the one after its last.
function pages(show) {
  const PAGE = 100, [before, place, after] = ["before", "place", "after"].map((id) => document.getElementById(id));
  let first = 0, n = 0;
  const turn = (to) => {
    first = to;
    const last = Math.min(first + PAGE, n);
    place.textContent = n ? `${first + 1} to ${last}` : "none";
    before.disabled = first === 0;
    after.disabled = last === n;
    show(first, last);
  };
  before.addEventListener("click", () => turn(first - PAGE));
  after.addEventListener("click", () => turn(first + PAGE));
  return (found, of, what) => {
    n = found;
    document.getElementById("found").textContent = `${found.toLocaleString("en")} of ${of.toLocaleString("en")} ${what}`;
    turn(0);
  };
}

function onFilter(form, filter) {
  // A select that a script or an older browser sets tells only of a change.
  for (const kind of ["input", "change"]) form.addEventListener(kind, filter);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", () => setTimeout(filter));
  filter();
}

for (const form of document.querySelectorAll("form[data-rows]")) {
  const table = document.getElementById(form.dataset.rows), rows = [...table.tBodies[0].rows];
  let found = [];
  const tell = pages((first, last) => {
    const shown = new Set(found.slice(first, last));
    for (const row of rows) row.hidden = !shown.has(row);
  });
  const filter = () => {
    const chosen = [...form.elements].filter((field) => field.name && field.value);
    found = [...table.tBodies[0].rows].filter((row) => chosen.every((field) => {
      const text = row.cells[Number(field.name)].textContent;
      return field.type === "search" ? text.includes(field.value) : text === field.value;
    }));
    tell(found.length, rows.length, form.dataset.what);
  };
  table.addEventListener("sorted", filter);
  onFilter(form, filter);
}

// A table that is wider than its box says so.
const widths = new ResizeObserver((entries) => {
  for (const { target } of entries) target.parentNode.classList.toggle("overflows", target.offsetWidth > target.parentNode.clientWidth + 1);
});
for (const table of document.querySelectorAll(".scroll > table")) widths.observe(table);
addEventListener("resize", () => {
  for (const table of document.querySelectorAll(".scroll > table")) { widths.unobserve(table); widths.observe(table); }
});

function browse(data) {
  const form = document.getElementById("filters"), body = document.querySelector("#browser tbody");
  const command = document.getElementById("command");
  const word = (name, k) => {
    const value = data.columns[name][k];
    return value === null ? "" : data.words[name] ? data.words[name][value] : String(value);
  };
  const cell = {
    candidate_id: (k) => data.ids[k],
    error_mm: (k) => (data.errors[k] === null ? "" : (data.errors[k] / 10).toFixed(1)),
  };
  const text = (name, k) => (cell[name] ? cell[name](k) : word(name, k));
  let found = [], sorted = { name: "candidate_id", sign: 1 };

  function filter() {
    const chosen = Object.fromEntries(new FormData(form));
    found = data.ids.map((_, k) => k).filter((k) =>
      Object.keys(data.columns).every((name) => !chosen[name] || word(name, k) === chosen[name]) &&
      (!chosen.id || data.ids[k].includes(chosen.id)) && (!chosen.film || data.films[data.ids[k]]));
    const key = (k) => { const t = text(sorted.name, k); return { text: t, number: sorted.name === "candidate_id" ? NaN : parseFloat(t) }; };
    found.sort((a, b) => sorted.sign * compare(key(a), key(b)) || a - b);
    tell(found.length, data.ids.length, "candidates");
  }

  const tell = pages((first, last) => {
    const heads = [...document.querySelectorAll("#browser th")];
    body.replaceChildren(...found.slice(first, last).map((k) => {
      const row = document.createElement("tr");
      for (const { className, dataset: { column: name } } of heads) {
        const td = row.insertCell();
        td.className = className;
        if (name === "candidate_id") td.append(idButton(k));
        else if (name === "film") td.append(...filmLinks(data.ids[k]));
        // A long status may go on in another line after any of its words.
        else td.append(...text(name, k).split(/(?<=_)/).flatMap((part, i) => (i ? [document.createElement("wbr"), part] : [part])));
      }
      return row;
    }));
  });

  function idButton(k) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "id";
    button.textContent = data.ids[k];
    button.addEventListener("click", () => {
      command.hidden = false;
      command.querySelector("code").textContent = data.command.replace("ID", data.ids[k]);
      command.scrollIntoView({ block: "nearest" });
    });
    return button;
  }

  function filmLinks(id) {
    return (data.films[id] ?? []).flatMap(([name, path]) => {
      const link = document.createElement("a");
      link.href = path;
      link.textContent = name;
      return [link, " "];
    });
  }

  for (const th of document.querySelectorAll("#browser th")) {
    if (th.dataset.column !== "film") withButton(th, (sign) => { sorted = { name: th.dataset.column, sign }; filter(); });
  }
  onFilter(form, filter);
}

if (window.CANDIDATES) browse(window.CANDIDATES);
