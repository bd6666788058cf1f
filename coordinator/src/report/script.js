(() => {
  const table = document.getElementById("videos");
  if (!table) return;
  const body = table.tBodies[0];
  const rows = [...body.rows];
  const value = (row, i) => {
    const text = row.cells[i].textContent;
    const number = Number(text.replaceAll(",", ""));
    return text === "–" ? null : Number.isFinite(number) ? number : text;
  };
  const compare = (a, b) =>
    typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b));
  [...table.tHead.rows[0].cells].forEach((head, i) => {
    const button = document.createElement("button");
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const down = head.ariaSort === "ascending";
      for (const other of table.tHead.rows[0].cells) other.ariaSort = null;
      head.ariaSort = down ? "descending" : "ascending";
      const keyed = rows.map((row) => [value(row, i), row]);
      keyed.sort(([a], [b]) =>
        a === null || b === null ? (a === null) - (b === null) : down ? compare(b, a) : compare(a, b));
      body.append(...keyed.map(([, row]) => row));
    });
  });
  const filter = document.getElementById("filter");
  filter.hidden = false;
  const input = filter.querySelector("input");
  const shown = filter.querySelector("output");
  input.addEventListener("input", () => {
    const wanted = input.value.toLowerCase();
    let n = 0;
    for (const row of rows) {
      const hit = row.textContent.toLowerCase().includes(wanted);
      row.hidden = !hit;
      n += hit;
    }
    shown.textContent = wanted ? `${n.toLocaleString("en")} shown` : "";
  });
})();
