// Script of a report page, third of three parts: decisions on tests, stored by the browser until they are saved.

const pageData = JSON.parse(document.getElementById("page-data")?.textContent || "{}");
const STORAGE_KEY = `labpipe:${pageData.campaign ?? ""}`;
const DEFAULT_REASON = "accepted on the page of the report, without a remark";
const PAST_TENSE = { accept: "accepted", reject: "rejected" };

/** Find the last saved decision on the run of a test; empty if there is none. */
function findSavedDecision(test) {
  test.savedDecision ??= (pageData.decisions ?? []).findLast(
    (entry) => entry.test === test.name && entry.run === test.key) ?? {};
  return test.savedDecision;
}

/** Get the draft of the decision on a test, or else the saved decision; null if there is none. */
function getDecision(test) {
  if (!test) return null;
  const draft = drafts.get(test.number), saved = findSavedDecision(test);
  return draft?.decision ? draft : saved.decision ? saved : null;
}

// ---- drafts: decisions that are not saved, in the storage of the browser ----
const drafts = new Map(); // keyed by number of the test: {decision, because, when, isInFile}
let author = "";
let hasStorage = true; // whether the browser allows the page to store drafts

function getStorageKey(test) { return `${test.name}\n${test.key}`; }

/** Read the stored data of all reports of the campaign; null if they are damaged or not accessible. */
function readStorage() {
  try {
    return JSON.parse(localStorage.getItem(STORAGE_KEY) ?? "{}");
  } catch {
    return null;
  }
}

/** Load the drafts of the tests of this report, except those saved in the meantime. */
function loadDrafts() {
  const storage = readStorage();
  if (!storage) hasStorage = false;
  author = typeof storage?.by === "string" ? storage.by : "";
  drafts.clear();
  for (const test of tests.values()) {
    const draft = storage?.drafts?.[getStorageKey(test)];
    if (draft && !isSaved(test, draft)) {
      drafts.set(test.number, { decision: PAST_TENSE[draft.decision] ? draft.decision : "",
        because: String(draft.because ?? ""), when: String(draft.when ?? ""), isInFile: draft.isInFile === true });
    }
  }
}

/** Store the drafts of this report; those of other reports of the campaign are kept. */
function storeDrafts() {
  const storedDrafts = { ...readStorage()?.drafts };
  for (const test of tests.values()) {
    const draft = drafts.get(test.number);
    if (draft) storedDrafts[getStorageKey(test)] = draft;
    else delete storedDrafts[getStorageKey(test)];
  }
  try {
    localStorage.setItem(STORAGE_KEY, JSON.stringify({ by: author, drafts: storedDrafts }));
    hasStorage = true;
  } catch {
    hasStorage = false;
  }
}

/** Return whether decisions.json has a decision on the test that is as late as the draft. */
function isSaved(test, draft) {
  const saved = findSavedDecision(test);
  return Boolean(saved.decision) && Date.parse(saved.when) >= Date.parse(draft.when);
}

// ---- save ----
function getReason(draft) {
  return draft.because.trim() || (draft.decision === "accept" ? DEFAULT_REASON : "");
}

/** Sort the drafts: saved in a file, complete, without a required reason, remarks without a decision. */
function classifyDrafts() {
  const classes = { inFile: [], complete: [], incomplete: [], remarks: [] };
  for (const [number, draft] of drafts) {
    const isComplete = draft.decision && getReason(draft);
    const decidedClass = isComplete ? (draft.isInFile ? "inFile" : "complete") : "incomplete";
    classes[draft.decision ? decidedClass : "remarks"].push({ test: tests.get(number), draft });
  }
  return classes;
}

/** Make entries of decisions.json of all complete drafts, including those in an earlier file. */
function makeEntries() {
  const { inFile, complete } = classifyDrafts();
  return [...inFile, ...complete].map(({ test, draft }) => ({ test: test.name, run: test.key,
    decision: draft.decision, because: getReason(draft), by: author.trim(), when: draft.when }));
}

/** Return why the decisions cannot be saved, and focus the field to fill in; empty if they can. */
function findObstacle() {
  const { inFile, complete, incomplete } = classifyDrafts();
  if (incomplete.length) {
    const { test } = incomplete[0];
    focusReason(test);
    return `${test.name}: a rejection requires a reason.`;
  }
  if (!complete.length && !inFile.length) return "All decisions are saved.";
  if (!author.trim()) {
    authorInput.focus();
    return "Enter the name of the person who decides.";
  }
  return "";
}

function save() {
  const obstacle = findObstacle();
  if (obstacle) showMessage(obstacle, true);
  else if (isServed) post();
  else download();
}

function formatCount(count, noun) { return `${count} ${noun}${count === 1 ? "" : "s"}`; }

/** Save a complete decisions.json: the earlier decisions of the page, and the drafts. */
function download() {
  const entries = makeEntries();
  const content = { schema: 1, campaign: pageData.campaign ?? "",
    decisions: [...(pageData.decisions ?? []), ...entries] };
  const file = new Blob([JSON.stringify(content, null, 2), "\n"], { type: "application/json" });
  const link = makeElement("a", { href: URL.createObjectURL(file), download: "decisions.json" });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000); // ms
  for (const { draft } of classifyDrafts().complete) draft.isInFile = true;
  storeDrafts();
  updateToolbar();
  showMessage(`${formatCount(entries.length, "decision")} saved in decisions.json. `
    + "Import it with: labpipe campaign decide FOLDER --from decisions.json; then make the report again.", true);
}

/** Send the drafts to the server of the page, which saves them. */
async function post() {
  const content = { schema: 1, campaign: pageData.campaign ?? "", decisions: makeEntries() };
  try {
    const response = await fetch("decisions", { method: "POST", headers: { "Content-Type": "application/json" },
      body: JSON.stringify(content) });
    const reply = await response.json();
    if (!response.ok) { showMessage(reply.error, true); return; }
    pageData.decisions = reply.decisions;
    for (const test of tests.values()) {
      delete test.savedDecision;
      const draft = drafts.get(test.number);
      if (draft && isSaved(test, draft)) drafts.delete(test.number);
    }
    storeDrafts();
    updateAll();
    showMessage(reply.message, true);
    remakeButton.hidden = false;
  } catch {
    showMessage("labpipe serve does not answer: start it again. Your decisions are kept in this page.", true);
  }
}

/** Ask the server of the page to make the report again, and load the new page. */
async function remakeReport() {
  showMessage("The report is being made again ...", true);
  remakeButton.disabled = true;
  try {
    const response = await fetch("report", { method: "POST" });
    if (response.ok) { location.reload(); return; }
    showMessage((await response.json()).error, true);
  } catch {
    showMessage("labpipe serve does not answer: start it again.", true);
  }
  remakeButton.disabled = false;
}

// ---- controls of a test: accept, reject, reason ----
const controls = new Map(); // keyed by container: {test, accept, reject, input}

function addControls(container) {
  const test = tests.get(container.dataset.t);
  if (!test) return;
  if (!test.key) {
    container.append(makeElement("small", {}, "made before tests had keys: process it again to decide"));
    return;
  }
  const makeButton = (decision) => makeElement("button", { type: "button", class: decision, tabindex: "-1",
    "aria-pressed": "false", "aria-label": `${decision} ${test.name}`, onclick: () => toggleDecision(test, decision) }, decision);
  const input = makeElement("input", { type: "text", class: "because", maxlength: "500", tabindex: "-1",
    placeholder: "why", "aria-label": `why, ${test.name}`, oninput: () => setReason(test, input.value) });
  const control = { test, accept: makeButton("accept"), reject: makeButton("reject"), input };
  container.append(makeElement("div", { class: "controls", role: "group", "aria-label": `Decision on ${test.name}` },
    control.accept, control.reject, input));
  container.addEventListener("keydown", (event) => handleKey(event, container, control));
  container.addEventListener("focusin", () => setTabStop(container));
  controls.set(container, control);
}

/** Draft a decision; the same decision again removes it. */
function toggleDecision(test, decision) {
  const draft = drafts.get(test.number) ?? { decision: "", because: "" };
  const isRemoved = draft.decision === decision;
  const saved = findSavedDecision(test);
  if (!draft.decision && saved.decision === decision) {
    showMessage(`${test.name} is ${PAST_TENSE[decision]} already: ${saved.because} (${saved.by})`, true);
    return;
  }
  drafts.set(test.number, { because: draft.because, decision: isRemoved ? "" : decision, when: formatNow() });
  if (isRemoved && !draft.because) drafts.delete(test.number);
  updateChanged(test);
  const draftedDecision = drafts.get(test.number)?.decision;
  showMessage(`${test.name}: ${draftedDecision ? PAST_TENSE[draftedDecision] : "not decided here"}`
    + `${draftedDecision === "reject" && !draft.because ? "; enter the reason" : ""}`);
}

function setReason(test, because) {
  const draft = drafts.get(test.number) ?? { decision: "" };
  if (!because && !draft.decision) drafts.delete(test.number);
  else drafts.set(test.number, { decision: draft.decision, because, when: formatNow() });
  updateChanged(test);
}

/** Return the time in UTC to the second, as in decisions.json. */
function formatNow() { return new Date().toISOString().replace(/\.\d+Z$/, "+00:00"); }

function updateChanged(test) {
  showMessage("");
  storeDrafts();
  updateTest(test);
  updateToolbar();
}

/** Show the decision on a test at all its elements. */
function updateTest(test) {
  const decision = getDecision(test)?.decision, draft = drafts.get(test.number), because = draft?.because ?? "";
  for (const element of test.elements) {
    element.classList.toggle("is-rejected", decision === "reject");
    element.classList.toggle("is-accepted", decision === "accept");
    const control = controls.get(element);
    if (!control) continue;
    control.accept.setAttribute("aria-pressed", String(decision === "accept"));
    control.reject.setAttribute("aria-pressed", String(decision === "reject"));
    if (control.input.value !== because) control.input.value = because;
    control.input.classList.toggle("is-needed", draft?.decision === "reject" && !because.trim());
    element.classList.toggle("is-draft", Boolean(draft?.decision));
  }
}

function updateAll() {
  for (const test of tests.values()) updateTest(test);
  updateToolbar();
}

// ---- keyboard: a list of tests is one stop of the Tab key; arrow keys move between tests, letters decide ----
function findList(container) { return container.closest("table") ?? container.closest("section, ul, ol") ?? document.body; }

/** List the visible containers of controls in a list. */
function listContainers(list) {
  return selectAll(".decision", list).filter((container) => controls.has(container)
    && findList(container) === list && !container.closest("[hidden]"));
}

/** Make the controls of a container the only tab stop of its list. */
function setTabStop(activeContainer) {
  for (const container of selectAll(".decision", findList(activeContainer))) {
    const control = controls.get(container);
    const tabindex = container === activeContainer ? "0" : "-1";
    for (const element of control ? [control.accept, control.reject, control.input] : []) element.setAttribute("tabindex", tabindex);
  }
}

function handleKey(event, container, control) {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const isTyping = event.target === control.input;
  const steps = { ArrowDown: 1, ArrowUp: -1 };
  if (event.key in steps) moveFocus(container, steps[event.key], event.target);
  else if (isTyping && (event.key === "Enter" || event.key === "Escape")) control.reject.focus();
  else if (isTyping) return;
  else if (event.key === "a") toggleDecision(control.test, "accept");
  else if (event.key === "r") { toggleDecision(control.test, "reject"); if (drafts.get(control.test.number)?.decision) control.input.focus(); }
  else if (event.key === "c") control.input.focus();
  else return;
  event.preventDefault();
}

/** Move the focus to the same control of another test of the list. */
function moveFocus(container, step, focusedElement) {
  const containers = listContainers(findList(container));
  const nextControl = controls.get(containers[containers.indexOf(container) + step]);
  const name = ["accept", "reject", "input"].find((key) => controls.get(container)[key] === focusedElement);
  nextControl?.[name ?? "accept"].focus();
}

/** Open all folded sections that contain an element. */
function openSections(element) {
  for (let ancestor = element; ancestor; ancestor = ancestor.parentElement) if (ancestor.tagName === "DETAILS") ancestor.open = true;
}

function focusReason(test) {
  if (test.row.hidden) test.row.closest("table").dispatchEvent(new Event("show-all"));
  const container = test.elements.find((element) => controls.has(element));
  openSections(container);
  controls.get(container).input.focus();
}

/** Make the first visible test the tab stop of a list if no visible test is. */
function restoreTabStop(list) {
  const containers = listContainers(list);
  const hasTabStop = containers.some((container) => controls.get(container).accept.getAttribute("tabindex") === "0");
  if (containers.length && !hasTabStop) setTabStop(containers[0]);
}

// ---- toolbar: name of the author, counts of drafts, buttons ----
const authorInput = makeElement("input", { type: "text", class: "by", autocomplete: "name", maxlength: "100",
  oninput: () => { author = authorInput.value; storeDrafts(); } });
const draftCounts = makeElement("output", { class: "count" });
const saveButton = makeElement("button", { type: "button", class: "save", onclick: save },
  isServed ? "Save decisions" : "Save decisions.json");
const discardButton = makeElement("button", { type: "button", class: "forget", onclick: () => {
  drafts.clear();
  storeDrafts();
  updateAll();
  showMessage("Unsaved decisions are discarded.");
} }, "Discard");
const remakeButton = makeElement("button", { type: "button", class: "again", hidden: true, onclick: remakeReport },
  "Make the report again");
const shortcuts = makeElement("details", { class: "shortcuts" }, makeElement("summary", {}, "Keys"),
  "On a test: a accepts, r rejects, c moves to the reason, \u2191 \u2193 to another test, Enter back. "
  + "On a figure: \u2190 \u2192 move along a curve, \u2191 \u2193 to another curve, + \u2212 0 zoom, Shift and arrow keys move the view, "
  + "Shift and click in the legend shows one curve alone.");

function updateToolbar() {
  const { inFile, complete, incomplete, remarks } = classifyDrafts();
  const texts = [];
  if (inFile.length) texts.push(`${formatCount(inFile.length, "decision")} saved in a file`);
  if (complete.length) texts.push(`${formatCount(complete.length, "decision")} not saved`);
  if (incomplete.length) texts.push(`${incomplete.length} without a reason`);
  if (remarks.length) texts.push(`${formatCount(remarks.length, "remark")} without a decision`);
  if (inFile.length + complete.length + incomplete.length) texts.push("the numbers of this report do not include them");
  if (drafts.size && !hasStorage) texts.push("this browser cannot store them: save before you close the page");
  draftCounts.textContent = texts.join("; ") || "Nothing decided here";
  toolbar.classList.toggle("has-drafts", drafts.size > 0);
  discardButton.hidden = saveButton.hidden = !drafts.size;
  if (authorInput.value !== author) authorInput.value = author;
}

// ---- start ----
for (const table of selectAll("table.filter")) addFilter(table);
for (const figure of selectAll("figure.plot")) {
  const area = figure.querySelector("svg.area[data-x0]");
  if (area) new Plot(figure, area);
}
if (isServed) {
  for (const headingCell of selectAll("[data-page]")) {
    const href = headingCell.dataset.page.split("/").map(encodeURIComponent).join("/");
    headingCell.append(" ", makeElement("a", { class: "test-page", href }, "page"));
  }
}
if (toolbar && tests.size) {
  loadDrafts();
  for (const container of selectAll(".decision[data-t]")) addControls(container);
  toolbar.append(makeElement("label", {}, "Decided by ", authorInput), saveButton, discardButton, remakeButton, draftCounts,
    shortcuts, messageElement ?? "");
  toolbar.hidden = false;
  for (const list of new Set([...controls.keys()].map(findList))) {
    restoreTabStop(list);
    list.addEventListener("rows", () => restoreTabStop(list));
  }
  updateAll();
  window.addEventListener("storage", (event) => { if (event.key === STORAGE_KEY) { loadDrafts(); updateAll(); } });
  window.addEventListener("beforeunload", (event) => { if (!hasStorage && drafts.size) event.preventDefault(); });
}

/** Scroll to the element of the address; show it if it is filtered out or in a folded section. */
function showTarget() {
  const target = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!target) return;
  if (target.hidden) target.closest("table")?.dispatchEvent(new Event("show-all"));
  openSections(target);
  target.scrollIntoView();
}
window.addEventListener("hashchange", showTarget);
showTarget();
