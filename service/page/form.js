// The design and its pressures as a form; its contents live in the address too, so
// that a design can be sent as a link.

const GROUPS = {
  Strip: ["length_mm", "width_mm", "balloon_start_mm"],
  Balloons: [
    "balloon_length_mm",
    "balloon_width_mm",
    "divisions_x",
    "divisions_y",
    "wall_mm",
    "cavity_height_um",
  ],
  Layers: [
    "upper_thickness_um",
    "lower_thickness_um",
    "upper_modulus_MPa",
    "lower_modulus_MPa",
  ],
};
const PRESSURE = ["from", "to", "step"];

const element = (id) => document.getElementById(id);

export function make(tag, properties = {}, ...children) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children);
  return node;
}

const capital = (text) => text[0].toUpperCase() + text.slice(1);
const unitOf = (unit) => (unit === "um" ? "µm" : unit);

export class Form {
  constructor(devices, changed) {
    this.devices = devices;
    this.columns = new Map(devices.columns.map((column) => [column.name, column]));
    this.trained = new Map(devices.trained.map((row) => [row.name, row]));
    this.changed = changed;
    this.build();
    this.read();
  }

  build() {
    for (const device of this.devices.devices) {
      element("device").append(make("option", { value: device.name }, device.name));
    }
    for (const { case: number, ...row } of this.devices.devices[0].cases) {
      const layer = (name) => `${name} ${this.devices.materials_MPa[name]} MPa`;
      const text =
        `${number}: ${layer(row.upper_material)} over ${layer(row.lower_material)}`;
      element("case").append(make("option", { value: String(number) }, text));
    }
    for (const [title, names] of Object.entries(GROUPS)) {
      const group = make("fieldset", {}, make("legend", {}, title));
      group.append(...names.map((name) => this.field(this.columns.get(name))));
      element("columns").append(group);
    }
    for (const id of ["device", "case"]) {
      element(id).addEventListener("change", () => {
        this.fill(element("device").value, element("case").value);
        this.edited();
      });
    }
    for (const name of [...this.columns.keys(), ...PRESSURE]) {
      element(name).addEventListener("input", () => this.edited());
    }
  }

  field({ name, label, unit, lower, upper, whole }) {
    const trained = this.trained.get(name);
    const range = trained ?? { lower, upper };
    const words = trained ? "trained" : "allowed";
    const input = make("input", {
      id: name,
      type: "number",
      min: lower,
      max: upper,
      step: whole ? 1 : "any",
      required: true,
    });
    input.setAttribute("aria-describedby", `${name}-hint ${name}-error`);
    return make(
      "div",
      { className: "field" },
      make("label", { htmlFor: name }, capital(label)),
      make("div", { className: "entry" }, input, make("span", {}, unitOf(unit))),
      make(
        "p",
        { className: "hint", id: `${name}-hint` },
        `${words} ${range.lower} to ${range.upper}`,
      ),
      make("p", { className: "error", id: `${name}-error`, hidden: true }),
    );
  }

  nominal(device, number) {
    const found = this.devices.devices.find((row) => row.name === device);
    return found?.cases.find((row) => String(row.case) === String(number))?.design;
  }

  fill(device, number) {
    const design = this.nominal(device, number);
    for (const name of this.columns.keys()) element(name).value = design[name];
  }

  // From the address to the form.
  read() {
    const given = new URLSearchParams(location.hash.slice(1));
    const first = this.devices.devices[0].name;
    const device = given.get("device") ?? first;
    const number = given.get("case") ?? "1";
    const known = this.nominal(device, number) !== undefined;
    element("device").value = known ? device : first;
    element("case").value = known ? number : "1";
    this.fill(element("device").value, element("case").value);
    for (const name of [...this.columns.keys(), ...PRESSURE]) {
      if (given.has(name)) element(name).value = given.get(name);
    }
    this.mark();
  }

  // From the form to the address: the device, and what differs from it.
  write() {
    const device = element("device").value;
    const number = element("case").value;
    const out = new URLSearchParams({ device, case: number });
    const nominal = this.nominal(device, number);
    for (const name of this.columns.keys()) {
      const value = element(name).value;
      if (Number(value) !== nominal[name]) out.set(name, value);
    }
    for (const name of PRESSURE) out.set(name, element(name).value);
    history.replaceState(null, "", `#${out}`);
  }

  edited() {
    this.mark();
    this.write();
    this.changed();
  }

  // Values beyond the trained range are shown as such: allowed, but slower.
  mark() {
    for (const [name, range] of this.trained) {
      const input = element(name);
      if (input === null) continue;
      const value = Number(input.value);
      input.classList.toggle("beyond", value < range.lower || value > range.upper);
    }
  }

  // The request that the form stands for, or null when it is not complete.
  request() {
    this.clearErrors();
    const design = {};
    for (const [name, { whole }] of this.columns) {
      const { value, validity } = element(name);
      if (value === "" || validity.badInput) {
        return this.refuse(name, `needed: a ${whole ? "whole " : ""}number`);
      }
      design[name] = Number(value);
    }
    const pressure_kPa = this.pressures();
    return pressure_kPa && { design, pressure_kPa };
  }

  pressures() {
    const [from, to, step] = PRESSURE.map((id) => element(id).valueAsNumber);
    const most = this.devices.pressure_kPa.max_count;
    if (![from, to, step].every(Number.isFinite)) {
      return this.refuse("pressure", "three numbers are needed");
    }
    if (step <= 0) return this.refuse("pressure", "the step must be above 0");
    if (to < from) return this.refuse("pressure", "the end must not be below the start");
    const count = Math.floor((to - from) / step + 1e-9) + 1;
    if (count > most) return this.refuse("pressure", `at most ${most} load steps`);
    const round = (value) => Number(value.toPrecision(12));
    return Array.from({ length: count }, (_, i) => round(from + i * step));
  }

  refuse(name, message) {
    this.showError(name, message);
    return null;
  }

  clearErrors() {
    for (const node of element("form").querySelectorAll(".error")) node.hidden = true;
    for (const node of element("form").querySelectorAll("[aria-invalid]")) {
      node.removeAttribute("aria-invalid");
    }
  }

  // An error at the field that it names, or below the form.
  showError(name, message, allowed) {
    const column = this.columns.has(name);
    const field = (name ?? "").replace(/(_kPa)?(\[\d+\])?$/, "");
    const place =
      element(`${column ? name : field}-error`) ?? element("form-error");
    place.textContent = column && allowed ? `allowed: ${allowed}` : message;
    place.hidden = false;
    if (column) element(name).setAttribute("aria-invalid", "true");
  }
}
