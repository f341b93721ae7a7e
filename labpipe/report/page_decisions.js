// What a report does in a browser, third part: decisions on tests, kept here until they are saved.

const pageData = JSON.parse(document.getElementById("page-data")?.textContent || "{}");
const STORE = `labpipe:${pageData.campaign ?? ""}`;
const WITHOUT_WORDS = "accepted on the page of the report, without a remark";
const DONE = { accept: "accepted", reject: "rejected" };

/** The decision of decisions.json that counts for a test: the last one on its key. */
function known(test) {
  test.known ??= (pageData.decisions ?? []).findLast(
    (each) => each.test === test.test && each.run === test.key) ?? {};
  return test.known;
}

/** What holds in this page: what was decided here, else what decisions.json says. */
function decided(test) {
  if (!test) return null;
  const draft = drafts.get(test.t);
  return draft?.decision ? draft : known(test).decision ? known(test) : null;
}

// ---- kept by the browser, where it does so ----
const drafts = new Map(); // by number of the test: {decision, because, when}
let who = "";
let isKept = true;

function keyOf(test) { return `${test.test}\n${test.key}`; }

function recall() {
  let kept = {};
  try {
    kept = JSON.parse(localStorage.getItem(STORE) ?? "{}");
  } catch {
    isKept = false;
  }
  who = typeof kept.by === "string" ? kept.by : "";
  drafts.clear();
  for (const test of tests.values()) {
    const draft = kept.drafts?.[keyOf(test)];
    if (draft && !isSaved(test, draft)) {
      drafts.set(test.t, { decision: DONE[draft.decision] ? draft.decision : "",
        because: String(draft.because ?? ""), when: String(draft.when ?? ""), isInFile: draft.isInFile === true });
    }
  }
}

function keep() {
  let kept = {};
  try {
    kept = JSON.parse(localStorage.getItem(STORE) ?? "{}");
  } catch { /* anew */ }
  kept = { by: who, drafts: { ...kept.drafts } }; // with those of another report of the campaign
  for (const test of tests.values()) {
    const draft = drafts.get(test.t);
    if (draft) kept.drafts[keyOf(test)] = draft;
    else delete kept.drafts[keyOf(test)];
  }
  try {
    localStorage.setItem(STORE, JSON.stringify(kept));
    isKept = true;
  } catch {
    isKept = false;
  }
}

/** Whether decisions.json has it, or a later one. */
function isSaved(test, draft) {
  const last = known(test);
  return Boolean(last.decision) && Date.parse(last.when) >= Date.parse(draft.when);
}

// ---- what is to be saved ----
function whyOf(draft) {
  return draft.because.trim() || (draft.decision === "accept" ? WITHOUT_WORDS : "");
}

function standing() {
  const found = { inFile: [], whole: [], open: [], remarks: [] };
  for (const [t, draft] of drafts) {
    const isWhole = draft.decision && whyOf(draft);
    const kind = isWhole ? (draft.isInFile ? "inFile" : "whole") : draft.decision ? "open" : "remarks";
    found[kind].push({ test: tests.get(t), draft });
  }
  return found;
}

/** Decisions made here, as decisions.json has them: also those saved before, for each file is whole. */
function entries() {
  const { inFile, whole } = standing();
  return [...inFile, ...whole].map(({ test, draft }) => ({ test: test.test, run: test.key,
    decision: draft.decision, because: whyOf(draft), by: who.trim(), when: draft.when }));
}

/** Complain of what is missing, and go there. */
function missing() {
  const { inFile, whole, open } = standing();
  if (open.length) {
    const { test } = open[0];
    focusIn(test, "input");
    return `${test.test}: a rejection requires a reason.`;
  }
  if (!whole.length && !inFile.length) return "All decisions are saved.";
  if (!who.trim()) {
    nameField.focus();
    return "Enter the name of the person who decides.";
  }
  return "";
}

function save() {
  const lacking = missing();
  if (lacking) { say(lacking, true); return; }
  if (isServed) post();
  else download();
}

function several(count, what) { return `${count} ${what}${count === 1 ? "" : "s"}`; }

function download() {
  const own = entries();
  const whole = { schema: 1, campaign: pageData.campaign ?? "",
    decisions: [...(pageData.decisions ?? []), ...own] };
  const file = new Blob([JSON.stringify(whole, null, 2), "\n"], { type: "application/json" });
  const link = make("a", { href: URL.createObjectURL(file), download: "decisions.json" });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
  for (const { draft } of standing().whole) draft.isInFile = true;
  keep();
  showTools();
  say(`${several(own.length, "decision")} saved in decisions.json. `
    + "Import it with: labpipe campaign decide FOLDER --from decisions.json; then make the report again.", true);
}

async function post() {
  const own = entries();
  try {
    const answer = await fetch("decisions", { method: "POST", headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ schema: 1, campaign: pageData.campaign ?? "", decisions: own }) });
    const told = await answer.json();
    if (!answer.ok) { say(told.error, true); return; }
    pageData.decisions = told.decisions;
    for (const test of tests.values()) delete test.known;
    for (const test of tests.values()) if (drafts.has(test.t) && isSaved(test, drafts.get(test.t))) drafts.delete(test.t);
    keep();
    showAll();
    say(told.message, true);
    again.hidden = false;
  } catch {
    say("labpipe serve does not answer: start it again. Your decisions are kept in this page.", true);
  }
}

async function makeAgain() {
  say("The report is being made again ...", true);
  again.disabled = true;
  try {
    const answer = await fetch("report", { method: "POST" });
    if (answer.ok) { location.reload(); return; }
    say((await answer.json()).error, true);
  } catch {
    say("labpipe serve does not answer: start it again.", true);
  }
  again.disabled = false;
}

// ---- controls of one test ----
const controls = new Map(); // by container: {test, accept, reject, input}

function addControls(place) {
  const test = tests.get(place.dataset.t);
  if (!test) return;
  if (!test.key) {
    place.append(make("small", {}, "made before tests had keys: process it again to decide"));
    return;
  }
  const button = (decision) => make("button", { type: "button", class: decision, tabindex: "-1",
    "aria-pressed": "false", "aria-label": `${decision} ${test.test}`, onclick: () => decide(test, decision) }, decision);
  const input = make("input", { type: "text", class: "because", maxlength: "500", tabindex: "-1",
    placeholder: "why", "aria-label": `why, ${test.test}`, oninput: () => remark(test, input.value) });
  const own = { test, accept: button("accept"), reject: button("reject"), input };
  place.append(make("div", { class: "controls", role: "group", "aria-label": `Decision on ${test.test}` },
    own.accept, own.reject, input));
  place.addEventListener("keydown", (event) => keyOn(event, place, own));
  place.addEventListener("focusin", () => makeActive(place));
  controls.set(place, own);
}

function decide(test, decision) {
  const draft = drafts.get(test.t) ?? { decision: "", because: "" };
  const isOff = draft.decision === decision;
  if (!draft.decision && known(test).decision === decision) {
    say(`${test.test} is ${DONE[decision]} already: ${known(test).because} (${known(test).by})`, true);
    return;
  }
  drafts.set(test.t, { because: draft.because, decision: isOff ? "" : decision, when: now() });
  if (isOff && !draft.because) drafts.delete(test.t);
  changed(test);
  const state = drafts.get(test.t)?.decision;
  say(`${test.test}: ${state ? DONE[state] : "not decided here"}`
    + `${state === "reject" && !draft.because ? "; enter the reason" : ""}`);
}

function remark(test, because) {
  const draft = drafts.get(test.t) ?? { decision: "" };
  if (!because && !draft.decision) drafts.delete(test.t);
  else drafts.set(test.t, { decision: draft.decision, because, when: now() });
  changed(test);
}

function now() { return new Date().toISOString().replace(/\.\d+Z$/, "+00:00"); }

function changed(test) {
  say("");
  keep();
  show(test);
  showTools();
}

function show(test) {
  const holds = decided(test), draft = drafts.get(test.t);
  for (const mark of test.marks) {
    mark.classList.toggle("is-rejected", holds?.decision === "reject");
    mark.classList.toggle("is-accepted", holds?.decision === "accept");
  }
  for (const place of test.marks) {
    const own = controls.get(place);
    if (!own) continue;
    own.accept.setAttribute("aria-pressed", String(holds?.decision === "accept"));
    own.reject.setAttribute("aria-pressed", String(holds?.decision === "reject"));
    const because = draft ? draft.because ?? "" : "";
    if (own.input.value !== because) own.input.value = because;
    own.input.classList.toggle("is-needed", draft?.decision === "reject" && !because.trim());
    place.classList.toggle("is-draft", Boolean(draft?.decision));
  }
}

function showAll() {
  for (const test of tests.values()) show(test);
  showTools();
}

// ---- keyboard: one tab stop a list; arrows go from test to test, letters decide ----
function listOf(place) { return place.closest("table") ?? place.closest("section, ul, ol") ?? document.body; }

function placesIn(list) {
  return all(".decision", list).filter((place) => controls.has(place)
    && listOf(place) === list && !place.closest("[hidden]"));
}

function makeActive(place) {
  for (const other of all(".decision", listOf(place))) {
    const own = controls.get(other);
    const index = other === place ? "0" : "-1";
    for (const each of own ? [own.accept, own.reject, own.input] : []) each.setAttribute("tabindex", index);
  }
}

function keyOn(event, place, own) {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const isTyping = event.target === own.input;
  const moves = { ArrowDown: 1, ArrowUp: -1 };
  if (event.key in moves) go(place, moves[event.key], event.target);
  else if (isTyping && (event.key === "Enter" || event.key === "Escape")) own.reject.focus();
  else if (isTyping) return;
  else if (event.key === "a") decide(own.test, "accept");
  else if (event.key === "r") { decide(own.test, "reject"); if (drafts.get(own.test.t)?.decision) own.input.focus(); }
  else if (event.key === "c") own.input.focus();
  else return;
  event.preventDefault();
}

function go(place, step, from) {
  const places = placesIn(listOf(place));
  const next = controls.get(places[places.indexOf(place) + step]);
  const which = ["accept", "reject", "input"].find((name) => controls.get(place)[name] === from);
  next?.[which ?? "accept"].focus();
}

function focusIn(test, which) {
  if (test.row.hidden) test.row.closest("table").dispatchEvent(new Event("show-all"));
  const place = test.marks.find((each) => controls.has(each));
  for (let up = place; up; up = up.parentElement) if (up.tagName === "DETAILS") up.open = true;
  controls.get(place)[which].focus();
}

/** After sorting and filtering the first test that is shown has the tab stop. */
function resetActive(list) {
  const places = placesIn(list);
  const has = places.some((place) => controls.get(place).accept.getAttribute("tabindex") === "0");
  if (places.length && !has) makeActive(places[0]);
}

// ---- the bar: whose decisions, how many, save ----
const nameField = make("input", { type: "text", class: "by", autocomplete: "name", maxlength: "100",
  oninput: () => { who = nameField.value; keep(); } });
const count = make("output", { class: "count" });
const saveButton = make("button", { type: "button", class: "save", onclick: save },
  isServed ? "Save decisions" : "Save decisions.json");
const forget = make("button", { type: "button", class: "forget", onclick: () => {
  drafts.clear();
  keep();
  showAll();
  say("Unsaved decisions are discarded.");
} }, "Forget");
const again = make("button", { type: "button", class: "again", hidden: true, onclick: makeAgain },
  "Make the report again");
const keys = make("details", { class: "shortcuts" }, make("summary", {}, "Keys"),
  "On a test: a accepts, r rejects, c goes to the reason, \u2191 \u2193 to the next test, Enter back. "
  + "On a figure: \u2190 \u2192 along a curve, \u2191 \u2193 to the next one, + \u2212 0 zoom, Shift and arrows move the view, "
  + "Shift and click in the legend shows one curve alone.");

function showTools() {
  const { inFile, whole, open, remarks } = standing();
  const parts = [];
  if (inFile.length) parts.push(`${several(inFile.length, "decision")} saved in a file`);
  if (whole.length) parts.push(`${several(whole.length, "decision")} not saved`);
  if (open.length) parts.push(`${open.length} without a reason`);
  if (remarks.length) parts.push(`${several(remarks.length, "remark")} without a decision`);
  const isAny = parts.length > 0;
  if (inFile.length + whole.length + open.length) parts.push("the numbers of this report do not know of them yet");
  if (isAny && !isKept) parts.push("this browser keeps nothing: save before you close the page");
  count.textContent = parts.join("; ") || "Nothing decided here";
  tools.classList.toggle("has-drafts", isAny);
  forget.hidden = saveButton.hidden = !isAny;
  nameField.value = nameField.value === who ? nameField.value : who;
}

// ---- begin ----
for (const table of all("table.filter")) addFinder(table);
for (const figure of all("figure.plot")) {
  const area = figure.querySelector("svg.area[data-x0]");
  if (area) new Plot(figure, area);
}
if (isServed) {
  for (const head of all("[data-page]")) {
    const href = head.dataset.page.split("/").map(encodeURIComponent).join("/");
    head.append(" ", make("a", { class: "test-page", href }, "page"));
  }
}
if (tools && tests.size) {
  recall();
  for (const place of all(".decision[data-t]")) addControls(place);
  tools.append(make("label", {}, "Decided by ", nameField), saveButton, forget, again, count, keys, said ?? "");
  tools.hidden = false;
  for (const list of new Set([...controls.keys()].map(listOf))) {
    resetActive(list);
    list.addEventListener("rows", () => resetActive(list));
  }
  showAll();
  window.addEventListener("storage", (event) => { if (event.key === STORE) { recall(); showAll(); } });
  window.addEventListener("beforeunload", (event) => { if (!isKept && drafts.size) event.preventDefault(); });
}

/** A link to a row leads there even where it is folded away or filtered out. */
function unfold() {
  const goal = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!goal) return;
  if (goal.hidden) goal.closest("table")?.dispatchEvent(new Event("show-all"));
  for (let up = goal; up; up = up.parentElement) if (up.tagName === "DETAILS") up.open = true;
  goal.scrollIntoView();
}
window.addEventListener("hashchange", unfold);
unfold();
