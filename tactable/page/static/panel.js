// The panel below the bar: switches, promised and simulated levels, the command, latencies, counters.

import { NOTHING, NO_NUMBER } from "./wire.js";
import { pointText } from "./points.js";
import { ORDERS, Role } from "./surface.js";

const SOURCES = { click: "Click", steady: "Steady drive", zones: "Zones (the paper)" };
// What the second bar is, by the kind of drive that plays on the first.
const PAPERS = {
  1: "The same fingers with the paper’s drive: the row of the sweep with the greatest localized factor in their zones, tabulated without fingers, that reaches the level there.",
  2: "The same fingers with the paper’s drive, switched on for as long as the click: the paper has none. It is the row of the sweep with the greatest localized factor in their zones, tabulated without fingers, that reaches the level there.",
};
const RULES = {
  touch: "when it touches", hold: "after resting 0.5 s", drag: "every 10 mm of a drag", lift: "when it lifts",
  file: "as the rule file says",
};
const STAGES = ["read", "frame", "state", "command", "written"];
const COUNTERS = ["reports", "frames", "state changes", "commands", "replaced", "lost frames"];
const CLASSES = { [Role.NONE]: "none", [Role.QUIET]: "quiet", [Role.FELT]: "felt" };

export function byId(id) { return document.getElementById(id); }

// Set a text only where it changed: every change makes the browser lay out the page again.
function say(element, text) { if (element.textContent !== text) element.textContent = text; }

// Name of a device that the server knows by a path.
function nameOf(device) { return device.split("/").at(-1).replace(/\.toml$/, ""); }

function rows(body, count, columns) {
  while (body.rows.length > count) body.deleteRow(-1);
  while (body.rows.length < count) {
    const row = body.insertRow();
    for (let i = 0; i < columns; i++) row.insertCell();
  }
  return body.rows;
}

function decibels(word) { return word === NOTHING ? "–" : (word / 100).toFixed(1).replace("-", "−"); }

function microseconds(ns) { return `${(ns / 1000).toFixed(ns < 99500 ? 1 : 0)} µs`; }

function choices(fieldset, name, options, kind, onChoose) {
  const box = fieldset.querySelector(".choices"), key = JSON.stringify(options);
  if (box.dataset.key === key) return;
  box.dataset.key = key;
  box.replaceChildren(...options.map(([value, text]) => {
    const label = document.createElement("label"), input = document.createElement("input"), span = document.createElement("span");
    label.className = "choice";
    input.type = kind;
    input.name = name;
    input.value = JSON.stringify(value);
    input.addEventListener("change", () => onChoose(value, input.checked));
    span.textContent = text;
    label.append(input, span);
    return label;
  }));
}

function check(fieldset, is) {
  for (const input of fieldset.querySelectorAll(".choices input")) input.checked = is(JSON.parse(input.value));
}

export class Panel {
  constructor(wire) {
    this._wire = wire;
    this._scene = null;
    this._bars = [];
    byId("loaded").addEventListener("change", (event) => wire.choose({ is_loaded: event.target.checked }));
    byId("other").addEventListener("change", (event) => wire.choose({ is_other: event.target.checked }));
    byId("switches").addEventListener("submit", (event) => event.preventDefault());
    const stages = byId("stages");
    for (const name of STAGES) {
      const bar = document.createElement("span");
      bar.title = name;
      stages.append(bar);
      this._bars.push(bar);
    }
    const counters = byId("counters");
    for (const name of [...COUNTERS, "pictures", "restarts"]) {
      const term = document.createElement("dt"), value = document.createElement("dd");
      term.textContent = name;
      value.textContent = "0";
      counters.append(term, value);
    }
    this._counts = counters.querySelectorAll("dd");
  }

  state(text, isUp, hasEnded = false) {
    this._isUp = isUp;
    this._hasEnded = hasEnded;
    this._connection = text;
    this._sayStatus();
  }

  set scene(scene) {
    this._scene = scene;
    const { device, choice } = scene, isDemo = scene.mode === "demo", wire = this._wire, { surface } = document.body.dataset;
    say(byId("device-name"), device.name);
    const badge = byId("badge");
    badge.hidden = false;
    say(badge, isDemo ? `SIMULATED: digitizer, firmware and ${surface}` : `SIMULATED: the ${surface}'s motion`);
    byId("switches").hidden = !isDemo;
    byId("actions").hidden = !isDemo;
    for (const id of ["hint", "show-me", "keep-all"]) byId(id).hidden = !isDemo;
    say(byId("last-key"), `${Math.min(device.zones.length, 9)}`);
    const estimates = device.estimates ? `${device.estimates} values of ${device.name} are ESTIMATES; its file names them. ` : "";
    say(byId("estimates"), `${estimates}Levels are dB above the ${device.threshold}. Clicks and drives are made for the spread ${device.spread}.`);
    if (isDemo) this._showSwitches(scene, choice, wire);
    this._sayStatus();
    this._sayNotice();
  }

  _showSwitches(scene, choice, wire) {
    const choose = (name) => (value) => wire.choose({ [name]: value });
    choices(byId("source"), "source", Object.entries(SOURCES), "radio", choose("source"));
    choices(byId("rules"), "rules", scene.rules.map((rule) => [rule, RULES[rule]]), "radio", choose("rules"));
    choices(byId("level"), "level", scene.levels_db.map((db) => [db, db === null ? "full scale" : `${db} dB`]), "radio", choose("level_db"));
    choices(byId("devices"), "device", scene.devices.map((name) => [name, nameOf(name)]), "radio", choose("device"));
    const zones = scene.device.zones.map(({ name }) => [name, name]);
    choices(byId("zones"), "zone", zones, "checkbox", (zone, feels) => {
      const quiet = this._scene.choice.quiet_zones.filter((name) => name !== zone);
      wire.choose({ quiet_zones: feels ? quiet : [...quiet, zone] });
    });
    check(byId("source"), (value) => value === choice.source);
    check(byId("rules"), (value) => value === choice.rules);
    check(byId("level"), (value) => value === choice.level_db);
    check(byId("devices"), (value) => value === choice.device);
    check(byId("zones"), (value) => !choice.quiet_zones.includes(value));
    byId("loaded").checked = choice.is_loaded;
    byId("other").checked = choice.is_other;
    byId("other-bar").hidden = !scene.other;
    say(byId("other-bar"), `The ${document.body.dataset.surface} that plays is not the table’s, and the engine is not told: ${scene.other}.`);
    for (const id of ["source", "level", "zones"]) byId(id).disabled = choice.rules === "file";
  }

  _sayStatus() {
    const status = byId("status"), scene = this._scene;
    let text = this._connection ?? "connecting", kind = this._isUp ? "wait" : "down";
    if (this._isUp && scene) {
      const plays = scene.status === "running" && scene.plays !== null;
      text = plays ? "engine runs" : scene.status === "building" ? "building a table" : `engine ${scene.status}`;
      kind = plays ? "up" : "wait";
    } else if (this._hasEnded && scene) text = `the ${scene.mode === "demo" ? "demo" : "run"} is over`;
    say(status, text);
    status.dataset.kind = kind;
  }

  // Say what is wrong here, in this browser, until the server says something else.
  trouble(text) {
    this._scene = { ...this._scene, trouble: text };
    this._sayNotice();
  }

  _sayNotice() {
    const scene = this._scene, notice = byId("notice"), parts = [];
    say(byId("command-note"), scene.solved ? "Each click is solved when its fingers come; a steady drive takes its place if that takes longer than 0.3 s."
      : scene.clicks ? "The table has clicks for one and for two fingers. A click for more is solved when they come, and a steady drive takes its place if that takes longer than 25 ms."
      : "");
    if (scene.trouble) parts.push(scene.trouble);
    const building = scene.building;
    if (building?.error) parts.push(`The table of ${nameOf(building.device)} was not built: ${building.error}`);
    else if (building) {
      const percent = Math.round(100 * building.fraction);
      const what = `${building.step}, ${percent}\u00a0%`;
      if (scene.is_shipped) {
        const older = scene.is_outdated ? ", which older code made" : "";
        parts.push(`The shipped table plays${older}; this machine builds the same one now: ${what}`);
      } else if (scene.what_if) parts.push(`For the actuators that were moved: ${what}`);
      else if (scene.solved) {
        const { count, last_m } = scene.solved, last = last_m.map((at) => pointText(at)).join(" and ");
        const so = count ? `${count} so far, the last for ${last_m.length > 1 ? "fingers" : "a finger"} at ${last}` : "touch";
        parts.push(`Clicks are solved as fingers ask for them: ${so}; the table of ${nameOf(building.device)}: ${what}`);
      } else if (!scene.clicks) parts.push(`Steady drives play, solved from the modes; clicks follow once their kernels are compiled: ${what}`);
      else if (scene.is_early) parts.push(`Building clicks at more places: ${what}; until they are there, those of few places play`);
      else if (scene.clicks) parts.push(`The table plays, and this machine makes ready to solve more: ${what}`);
      else parts.push(`Building the table of ${nameOf(building.device)}, once: ${what}`);
    } else if (scene.status === "running" && !scene.clicks && scene.mode === "demo") parts.push("Steady drives play; this bar has no table of clicks");
    if (scene.tracked) parts.push(scene.tracked);
    if (scene.compared?.device === scene.device.name) parts.push(`The table built here plays: ${scene.compared.text}`);
    notice.hidden = !parts.length;
    say(notice, parts.join(" · "));
  }

  // Update from the newest picture, a few times a second.
  update(picture, received) {
    const scene = this._scene;
    if (!scene) return;
    // A steady drive may take the place of a click: the caption is about what plays.
    say(byId("paper-title"), PAPERS[picture.drive || (scene.choice.source === "click" ? 2 : 1)] ?? "");
    this._showPromise(picture, scene);
    this._showCommand(picture, scene);
    this._showLatency(picture);
    for (let i = 0; i < COUNTERS.length; i++) say(this._counts[i], picture.counters[i].toLocaleString("en"));
    say(this._counts[COUNTERS.length], received.toLocaleString("en"));
    say(this._counts[COUNTERS.length + 1], `${scene.restarts}`);
  }

  _showPromise(picture, scene) {
    const { zones } = scene.device, found = rows(byId("promise").tBodies[0], picture.madeCount, 5);
    for (let i = 0; i < picture.madeCount; i++) {
      const cells = found[i].cells, { number, zone, role, position_m, promised, simulated, low, high } = picture.made[i];
      const name = zone < zones.length ? `, ${zones[zone].name}` : "";
      say(cells[0], `${number === NO_NUMBER ? "–" : number + 1}: ${pointText(position_m)}${name}`);
      say(cells[1], ORDERS[role] ?? "none");
      cells[1].className = CLASSES[role];
      say(cells[2], decibels(promised));
      say(cells[3], low === NOTHING ? "–" : `${decibels(low)} to ${decibels(high)}`);
      say(cells[4], decibels(simulated));
    }
  }

  _showCommand(picture, scene) {
    const isClick = picture.drive === 2, level = Number.isFinite(picture.wanted_db) ? `${picture.wanted_db.toFixed(0)} dB` : "full scale";
    let text = "none yet";
    if (picture.command) {
      const now = picture.isPlaying ? "plays" : `${picture.age_s.toFixed(1)} s ago`;
      const steady = scene.choice?.source === "zones" || scene.is_shipped ? "row of the sweep, looked up for the zones" : "steady drive solved for these positions";
      const what = isClick ? "click, as weights of the firmware's basis" : steady;
      text = `${what}, for ${picture.madeCount === 1 ? "one finger" : `${picture.madeCount} fingers`}, ${level}; ${now}`;
    }
    say(byId("command"), text);
    const { actuators } = scene.device, found = rows(byId("channels").tBodies[0], actuators.length, 4);
    for (let i = 0; i < actuators.length; i++) {
      const cells = found[i].cells, has = picture.command && i < picture.channelCount;
      say(cells[0], actuators[i].name);
      say(cells[1], !has ? "–" : isClick ? "waveform" : `${picture.frequency_hz[i].toFixed(2)} Hz`);
      say(cells[2], has ? `${(100 * picture.amplitude[i]).toFixed(1)} %` : "–");
      say(cells[3], !has || isClick ? "–" : `${((picture.phase_rad[i] * 180) / Math.PI).toFixed(0)}°`);
    }
  }

  _showLatency(picture) {
    let last = 0, median = 0;
    for (let i = 0; i < STAGES.length; i++) {
      last += picture.last_ns[i];
      median += picture.median_ns[i];
    }
    say(byId("total"), picture.latencies ? `${microseconds(last)} last, ${microseconds(median)} median of ${picture.latencies}` : "no touch yet");
    const found = rows(byId("latency").tBodies[0], STAGES.length, 3);
    for (let i = 0; i < STAGES.length; i++) {
      const cells = found[i].cells;
      say(cells[0], STAGES[i]);
      say(cells[1], picture.latencies ? microseconds(picture.last_ns[i]) : "–");
      say(cells[2], picture.latencies ? microseconds(picture.median_ns[i]) : "–");
      this._bars[i].style.flexGrow = `${median ? picture.median_ns[i] / median : 0}`;
    }
  }
}
