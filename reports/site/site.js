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
  }));
}

function browse(data) {
  const PAGE = 100, form = document.getElementById("filters"), body = document.querySelector("#browser tbody");
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
  let found = [], first = 0, sorted = { name: "candidate_id", sign: 1 };

  function filter() {
    const chosen = Object.fromEntries(new FormData(form));
    found = data.ids.map((_, k) => k).filter((k) =>
      Object.keys(data.columns).every((name) => !chosen[name] || word(name, k) === chosen[name]) &&
      (!chosen.id || data.ids[k].includes(chosen.id)) && (!chosen.film || data.films[data.ids[k]]));
    const key = (k) => { const t = text(sorted.name, k); return { text: t, number: sorted.name === "candidate_id" ? NaN : parseFloat(t) }; };
    found.sort((a, b) => sorted.sign * compare(key(a), key(b)) || a - b);
    first = 0;
    show();
  }

  function show() {
    const names = [...document.querySelectorAll("#browser th")].map((th) => th.dataset.column);
    body.replaceChildren(...found.slice(first, first + PAGE).map((k) => {
      const row = document.createElement("tr");
      for (const name of names) {
        const td = row.insertCell();
        if (name === "candidate_id") td.append(idButton(k));
        else if (name === "film") td.append(...filmLinks(data.ids[k]));
        else td.textContent = text(name, k);
      }
      return row;
    }));
    const last = Math.min(first + PAGE, found.length);
    document.getElementById("found").textContent = `${found.length.toLocaleString("en")} of ${data.ids.length.toLocaleString("en")} candidates`;
    document.getElementById("place").textContent = found.length ? `${first + 1} to ${last}` : "none";
    document.getElementById("before").disabled = first === 0;
    document.getElementById("after").disabled = last === found.length;
  }

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
    return (data.films[id] ?? []).flatMap((kind) => {
      const link = document.createElement("a");
      link.href = `films/${id}.${kind}`;
      link.textContent = kind;
      return [link, " "];
    });
  }

  for (const th of document.querySelectorAll("#browser th")) {
    if (th.dataset.column !== "film") withButton(th, (sign) => { sorted = { name: th.dataset.column, sign }; filter(); });
  }
  // A select that a script or an older browser sets tells only of a change.
  for (const kind of ["input", "change"]) form.addEventListener(kind, filter);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", () => setTimeout(filter));
  document.getElementById("before").addEventListener("click", () => { first -= PAGE; show(); });
  document.getElementById("after").addEventListener("click", () => { first += PAGE; show(); });
  filter();
}

if (window.CANDIDATES) browse(window.CANDIDATES);
