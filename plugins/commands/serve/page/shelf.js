"use strict";
// The runs of the folder: searched, sorted, compared, followed over time, labelled.

const COLUMNS = [ // heading, column that it sorts by
  ["Run", "run"], ["Date", "created"], ["Serial", "serial"], ["Tags and notes", "tags"], ["Outcome", "outcome"],
  ["Verdict", "verdict"], ["Accepted", "accepted"], ["R_s", "resistance_ohm"], ["L_dd", "l_dd_h"], ["L_qq", "l_qq_h"],
  ["Flux", "rated_flux_wb"], ["Map error", "map_error_percent"],
];
const MAX_COMPARED = 8;
const MOODS = { finished: "good", pass: "good", faulted: "bad", fail: "bad", "": "", "not ended": "warning", aborted: "warning" };
const search = $("search"), labels = $("labels");
let sort = "-created", shown = 0, asked = 0, edited = null;
const ticked = new Set();

async function answered(path, options) {
  const answer = await fetch(path, { signal: AbortSignal.timeout(180000), ...options });
  const content = await answer.json().catch(() => ({ problem: `the server says ${answer.status}` }));
  if (!answer.ok) throw new Error(content.problem);
  return content;
}

function post(path, body) {
  return answered(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
}

async function attempt(work) {
  set("wrong", "");
  try { await work(); } catch (error) { set("wrong", error.message); }
}

// The list -----------------------------------------------------------------------------------------------------------

async function list(skip) {
  const number = ++asked;
  const wanted = new URLSearchParams({ words: search.words.value, sort, skip });
  const found = await answered(`/listed?${wanted}`);
  if (number !== asked) return; // a later question is under way
  const drawn = found.rows.map(runRow);
  if (skip === 0) $("rows").replaceChildren(...drawn); else $("rows").append(...drawn);
  shown = skip + drawn.length;
  set("count", `${shown} of ${found.count} ${found.count === 1 ? "run" : "runs"}`);
  $("more").hidden = shown >= found.count;
  $("unreadable").replaceChildren(...found.unreadable.map((problem) => element("li", problem)));
}

const again = () => attempt(() => list(0));

function drawHead() {
  const cells = COLUMNS.map(([heading, column]) => {
    const cell = element("th"), by = sort.replace("-", "") === column;
    const button = element("button", heading + (by ? (sort.startsWith("-") ? " ↓" : " ↑") : ""), "heading");
    button.type = "button";
    button.onclick = () => { sort = by && !sort.startsWith("-") ? `-${column}` : column; drawHead(); again(); };
    if (by) cell.setAttribute("aria-sort", sort.startsWith("-") ? "descending" : "ascending");
    cell.append(button);
    return cell;
  });
  $("head").replaceChildren(element("th"), ...cells);
}

function runRow(row) {
  const line = element("tr"), tick = element("input"), first = element("td"), what = element("td", "", "name"), does = element("div", "", "does");
  Object.assign(tick, { type: "checkbox", checked: ticked.has(row.run), ariaLabel: `compare ${row.run}` });
  tick.onchange = () => { if (tick.checked) ticked.add(row.run); else ticked.delete(row.run); drawTicked(); };
  first.append(tick);
  what.append(element("div", row.run), element("div", row.motor, "under"));
  const causes = element("td", "", "text");
  causes.append(element("div", row.verdict.replaceAll("_", " ")), element("div", row.causes, "under"));
  const accepted = element("td", "", "text");
  accepted.append(element("div", row.accepted, MOODS[row.accepted]), element("div", row.objections, "under"));
  const notes = element("td", "", "text");
  notes.append(element("div", row.tags), element("div", row.notes, "under"));
  if (row.has_report) {
    const link = element("a", "Report", "button");
    Object.assign(link, { href: `/report/${encodeURIComponent(row.run)}`, target: "_blank", rel: "noopener" });
    does.append(link);
  }
  for (const [name, work] of [["View", () => view(row.run, line)], ["Trend", () => trend(row)], ["Notes", () => edit(row)]]) {
    const button = element("button", name);
    button.type = "button";
    button.onclick = () => attempt(work);
    does.append(button);
  }
  what.append(does);
  const numbers = ["resistance_ohm", "l_dd_h", "l_qq_h", "rated_flux_wb", "map_error_percent"].map((name) => element("td", row[name], "number"));
  line.append(
    first, what, element("td", row.created.slice(0, 16).replace("T", " "), "date"), element("td", row.serial), notes,
    element("td", row.outcome, MOODS[row.outcome]), causes, accepted, ...numbers,
  );
  return line;
}

function drawTicked() {
  const count = ticked.size;
  $("compare").disabled = count < 2 || count > MAX_COMPARED;
  set("compare", count > MAX_COMPARED ? `Compare at most ${MAX_COMPARED}` : count ? `Compare ${count}` : "Compare");
}

// Comparison and trend -------------------------------------------------------------------------------------------------

function drawTable(table, rows) {
  const [head, ...body] = rows;
  const line = (cells, kind) => { const row = element("tr"); row.append(...cells.map((cell) => element(kind, cell))); return row; };
  table.replaceChildren(line(head, "th"), ...body.map((cells) => line(cells, "td")));
}

function drawCurves(svg, curves, axis) {
  const own = curves.filter((curve) => curve.axis === axis && curve.current_a.length > 1);
  if (own.length === 0) return svg.replaceChildren();
  const milli = own.map((curve) => curve.flux_wb.map((flux) => 1000 * flux));
  const a = axes(svg, span(own.flatMap((curve) => curve.current_a), 0.01), span(milli.flat(), 0.01), `i_${axis} [A]`, "");
  own.forEach((curve, k) => {
    const path = curve.current_a.map((current, n) => `${n ? "L" : "M"}${a.x(current).toFixed(1)} ${a.y(milli[k][n]).toFixed(1)}`).join("");
    a.parts.push(drawn("path", { d: path, class: `series s${curve.run}` }));
  });
  svg.replaceChildren(...a.parts);
}

async function compare() {
  const wanted = new URLSearchParams([...ticked].map((run) => ["runs", run]));
  set("compare", "comparing");
  $("compare").disabled = true;
  try {
    const found = await answered(`/compared?${wanted}`);
    $("remarks").replaceChildren(...found.remarks.map((remark) => element("li", remark)));
    $("keys").replaceChildren(...found.names.map((name, k) => element("span", `— ${name}`, `key s${k}`)));
    drawCurves($("curve_d"), found.curves, "d");
    drawCurves($("curve_q"), found.curves, "q");
    drawTable($("compared"), found.tables[0]);
    drawTable($("changes"), found.tables[1]);
    $("comparison").hidden = false;
    $("comparison").scrollIntoView({ block: "start" });
  } finally { drawTicked(); }
}

function drawTrend(svg, points, name, factor) {
  const own = points.filter((point) => point[name] !== null);
  if (own.length === 0) return svg.replaceChildren();
  const days = own.map((point) => Date.parse(point.created) / 86400000), last = days[days.length - 1];
  const values = own.map((point) => point[name].map((value) => factor * value));
  const a = axes(svg, span(days.map((day) => day - last), 0.02), span(values.flat(), 1e-9), `days before ${own[own.length - 1].created.slice(0, 10)}`, "");
  own.forEach((point, k) => {
    const x = a.x(days[k] - last), [value, low, high] = values[k];
    const dot = drawn("circle", { cx: x, cy: a.y(value), r: 3, class: "dot" });
    dot.append(drawn("title", {}, `${point.run}: ${Number(value.toPrecision(5))}`));
    a.parts.push(drawn("path", { d: `M${x} ${a.y(low)}V${a.y(high)}`, class: "d" }), dot);
  });
  svg.replaceChildren(...a.parts);
}

async function trend(row) {
  const found = await answered(`/trend?${new URLSearchParams({ motor: row.motor, serial: row.serial })}`);
  set("trendof", [found.motor, found.serial || "no serial number", `${found.points.length} runs`].join(" · "));
  drawTrend($("trend_r"), found.points, "resistance_ohm", 1);
  drawTrend($("trend_flux"), found.points, "rated_flux_wb", 1000);
  $("trend").hidden = false;
  $("trend").scrollIntoView({ block: "start" });
}

// Viewer and notes -----------------------------------------------------------------------------------------------------

async function view(run, line) {
  const button = [...line.querySelectorAll("button")].find((one) => one.textContent === "View");
  Object.assign(button, { textContent: "opening", disabled: true });
  try {
    const { address } = await post("/view", { run });
    const link = element("a", "Viewer", "button");
    Object.assign(link, { href: address, target: "_blank", rel: "noopener" });
    button.replaceWith(link);
    window.open(address, "_blank", "noopener"); // a browser may refuse that; the link stays
  } catch (error) { Object.assign(button, { textContent: "View", disabled: false }); throw error; }
}

async function edit(row) {
  const { tags, notes } = await answered(`/labels?${new URLSearchParams({ run: row.run })}`);
  edited = row;
  set("labelsof", row.run);
  labels.tags.value = tags.join(", ");
  labels.notes.value = notes.join("\n");
  labels.hidden = false;
  labels.scrollIntoView({ block: "center" });
  labels.notes.focus();
}

labels.onsubmit = (event) => {
  event.preventDefault();
  const words = (text, by) => text.split(by).map((word) => word.trim()).filter(Boolean);
  attempt(async () => {
    await post("/label", { run: edited.run, tags: words(labels.tags.value, ","), notes: words(labels.notes.value, "\n") });
    labels.hidden = true;
    await list(0);
  });
};

let waiting = null;
search.onsubmit = (event) => { event.preventDefault(); again(); };
search.words.oninput = () => { clearTimeout(waiting); waiting = setTimeout(again, 250); };
$("more").onclick = () => attempt(() => list(shown));
$("compare").onclick = () => attempt(compare);
for (const name of ["comparison", "trend", "labels"]) $(`close${name}`).onclick = () => { $(name).hidden = true; };
drawHead();
again();
