// Sort tables by a click, Enter or Space on a heading; groups of rows stay together.

function makeSortable(table) {
  const row = table.tHead?.rows[0];
  if (!row || table.tHead.rows.length > 1) return;
  for (const heading of row.cells) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "sort";
    button.append(...heading.childNodes);
    heading.append(button);
    button.addEventListener("click", () => sortBy(table, heading));
  }
}

/** Best first by data-better, else numbers descending and texts ascending; again: reversed. */
function sortBy(table, heading) {
  const column = heading.cellIndex;
  const bodies = [...table.tBodies];
  const numeric = bodies.some((body) => [...body.rows].some((row) => typeof valueOf(row, column) === "number"));
  const first = heading.dataset.better === "lower" || !numeric ? "ascending" : "descending";
  const other = { ascending: "descending", descending: "ascending" };
  const direction = other[heading.getAttribute("aria-sort")] ?? first;
  for (const cell of heading.parentElement.cells) cell.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", direction);
  for (const body of bodies) {
    const fixed = [...body.rows].filter((row) => row.classList.contains("group"));
    const rows = [...body.rows].filter((row) => !fixed.includes(row));
    rows.sort((a, b) => compare(valueOf(a, column), valueOf(b, column), direction === "ascending" ? 1 : -1));
    body.append(...fixed, ...rows);
  }
}

/** A number if the cell has one, else its text; null if it is missing. */
function valueOf(row, column) {
  const cell = row.cells[column];
  if (!cell || row.classList.contains("group") || cell.classList.contains("missing")) return null;
  const text = (cell.dataset.value ?? cell.textContent).trim();
  const plain = text.replaceAll(",", "").replace("−", "-").replace(/^[<>≥≤≈]\s*/, "");
  return plain !== "" && Number.isFinite(Number(plain)) ? Number(plain) : text || null;
}

function compare(a, b, sign) {
  if (a === null || b === null) return (a === null) - (b === null); // missing values last, in both directions
  if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
  return sign * (typeof a === "number" ? a - b : a.localeCompare(b, "en", { numeric: true }));
}
