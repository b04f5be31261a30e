"use strict";
// The page keeps nothing of its own: each event has the whole of how the run stands, and is drawn.

const form = $("form");
let view = null, wantsForm = false, known = null;

if (location.search) history.replaceState(null, "", "/"); // the token has become a cookie

function rows(list, pairs) {
  list.replaceChildren(...pairs.filter((pair) => pair[1]).flatMap(([label, text]) => [element("dt", label), element("dd", text)]));
}

async function ask(path, body, patience_ms = 1000) {
  const waiting = setTimeout(giveWay, patience_ms);
  const request = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  const answer = await fetch(path, { ...request, signal: AbortSignal.timeout(path === "/check" ? 150000 : 10000) }).finally(() => clearTimeout(waiting));
  const content = await answer.json().catch(() => ({ problem: `the server says ${answer.status}` }));
  if (!answer.ok) throw new Error(content.problem);
  return content;
}

// What is going on ---------------------------------------------------------------------------------------------------

function show(now) {
  const ended = view && view.going && !now.going;
  if (now.going && !(view && view.going)) wantsForm = false;
  view = now;
  if (ended) loadChoices();
  const p = now.picture;
  const busy = now.going && !(p && p.outcome); // what follows the outcome is the writing of report and view
  const showsRun = !wantsForm && (now.going || p !== null || now.problem !== "");
  $("run").hidden = !showsRun;
  form.hidden = showsRun || known === null;
  $("runs").hidden = now.going || known === null || known.runs.length + known.unreadable.length === 0;
  $("stopbar").hidden = !busy;
  set("stopping", now.stopping ? "stopping: current to zero, drive disarmed" : "");
  chip(now, p);
  question(busy && p ? p.question : null);
  if (showsRun) drawRun(now, p);
}

function chip(now, p) {
  const idle = known === null ? "loading procedures" : "no run is active";
  const words = !now.going && !p ? idle : !p ? "starting" : p.armed ? `${p.state_words}, energised` : p.state_words;
  set("state", words);
  const mood = p && p.outcome && !now.going ? p.outcome.mood : p && p.armed ? "armed" : "";
  $("state").className = `chip ${mood}`;
}

function question(open) {
  $("question").hidden = open === null;
  if (open === null) return;
  set("prompt", open.text);
  for (const id of ["yes", "no"]) {
    if ($(id).dataset.number !== String(open.number)) { $(id).dataset.number = open.number; $(id).disabled = false; }
  }
}

function drawRun(now, p) {
  $("again").hidden = now.going;
  $("problem").hidden = now.problem === "";
  set("problem", now.problem);
  $("bar").hidden = p === null;
  $("progress").hidden = p === null && !now.going;
  if (p === null) {
    set("title", now.going ? "Starting" : "It did not start");
    set("subject", now.subject);
    set("progress", now.going ? "importing, planning" : "");
    for (const id of ["facts", "outcome", "plane", "wave", "flux", "log"]) $(id).replaceChildren();
    $("verdict").hidden = $("report").hidden = true;
    document.querySelector(".plots").hidden = $("details").hidden = true;
    return;
  }
  document.querySelector(".plots").hidden = $("details").hidden = false;
  set("title", p.name || p.run);
  set("subject", [p.run, p.motor, p.drive && `drive ${p.drive}`].filter(Boolean).join(" · "));
  const [done, all] = p.points;
  $("bar").firstElementChild.style.width = `${all ? (100 * done) / all : 0}%`;
  $("bar").setAttribute("aria-valuenow", done);
  $("bar").setAttribute("aria-valuemax", all);
  const at = p.stage ? `${p.stage}: point ${p.stage_points[0]} of ${p.stage_points[1]}` : p.state_words;
  const writes = now.going && p.outcome ? "writing the report" : "";
  set("progress", [at, writes, `${done} of ${all} points`, p.left].filter(Boolean).join(" · "));
  rows($("facts"), [["target", now.going && p.target], ["achieved", now.going && p.achieved], ["R_s", !p.outcome && p.resistance], ...p.about]);
  rows($("outcome"), p.outcome ? p.outcome.rows : []);
  verdict(p.verdict);
  $("report").hidden = now.going || !known || !known.runs.some((row) => row.run === p.run && row.has_report);
  $("report").href = `/report/${encodeURIComponent(p.run)}`;
  drawPlane($("plane"), p);
  drawWave($("wave"), p.waveform, p.limit_a);
  drawFlux($("flux"), p.flux);
  const atEnd = $("log").scrollTop + $("log").clientHeight >= $("log").scrollHeight - 4;
  $("log").replaceChildren(...p.log.map(([mood, line]) => element("li", line, mood)));
  if (atEnd) $("log").scrollTop = $("log").scrollHeight;
}

function verdict(result) {
  $("verdict").hidden = result === null;
  if (result === null) return;
  $("verdict").className = `verdict ${result.mood}`;
  const list = element("dl");
  rows(list, result.slots);
  $("verdict").replaceChildren(element("strong", result.name), document.createTextNode(result.meaning), list);
}

// Pictures -----------------------------------------------------------------------------------------------------------

function drawPlane(svg, p) {
  const limit = p.limit_a || 1, wide = 1.1 * limit * ((W - LEFT - RIGHT) / (H - BOTTOM - TOP));
  const a = axes(svg, [-wide, wide], [-1.1 * limit, 1.1 * limit], "i_d [A]", "i_q [A]");
  a.parts.push(drawn("circle", { cx: a.x(0), cy: a.y(0), r: a.x(limit) - a.x(0), class: "limit" }));
  for (const [d, q] of p.reached_a) a.parts.push(drawn("circle", { cx: a.x(d), cy: a.y(q), r: 3, class: "dot" }));
  if (p.target_a) {
    const [cx, cy] = [a.x(p.target_a[0]), a.y(p.target_a[1])];
    a.parts.push(drawn("path", { d: `M${cx - 6} ${cy}H${cx + 6}M${cx} ${cy - 6}V${cy + 6}`, class: "aim" }));
  }
  svg.replaceChildren(...a.parts);
}

function drawWave(svg, wave, limit) {
  if (!wave) return svg.replaceChildren();
  const t = wave.time_ms, y = span([...wave.i_d_a, ...wave.i_q_a], 0.005 * (limit || 1));
  const a = axes(svg, [t[0], t[t.length - 1] || 1], y, "time [ms]", "current [A]");
  for (const [name, values] of [["d", wave.i_d_a], ["q", wave.i_q_a]]) {
    const path = values.map((v, k) => `${k ? "L" : "M"}${a.x(t[k]).toFixed(1)} ${a.y(v).toFixed(1)}`).join("");
    a.parts.push(drawn("path", { d: path, class: name }));
  }
  svg.replaceChildren(...a.parts);
}

function drawFlux(svg, flux) {
  const points = flux.points;
  const caption = $("fluxcaption");
  caption.replaceChildren(`Flux ${flux.by ? `by ${flux.by}` : "points"}`, element("span", "● ψ_d(i_d)", "key d"), " ", element("span", "● ψ_q(i_q)", "key q"));
  if (points.length === 0) return svg.replaceChildren();
  const currents = points.flatMap(([d, q]) => [d, q]), fluxes = points.flatMap(([, , d, q]) => [d, q]);
  const a = axes(svg, span(currents, 0.1), span(fluxes, 1), "current [A]", "flux [mWb]");
  for (const [d, q, psiD, psiQ] of points) {
    a.parts.push(drawn("circle", { cx: a.x(d), cy: a.y(psiD), r: 2.5, class: "dot" }));
    a.parts.push(drawn("circle", { cx: a.x(q), cy: a.y(psiQ), r: 2.5, class: "dot q" }));
  }
  svg.replaceChildren(...a.parts);
}

// What there is to choose from ---------------------------------------------------------------------------------------

async function loadChoices() {
  const answer = await fetch("/choices");
  if (!answer.ok) return;
  known = await answer.json();
  set("folder", known.folder);
  options(form.procedure, known.procedures.map((one) => [one.name, one.problem ? `${one.name} (wrong)` : one.name]));
  options(form.motor, [["", "the procedure's own"], ...known.motors.map((one) => [one.name, one.summary ? `${one.name}: ${one.summary}` : `${one.name} (wrong)`])]);
  options(form.drive, [["", "the procedure's own"], ...known.drives.map((name) => [name, name])]);
  summarise();
  $("rows").replaceChildren(...known.runs.map(runRow));
  $("unreadable").replaceChildren(...known.unreadable.map((problem) => element("li", problem)));
  if (view) show(view);
}

function options(select, pairs) {
  const chosen = select.value;
  select.replaceChildren(...pairs.map(([value, text]) => new Option(text, value)));
  if (pairs.some(([value]) => value === chosen)) select.value = chosen;
}

function summarise() {
  const one = known.procedures.find((each) => each.name === form.procedure.value);
  set("summary", one ? one.problem || one.summary : "");
  $("summary").className = one && one.problem ? "wrong" : "under";
}

function runRow(row) {
  const made = element("tr"), what = element("td"), does = element("td");
  const mood = { finished: "good", faulted: "bad" }[row.outcome] || "warning";
  const of = [row.motor, row.serial, row.operator, row.tags].filter(Boolean).join(" · ");
  what.append(element("div", row.run), element("div", of, "under"));
  if (row.has_report) {
    const link = element("a", "Report", "button");
    Object.assign(link, { href: `/report/${encodeURIComponent(row.run)}`, target: "_blank", rel: "noopener" });
    does.append(link);
  }
  if (row.outcome !== "finished") {
    const resume = element("button", "Resume");
    resume.onclick = () => begin("/resume", { run: row.run });
    does.append(resume);
  }
  made.append(what, element("td", row.outcome, mood), element("td", row.created.slice(0, 16).replace("T", " "), "aside"), does);
  return made;
}

// What a person does -------------------------------------------------------------------------------------------------

function wanted() {
  const words = (text, by) => text.split(by).map((word) => word.trim()).filter(Boolean);
  const { procedure, motor, drive, settings, serial, operator, ambient_c, tags, note } = form;
  return {
    procedure: procedure.value, motor: motor.value, drive: drive.value, settings: words(settings.value, "\n"),
    serial: serial.value.trim(), operator: operator.value.trim(), note: note.value.trim(), tags: words(tags.value, /[\s,]+/),
    ambient_c: ambient_c.value === "" ? null : Number(ambient_c.value),
  };
}

async function begin(path, body) {
  set("wrong", "");
  for (const button of document.querySelectorAll("#start, #check, #rows button")) button.disabled = true;
  try { return await ask(path, body); } catch (error) { set("wrong", error.message); wantsForm = true; show(view); } finally {
    for (const button of document.querySelectorAll("#start, #check, #rows button")) button.disabled = false;
  }
  return null;
}

function drawPlan(plan) {
  const table = element("table"), page = element("div");
  const line = (cells, kind) => { const row = element("tr"); row.append(...cells.map((cell) => element(kind, cell))); return row; };
  const number = (value, unit) => (value === null || value === undefined ? "–" : `${Number(value.toPrecision(3))} ${unit}`);
  const amounts = (row) => [String(row.points), number(row.duration_s, "s"), number(row.peak_current_a, "A"), number(row.peak_voltage_v, "V")];
  table.append(line(["stage", "points", "time", "peak current", "peak voltage"], "th"));
  table.append(...plan.stages.map((row) => line([row.stage.replaceAll("_", " "), ...amounts(row)], "td")), line(["all", ...amounts(plan)], "th"));
  page.append(table, ...plan.notes.map((note) => element("p", note, "under")));
  $("plan").replaceChildren(page);
}

form.procedure.onchange = () => { summarise(); $("plan").replaceChildren(); };
form.onsubmit = (event) => { event.preventDefault(); $("plan").replaceChildren(); begin("/start", wanted()); };
$("check").onclick = async () => {
  $("plan").replaceChildren(element("p", "checking: the whole procedure is planned", "under"));
  const plan = await begin("/check", wanted());
  if (plan) drawPlan(plan); else $("plan").replaceChildren();
};
$("again").onclick = () => { wantsForm = true; show(view); };
$("stop").onclick = async () => {
  $("stop").disabled = true;
  set("stopping", "stop requested");
  for (let arrived = false; !arrived && view && view.going;) {
    try { await ask("/stop", {}, 0); arrived = true; } catch (error) {
      set("stopping", `the stop has not arrived (${error.message}): trying again. Where the motor still turns, cut its power.`);
      await new Promise((done) => setTimeout(done, 500));
    }
  }
  $("stop").disabled = false;
};
for (const id of ["yes", "no"]) {
  $(id).onclick = () => {
    const number = Number($(id).dataset.number);
    $("yes").disabled = $("no").disabled = true;
    ask("/answer", { question: number, answer: id }).catch(() => { $("yes").disabled = $("no").disabled = false; });
  };
}

// Events -------------------------------------------------------------------------------------------------------------
// A browser opens six connections to a server, for all its tabs: a tab that nobody sees holds none, and all give theirs
// up for a moment where a request of any tab has to wait.

const OLD_MS = 3000, QUIET_MS = 10000, AWAY_MS = 2000;
const tabs = new BroadcastChannel("fluxbench");
let events = null, heard_ms = performance.now(), age_ms = 0, again = null;

function heard(stateAge_ms) { heard_ms = performance.now(); age_ms = stateAge_ms; $("gone").hidden = true; drawAge(); }

function listen() {
  clearTimeout(again);
  if (events !== null || document.hidden) return;
  events = new EventSource("/events");
  events.onmessage = (event) => { heard(0); show(JSON.parse(event.data)); };
  events.addEventListener("alive", (event) => heard(1000 * JSON.parse(event.data).age_s));
  events.onerror = () => {
    $("gone").hidden = false;
    if (events.readyState === EventSource.CLOSED) { mute(); again = setTimeout(listen, AWAY_MS); }
  };
}

function mute() { if (events !== null) events.close(); events = null; }

function pause() { mute(); clearTimeout(again); again = setTimeout(listen, AWAY_MS); }

function giveWay() { tabs.postMessage("pause"); pause(); }

function drawAge() {
  const silent_ms = performance.now() - heard_ms, busy = view !== null && view.going && !(view.picture && view.picture.outcome);
  const old = silent_ms > OLD_MS, quiet = !old && busy && age_ms > QUIET_MS;
  $("age").hidden = !old && !quiet;
  document.body.classList.toggle("old", old);
  if (old) set("age", `No event for ${Math.floor(silent_ms / 1000)} s: what is shown is that old.`);
  if (quiet) set("age", `The server answers; the run has reported nothing for ${Math.floor(age_ms / 1000)} s.`);
}

tabs.onmessage = pause;
document.onvisibilitychange = () => { if (document.hidden) mute(); else listen(); };
setInterval(drawAge, 500);
listen();
loadChoices();
