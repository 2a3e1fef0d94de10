// The page: a form, and what the service answers to it.

import * as api from "./api.js";
import { Form } from "./form.js";
import * as view from "./view.js";

const PAUSE_MS = 250; // after the last keystroke
const POLL_MS = 500;
const WAIT_S = 1; // a request waits so long before the page shows a job

const element = (id) => document.getElementById(id);

let form;
let running = new AbortController(); // what is asked now; replaced by the next change
let timer;
let answers = []; // the curves: a surrogate's answer, then one of finite elements

// Whatever was under way is of no interest any more.
function restart() {
  running.abort();
  running = new AbortController();
  view.showJob(null);
  return running.signal;
}

async function guarded(action) {
  try {
    await action();
  } catch (error) {
    if (error.name === "AbortError") return;
    view.showJob(null);
    if (!(error instanceof api.ApiError)) throw error;
    form.showError(error.field, error.message, error.allowed);
    view.showNothing(error.field ? "The design is not possible yet." : error.message);
    view.outdated(true);
  }
}

// After each change: check and draw, and predict where that is immediate.
function changed() {
  clearTimeout(timer);
  const signal = restart();
  view.outdated(true);
  timer = setTimeout(() => guarded(() => update(signal)), PAUSE_MS);
}

async function update(signal) {
  const request = form.request();
  if (request === null) return view.showNothing("The design is not complete.");
  view.showProgram(request);
  const found = await api.check(request, signal);
  view.showDerived(found);
  view.showDrawing(await api.drawing(request.design, signal));
  if (!found.in_range) return view.showBeyond(found);
  const { answer } = await api.predict(request, signal);
  if (answer) await show([answer], signal);
}

async function show(list, signal) {
  answers = list;
  const figure = await api.curves(answers, view.chosenQuantities(), signal);
  const newest = answers.at(-1);
  view.showCurves(figure);
  view.showTable(newest);
  view.showWho(newest);
  view.outdated(false);
}

// On request: also where the finite elements must answer, as a job if that takes long.
async function ask(source) {
  clearTimeout(timer);
  const signal = restart();
  const request = form.request();
  if (request === null) return;
  view.showProgram(request);
  const found = await api.check(request, signal);
  view.showDerived(found);
  view.showDrawing(await api.drawing(request.design, signal));
  const beside =
    source === "fem" && found.in_range
      ? [(await api.predict(request, signal)).answer]
      : [];
  if (beside.length) await show(beside, signal);
  else if (!found.in_range) view.showBeyond(found);
  const started = Date.now();
  if (source === "fem" || !found.in_range) view.showJob("Finite elements at work");
  const body = { ...request, source, wait_s: WAIT_S };
  let { answer, job } = await api.predict(body, signal);
  if (job) answer = await finished(job, started, signal);
  view.showJob(null);
  await show([...beside, answer], signal);
}

async function finished(job, started, signal) {
  element("cancel").onclick = () => guarded(() => api.cancel(job.id));
  while (job.status === "queued" || job.status === "running") {
    const seconds = Math.round((Date.now() - started) / 1000);
    const doing = job.status === "queued" ? "waiting for their turn" : "at work";
    view.showJob(`Finite elements ${doing}, ${seconds} s`);
    await new Promise((done) => setTimeout(done, POLL_MS));
    signal.throwIfAborted();
    job = await api.job(job.id);
    signal.throwIfAborted();
  }
  if (job.result) return job.result;
  const message = job.status === "cancelled" ? "Cancelled." : job.error.message;
  throw new api.ApiError(0, { ...job.error, message });
}

function download() {
  const blob = new Blob([view.csv(answers.at(-1))], { type: "text/csv" });
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = "prediction.csv";
  link.click();
  URL.revokeObjectURL(link.href);
}

async function start() {
  const [devices, { models, problem }] = await Promise.all([
    api.devices(),
    api.models(),
  ]);
  const model = models.find((one) => one.in_use);
  const trained = model?.description?.n_train;
  const effects = model?.effects.length ? ` with ${model.effects.join(", ")}` : "";
  const parts = [
    model ? `Model ${model.version}${effects}` : "No model answers",
    trained ? `trained on ${trained} designs` : "",
    problem,
  ];
  element("model").textContent = parts.filter(Boolean).join(", ");
  view.quantityBoxes(devices.quantities, () => {
    if (answers.length) guarded(() => show(answers, running.signal));
  });
  form = new Form(devices, changed);
  element("form").addEventListener("submit", (event) => {
    event.preventDefault();
    guarded(() => ask("auto"));
  });
  element("fem").addEventListener("click", () => guarded(() => ask("fem")));
  element("csv").addEventListener("click", download);
  window.addEventListener("hashchange", () => {
    form.read();
    changed();
  });
  changed();
}

start().catch((error) => view.showNothing(error.message));
