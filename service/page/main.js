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
let job = null; // the finite elements' work for this page
let told; // version of the model that answered when the heading was written

// Whatever was under way is of no interest any more.
function restart() {
  running.abort();
  running = new AbortController();
  if (job) api.cancel(job.id).catch(() => {}); // it may have ended
  job = null;
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
  await draw(signal);
  const newest = answers.at(-1);
  view.showTable(newest);
  view.showWho(newest);
  view.outdated(false);
  const quick = answers.find((one) => one.source === "surrogate");
  if (quick && quick.model_version !== told) {
    told = quick.model_version;
    await showModel();
  }
}

// The curves alone: which quantities are drawn says nothing of what is up to date.
async function draw(signal) {
  view.showCurves(await api.curves(answers, view.chosenQuantities(), signal));
}

// Another model may have been put into use since the page was opened.
async function showModel() {
  const { models, problem } = await api.models();
  const model = models.find((one) => one.in_use);
  const trained = model?.description?.n_train;
  const effects = model?.effects.length ? ` with ${model.effects.join(", ")}` : "";
  const parts = [
    model ? `Model ${model.version}${effects}` : "No model answers",
    trained ? `trained on ${trained} designs` : "",
    problem,
  ];
  element("model").textContent = parts.filter(Boolean).join(", ");
}

// On request: also where the finite elements must answer, as a job if that takes long.
async function ask(source) {
  clearTimeout(timer);
  const signal = restart();
  const request = form.request();
  if (request === null) return;
  view.showProgram(request);
  const checked = await api.check(request, signal);
  view.showDerived(checked);
  view.showDrawing(await api.drawing(request.design, signal));
  const beside =
    source === "fem" && checked.in_range
      ? [(await api.predict(request, signal)).answer]
      : [];
  if (beside.length) await show(beside, signal);
  else if (!checked.in_range) view.showBeyond(checked);
  const started = Date.now();
  if (source === "fem" || !checked.in_range) view.showJob("Finite elements at work");
  const body = { ...request, source, wait_s: WAIT_S };
  // Not broken off by a change: its work would go on, and nobody know of it.
  const { answer, job: begun } = await api.predict(body);
  if (signal.aborted && begun) api.cancel(begun.id).catch(() => {});
  signal.throwIfAborted();
  const found = answer ?? (await finished(begun, started, signal));
  view.showJob(null);
  if (found) return show([...beside, found], signal);
  if (beside.length) return; // its answer stands
  view.showNothing("Cancelled.");
  view.outdated(true);
}

// The job's answer; nothing where it was cancelled.
async function finished(begun, started, signal) {
  job = begun;
  const stop = () => guarded(() => api.cancel(begun.id));
  while (job.status === "queued" || job.status === "running") {
    const seconds = Math.round((Date.now() - started) / 1000);
    const doing = job.status === "queued" ? "waiting for their turn" : "at work";
    view.showJob(`Finite elements ${doing}, ${seconds} s`, stop);
    await new Promise((done) => setTimeout(done, POLL_MS));
    signal.throwIfAborted();
    const now = await api.job(begun.id);
    signal.throwIfAborted();
    job = now;
  }
  const ended = job;
  job = null;
  if (ended.result || ended.status === "cancelled") return ended.result;
  throw new api.ApiError(0, ended.error);
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
  const [devices] = await Promise.all([api.devices(), showModel()]);
  view.quantityBoxes(devices.quantities, () => {
    if (answers.length) guarded(() => draw(running.signal));
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
