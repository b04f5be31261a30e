"use strict";
// Elements and axes that both pages draw with.

const $ = (id) => document.getElementById(id);

function set(id, text) { if ($(id).textContent !== text) $(id).textContent = text; }

function element(name, text, className) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  return made;
}

const W = 400, H = 300, LEFT = 42, BOTTOM = 34, TOP = 8, RIGHT = 8;

function drawn(name, attributes, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

function ticks(low, high) {
  const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= rough);
  const out = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) out.push(Number((k * step).toPrecision(6)));
  return out;
}

function axes(svg, [x0, x1], [y0, y1], xLabel, yLabel) {
  svg.setAttribute("viewBox", `0 0 ${W} ${H}`);
  const x = (v) => LEFT + ((v - x0) / (x1 - x0)) * (W - LEFT - RIGHT);
  const y = (v) => H - BOTTOM - ((v - y0) / (y1 - y0)) * (H - BOTTOM - TOP);
  const parts = [];
  for (const t of ticks(x0, x1)) {
    parts.push(drawn("line", { x1: x(t), x2: x(t), y1: TOP, y2: H - BOTTOM, class: t === 0 ? "zero" : "grid" }));
    parts.push(drawn("text", { x: x(t), y: H - BOTTOM + 13, "text-anchor": "middle" }, String(t).replace("-", "−")));
  }
  for (const t of ticks(y0, y1)) {
    parts.push(drawn("line", { x1: LEFT, x2: W - RIGHT, y1: y(t), y2: y(t), class: t === 0 ? "zero" : "grid" }));
    parts.push(drawn("text", { x: LEFT - 5, y: y(t) + 4, "text-anchor": "end" }, String(t).replace("-", "−")));
  }
  parts.push(drawn("text", { x: W - RIGHT, y: H - 4, "text-anchor": "end" }, xLabel));
  parts.push(drawn("text", { x: 12, y: TOP + 4, "text-anchor": "end", transform: `rotate(-90 12 ${TOP + 4})` }, yLabel));
  return { x, y, parts };
}

function span(values, least) {
  let low = Math.min(...values), high = Math.max(...values);
  const room = Math.max(0.08 * (high - low), least);
  return [low - room, high + room];
}
