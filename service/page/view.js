// What came back: drawing, curves, table, and who answered.

import { make } from "./form.js";

const element = (id) => document.getElementById(id);
const CONFIG = {
  responsive: true,
  displaylogo: false,
  modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
};

export const unitOf = (name) => name.split("_").at(-1).replace("u", "µ");
const STILL_MM = 5e-5; // shown as 0.0000
const NAMES = {
  tip_deflection_mm: "Tip deflection",
  bending_angle_deg: "Bending angle",
  inflation_mm: "Inflation",
  inflation_lower_mm: "Inflation, floor",
  cavity_volume_uL: "Cavity volume",
};

export function quantityBoxes(quantities, changed) {
  const shown = ["inflation_mm", "tip_deflection_mm"];
  for (const { name } of quantities) {
    const box = make("input", {
      type: "checkbox",
      id: `show-${name}`,
      value: name,
      checked: shown.includes(name),
    });
    box.addEventListener("change", changed);
    element("quantities").append(make("label", {}, box, ` ${NAMES[name]}`));
  }
}

export function chosenQuantities() {
  const boxes = element("quantities").querySelectorAll("input:checked");
  const names = [...boxes].map((box) => box.value);
  return names.length ? names : ["inflation_mm"];
}

export function showDrawing(figure) {
  const place = element("drawing");
  const height = Math.max(150, place.clientWidth * figure.layout.meta.aspect);
  const layout = { ...figure.layout, height };
  Plotly.react(place, figure.data, layout, { ...CONFIG, displayModeBar: false });
}

export function showDerived({ design, tip_margin_mm, rim_mm, thickness_um }) {
  const { divisions_x: nx, divisions_y: ny } = design;
  const along = digits(design.balloon_length_mm / nx);
  const across = digits(design.balloon_width_mm / ny);
  const balloons = nx * ny === 1 ? "One balloon of" : `${nx} × ${ny} balloons, each`;
  element("derived").textContent =
    `${balloons} ${along} × ${across} mm; ${tip_margin_mm} mm from the last balloon ` +
    `to the tip, rim ${rim_mm} mm, thickness ${thickness_um} µm in all.`;
}

export function showCurves(figure) {
  const place = element("curves");
  place.style.height = `${figure.layout.height}px`;
  Plotly.react(place, figure.data, figure.layout, CONFIG);
}

export function outdated(old) {
  element("curves").classList.toggle("old", old);
  element("table").classList.toggle("old", old);
  element("csv").disabled = old;
}

function badge(id, text, kind) {
  const node = element(id);
  node.hidden = !text;
  node.textContent = text ?? "";
  node.className = `badge ${kind ?? ""}`;
}

export function showWho(answer) {
  const fem = answer.source === "fem";
  badge("source", fem ? "Finite elements" : "Surrogate", answer.source);
  const inside = answer.in_range;
  badge(
    "range",
    inside ? "inside the trained range" : "outside the trained range",
    inside ? "inside" : "outside",
  );
  element("summary").textContent = summary(answer);
  reasons([...answer.reasons, ...answer.notes]);
}

export function showBeyond(found) {
  badge("source", null);
  badge("range", "outside the trained range", "outside");
  element("summary").textContent =
    "The surrogate was not trained for this. Predict asks the finite elements, " +
    "which takes some seconds:";
  reasons([...found.reasons, ...found.notes]);
}

export function showNothing(message) {
  badge("source", null);
  badge("range", null);
  element("summary").textContent = message;
  reasons([]);
}

function reasons(list) {
  element("reasons").replaceChildren(...list.map((text) => make("li", {}, text)));
}

const digits = (value) => String(Number(value.toPrecision(3)));

function summary(answer) {
  const tips = answer.tip_deflection_mm.value;
  const pressure = answer.pressure_kPa;
  let top = null;
  tips.forEach((tip, i) => {
    const higher = top === null || Math.abs(pressure[i]) > Math.abs(pressure[top]);
    if (tip !== null && higher) top = i;
  });
  if (top === null) {
    return `No load step was reached: ${answer.message || answer.status}.`;
  }
  const tip = tips[top];
  const way = tip >= 0 ? "up" : "down";
  const where =
    Math.abs(tip) < STILL_MM ? "where it was" : `${digits(Math.abs(tip))} mm ${way}`;
  const rise = digits(answer.inflation_mm.value[top]);
  let text =
    `At ${pressure[top]} kPa the tip is ${where} and the roof ${rise} mm higher ` +
    `than its edge.`;
  if (answer.status !== "completed") {
    text += ` Then the path ends: ${answer.message || answer.status}.`;
  }
  if (answer.seconds) text += ` ${answer.unknowns} unknowns, ${digits(answer.seconds)} s.`;
  return text;
}

// `stop` cancels the work; without it there is nothing yet that could be.
export function showJob(text, stop = null) {
  element("job").hidden = text === null;
  element("job-text").textContent = text ?? "";
  element("cancel").hidden = stop === null;
  element("cancel").onclick = stop;
}

export function showTable(answer) {
  const names = Object.keys(NAMES).filter((name) => name in answer);
  const title = (name, unit) =>
    make("th", { scope: "col" }, name, make("br"), make("small", {}, unit));
  const head = make("tr", {}, title("Pressure", "kPa"));
  head.append(...names.map((name) => title(NAMES[name], unitOf(name))));
  const body = make("tbody");
  answer.pressure_kPa.forEach((pressure, i) => {
    const row = make("tr", {}, make("td", {}, String(pressure)));
    for (const name of names) row.append(cell(answer[name], i));
    body.append(row);
  });
  element("table").replaceChildren(make("table", {}, make("thead", {}, head), body));
}

function cell({ value, low, high }, i) {
  if (value[i] === null) return make("td", {}, "–");
  const half = (high[i] - low[i]) / 2;
  const rounded = Math.round(value[i] * 1e4) / 1e4 + 0; // + 0 turns -0 into 0
  const node = make("td", {}, rounded.toFixed(4));
  if (half > 0) node.append(make("small", {}, ` ±${half.toFixed(4)}`));
  return node;
}

// One row a load step, in the columns of a measurement file, with the interval.
export function csv(answer) {
  const names = Object.keys(NAMES).filter((name) => name in answer);
  const columns = Object.keys(answer.design);
  const fields = names.flatMap((name) => [name, `${name}_low`, `${name}_high`]);
  const who = ["source", "model_version"];
  const lines = [["device", ...columns, "pressure_kPa", ...fields, ...who]];
  answer.pressure_kPa.forEach((pressure, i) => {
    const values = names.flatMap((name) =>
      ["value", "low", "high"].map((key) => answer[name][key][i] ?? ""),
    );
    const design = columns.map((name) => answer.design[name]);
    const maker = [answer.source, answer.model_version];
    lines.push(["design", ...design, pressure, ...values, ...maker]);
  });
  return lines.map((line) => line.join(",")).join("\n") + "\n";
}

export function showProgram(request) {
  const body = JSON.stringify(request);
  element("curl").textContent =
    `curl -s ${location.origin}/v1/predict \\\n` +
    `  -H 'Content-Type: application/json' \\\n  -d '${body}'`;
}
