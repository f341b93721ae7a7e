// Script of a report page, first of three parts: shared functions, and tables that sort and filter.
// The script uses no network and no other file. Data of the page are inserted as text, never as HTML.

document.documentElement.classList.add("js");
const selectAll = (selector, parent = document) => [...parent.querySelectorAll(selector)];
const typesetMinus = (text) => text.replace("-", "\u2212");

/** Make an element; an attribute that begins with "on" is an event listener. */
function makeElement(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}

const toolbar = document.getElementById("tools");
const messageElement = document.getElementById("message");

/** Announce a message to screen readers, and show it if `isVisible`. */
function showMessage(text, isVisible = false) {
  if (!messageElement) return;
  messageElement.textContent = text;
  messageElement.classList.toggle("is-quiet", !isVisible);
  toolbar?.classList.toggle("has-message", isVisible);
}

const policy = document.querySelector('meta[http-equiv="Content-Security-Policy"]');
const isServed = Boolean(policy && policy.content.includes("connect-src 'self'"));

// ---- tests: each has one row; all elements of a test have its number ----
const tests = new Map(); // keyed by number
for (const row of selectAll("tr[data-t][data-test]")) {
  const { t, test, key = "" } = row.dataset;
  tests.set(t, { number: t, name: test, key, row, elements: [] });
}
for (const element of selectAll("[data-t]")) tests.get(element.dataset.t)?.elements.push(element);

// ---- tables: sort ----
const collator = new Intl.Collator("en", { numeric: true, sensitivity: "base" });

/** Parse the number at the beginning of a text; NaN if there is none. */
function parseNumber(text) {
  const match = /^\s*[-+\u2212]?\d[\d\u2009]*(\.\d+)?(e[-+\u2212]?\d+)?/i.exec(text);
  return match ? Number(match[0].replaceAll("\u2212", "-").replaceAll("\u2009", "")) : NaN;
}

function getSortKey(cell, isNumber) {
  if (cell?.classList.contains("decision")) return getDecision(tests.get(cell.dataset.t))?.decision ?? "";
  const text = cell?.dataset.v ?? cell?.textContent.trim() ?? "";
  return isNumber ? parseNumber(text) : text;
}

/** Compare two sort keys; NaN is last in both directions. */
function compareKeys(a, b, isNumber, sign) {
  if (!isNumber) return sign * collator.compare(a, b);
  if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b);
  return sign * (a - b);
}

function sortRows(table, headingCell) {
  const isNumber = headingCell.dataset.sort === "number";
  const isDescending = headingCell.getAttribute("aria-sort") === "ascending";
  const body = table.tBodies[0];
  const keyedRows = [...body.rows].map((row) => [getSortKey(row.cells[headingCell.cellIndex], isNumber), row]);
  keyedRows.sort(([a], [b]) => compareKeys(a, b, isNumber, isDescending ? -1 : 1));
  body.append(...keyedRows.map(([, row]) => row));
  for (const cell of selectAll("th[aria-sort]", table)) cell.removeAttribute("aria-sort");
  headingCell.setAttribute("aria-sort", isDescending ? "descending" : "ascending");
  showMessage(`sorted by ${headingCell.textContent.trim()}, ${isDescending ? "last to first" : "first to last"}`);
  table.dispatchEvent(new Event("rows"));
}

/** Return whether most cells of a column begin with a number. */
function isNumberColumn(table, headingCell) {
  const texts = [...table.tBodies[0].rows].map((row) => row.cells[headingCell.cellIndex]?.textContent.trim() ?? "");
  const numberCount = texts.filter((text) => !Number.isNaN(parseNumber(text))).length;
  return numberCount > texts.length / 2;
}

for (const table of selectAll("table.sortable")) {
  for (const headingCell of selectAll("thead th", table)) {
    headingCell.dataset.sort ??= isNumberColumn(table, headingCell) ? "number" : "text";
    const button = makeElement("button", { type: "button", class: "sort" }, ...headingCell.childNodes);
    button.addEventListener("click", () => sortRows(table, headingCell));
    headingCell.append(button);
  }
}

// ---- tables: filter by words and states ----
const STATES = ["ok", "doubtful", "failed", "rejected", "unread"];

/** Return the lower-case text of a row without its decision. */
function getSearchText(row) {
  const cells = [...row.cells].filter((cell) => !cell.classList.contains("decision"));
  return cells.map((cell) => cell.textContent).join(" ").toLowerCase();
}

/** Return the state of a row, including a rejection on this page. */
function getState(row) {
  const test = tests.get(row.dataset.t);
  return getDecision(test)?.decision === "reject" ? "rejected" : row.dataset.state;
}

/** Add a search field and a button per state above a table. */
function addFilter(table) {
  const rows = [...table.tBodies[0].rows];
  const searchTexts = new Map(rows.map((row) => [row, getSearchText(row)]));
  const name = table.caption?.textContent.trim() || "rows";
  const input = makeElement("input", { type: "search", "aria-label": `Find in ${name}`, placeholder: "find" });
  const rowCountOutput = makeElement("output", {});
  const canReject = table.querySelector(".decision") !== null;
  const states = STATES.filter((state) => rows.some((row) => row.dataset.state === state)
    || (state === "rejected" && canReject));
  const selectedStates = new Set();
  const buttons = (states.length > 1 ? states : []).map((state) =>
    makeElement("button", { type: "button", "aria-pressed": "false", "data-state": state }, state));

  function applyFilter() {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shownCount = 0;
    for (const row of rows) {
      const isMatch = (!selectedStates.size || selectedStates.has(getState(row)))
        && words.every((word) => searchTexts.get(row).includes(word));
      row.hidden = !isMatch;
      shownCount += isMatch;
    }
    rowCountOutput.textContent = shownCount === rows.length ? `${rows.length} rows` : `${shownCount} of ${rows.length} rows`;
    table.dispatchEvent(new Event("rows"));
  }

  function toggleState(button) {
    const { state } = button.dataset;
    if (!selectedStates.delete(state)) selectedStates.add(state);
    button.setAttribute("aria-pressed", String(selectedStates.has(state)));
    applyFilter();
  }
  for (const button of buttons) button.addEventListener("click", () => toggleState(button));
  input.addEventListener("input", applyFilter);
  table.addEventListener("show-all", () => {
    input.value = "";
    for (const button of buttons) if (selectedStates.has(button.dataset.state)) toggleState(button);
    applyFilter();
  });
  const filterBar = makeElement("div", { class: "finder", role: "search", "aria-label": name }, input, ...buttons, rowCountOutput);
  (table.closest(".wide") ?? table).before(filterBar);
  applyFilter();
}

// ---- wide tables: a box that scrolls sideways, and no other, is a stop of the Tab key ----
function updateTabStop(box) {
  const isScrollable = box.scrollWidth > box.clientWidth;
  const name = box.querySelector("caption, th")?.textContent.trim() || "table";
  for (const [attribute, value] of Object.entries({ tabindex: "0", role: "group", "aria-label": name })) {
    if (isScrollable) box.setAttribute(attribute, value);
    else box.removeAttribute(attribute);
  }
}
const widthObserver = new ResizeObserver((changes) => { for (const { target } of changes) updateTabStop(target); });
for (const box of selectAll(".wide")) widthObserver.observe(box);
