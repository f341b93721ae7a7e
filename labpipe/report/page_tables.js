// What a report does in a browser, first part: what all parts use, and tables that sort and filter.
// No network, no other file. Whatever is read from the page is shown as text only.

document.documentElement.classList.add("js");
const all = (selector, within = document) => [...within.querySelectorAll(selector)];
const minus = (text) => text.replace("-", "\u2212");

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}

const tools = document.getElementById("tools");
const said = document.getElementById("said");

/** Tell a screen reader what was done, and everybody what they must know. */
function say(text, isForAll = false) {
  if (!said) return;
  said.textContent = text;
  said.classList.toggle("is-quiet", !isForAll);
  tools?.classList.toggle("has-word", isForAll);
}

const policy = document.querySelector('meta[http-equiv="Content-Security-Policy"]');
const isServed = Boolean(policy && policy.content.includes("connect-src 'self'"));

// ---- tests: one row each; whatever speaks of a test has its number ----
const tests = new Map();
for (const row of all("tr[data-t][data-test]")) {
  const { t, test, key = "", state = "ok" } = row.dataset;
  tests.set(t, { t, test, key, state, row, marks: [] });
}
for (const element of all("[data-t]")) tests.get(element.dataset.t)?.marks.push(element);
const nameOf = (t) => tests.get(t)?.test ?? "";

// ---- tables: sort ----
const collator = new Intl.Collator("en", { numeric: true, sensitivity: "base" });

function numberIn(text) {
  const found = /^\s*[-+\u2212]?\d[\d\u2009]*(\.\d+)?(e[-+\u2212]?\d+)?/i.exec(text);
  return found ? Number(found[0].replaceAll("\u2212", "-").replaceAll("\u2009", "")) : NaN;
}

function sortKey(cell, isNumber) {
  if (cell?.classList.contains("decision")) return decided(tests.get(cell.dataset.t))?.decision ?? "";
  const text = cell?.dataset.v ?? cell?.textContent.trim() ?? "";
  return isNumber ? numberIn(text) : text;
}

function compare(a, b, isNumber, sign) {
  if (!isNumber) return sign * collator.compare(a, b);
  if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b);
  return sign * (a - b);
}

function sortBy(table, head) {
  const isNumber = head.dataset.sort === "number";
  const goesDown = head.getAttribute("aria-sort") === "ascending";
  const body = table.tBodies[0];
  const keyed = [...body.rows].map((row) => [sortKey(row.cells[head.cellIndex], isNumber), row]);
  keyed.sort(([a], [b]) => compare(a, b, isNumber, goesDown ? -1 : 1));
  body.append(...keyed.map(([, row]) => row));
  for (const other of all("th[aria-sort]", table)) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", goesDown ? "descending" : "ascending");
  say(`sorted by ${head.textContent.trim()}, ${goesDown ? "last" : "first"} to ${goesDown ? "first" : "last"}`);
  table.dispatchEvent(new Event("rows"));
}

/** Whether the cells of a column say numbers, where the page does not say what they are. */
function holdsNumbers(table, head) {
  const cells = [...table.tBodies[0].rows].map((row) => row.cells[head.cellIndex]?.textContent.trim() ?? "");
  const known = cells.filter((text) => !Number.isNaN(numberIn(text)));
  return known.length > cells.length / 2;
}

for (const table of all("table.sortable")) {
  for (const head of all("thead th", table)) {
    head.dataset.sort ??= holdsNumbers(table, head) ? "number" : "text";
    const button = make("button", { type: "button", class: "sort" }, ...head.childNodes);
    button.addEventListener("click", () => sortBy(table, head));
    head.append(button);
  }
}

// ---- tables: filter by words and states ----
const STATES = ["ok", "doubtful", "failed", "rejected", "unread"];

function wordsOf(row) {
  const cells = [...row.cells].filter((cell) => !cell.classList.contains("decision"));
  return cells.map((cell) => cell.textContent).join(" ").toLowerCase();
}

function stateOf(row) {
  const own = tests.get(row.dataset.t);
  return (own && decided(own)?.decision === "reject" && "rejected") || row.dataset.state;
}

function addFinder(table) {
  const rows = [...table.tBodies[0].rows];
  const words = new Map(rows.map((row) => [row, wordsOf(row)]));
  const name = table.caption?.textContent.trim() || "rows";
  const input = make("input", { type: "search", "aria-label": `Find in ${name}`, placeholder: "find" });
  const shown = make("output", {});
  const canReject = table.querySelector(".decision") !== null;
  const states = STATES.filter((state) => rows.some((row) => row.dataset.state === state)
    || (state === "rejected" && canReject));
  const wanted = new Set();
  const buttons = (states.length > 1 ? states : []).map((state) =>
    make("button", { type: "button", "aria-pressed": "false", "data-state": state }, state));

  function apply() {
    const needed = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    let count = 0;
    for (const row of rows) {
      const fits = (!wanted.size || wanted.has(stateOf(row)))
        && needed.every((word) => words.get(row).includes(word));
      row.hidden = !fits;
      count += fits;
    }
    shown.textContent = count === rows.length ? `${count} rows` : `${count} of ${rows.length} rows`;
    table.dispatchEvent(new Event("rows"));
  }

  function toggle(button) {
    const { state } = button.dataset;
    if (!wanted.delete(state)) wanted.add(state);
    button.setAttribute("aria-pressed", String(wanted.has(state)));
    apply();
  }
  for (const button of buttons) button.addEventListener("click", () => toggle(button));
  input.addEventListener("input", apply);
  table.addEventListener("show-all", () => {
    input.value = "";
    for (const button of buttons.filter((each) => wanted.has(each.dataset.state))) toggle(button);
    apply();
  });
  const place = table.closest(".wide") ?? table;
  place.before(make("div", { class: "finder", role: "search", "aria-label": name }, input, ...buttons, shown));
  apply();
}

// ---- what scrolls sideways can be reached by keyboard, and only that ----
function reach(box) {
  const scrolls = box.scrollWidth > box.clientWidth;
  const name = box.querySelector("caption, th")?.textContent.trim() || "table";
  for (const [key, value] of Object.entries({ tabindex: "0", role: "group", "aria-label": name })) {
    if (scrolls) box.setAttribute(key, value);
    else box.removeAttribute(key);
  }
}
const widths = new ResizeObserver((changes) => { for (const { target } of changes) reach(target); });
for (const box of all(".wide")) widths.observe(box);
