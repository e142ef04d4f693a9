// Connects the parts of the page: the wire, the surface, the panel, fingers and sound.

import { DeviceHand } from "./device.js";
import { Fingers } from "./fingers.js";
import { Courses, outcomeOf, promiseOf } from "./outcome.js";
import { Panel, byId } from "./panel.js";
import { linkOf, readLink } from "./permalink.js";
import { drawingFor } from "./plate.js";
import { middleOf, pointAt, shareOf } from "./points.js";
import { snapshotOf } from "./snapshot.js";
import { Sound } from "./sound.js";
import { Wire } from "./wire.js";

const PANEL_MS = 125;
const HEARD_AFTER_MS = 550; // The server captures the sound 0.4 s after a command.

let scene = null, heard = 0, panel_ms = 0, isDrawn = false, isWelcomed = false, link = null, bar = null, second = null;
const sound = new Sound();
const wire = new Wire({
  scene(found) {
    scene = found;
    if (JSON.stringify(bar?.shownDevice) !== JSON.stringify(found.device)) {
      draw(found.device);
      courses.clear();
      byId("courses").removeAttribute("data-has");
    }
    panel.scene = found;
    deviceHand.update(found);
    fingers.zones = found.device.zones.map((zone) => shareOf(middleOf(zone), found.device.corner_m));
  },
  picture() {
    if (bar) bar.dirty = second.dirty = true;
    for (const id of ["paper", "courses-paper"]) byId(id).hidden = !wire.picture.hasPaper;
    // They are those of a click.
    byId("courses").hidden = wire.picture.drive === 1 || (scene?.plays && scene.plays.source !== "click");
  },
  motions([ours, papers]) {
    bar?.show(ours);
    if (papers) second?.show(papers);
    byId("courses").toggleAttribute("data-has", courses.take(ours, papers));
  },
  sound(found) { sound.play(found); },
  state(...connection) { panel.state(...connection); },
});
const panel = new Panel(wire);
const courses = new Courses(byId("course"), wire.picture);
const deviceHand = new DeviceHand(wire);
deviceHand.onTrouble = (text) => panel.trouble(text);
const fingers = new Fingers(byId("bar"), wire, () => bar.place(), deviceHand);

// Draw a device, by other drawings where its surface is another.
function draw(device) {
  const Drawing = drawingFor(device);
  if (bar?.constructor !== Drawing) {
    fingers.surface = document.body.dataset.surface = Drawing.name.toLowerCase();
    for (const word of document.querySelectorAll(".surface")) word.textContent = fingers.surface;
    for (const before of deviceHand.drawings) before.close();
    bar = new Drawing(byId("bar"), wire.picture);
    second = new Drawing(byId("paper-bar"), wire.paper, true);
    deviceHand.drawings = [bar, second];
    slow();
  }
  document.body.style.setProperty("--sides", device.corner_m.x / device.corner_m.y);
  bar.device = second.device = device;
}


const ear = byId("ear");
for (let number = 1; number <= 10; number++) ear.add(new Option(`${number}`, `${number - 1}`));

byId("keep").addEventListener("change", (event) => { fingers.keeps = event.target.checked; });
byId("lift").addEventListener("click", () => fingers.liftAll());
function startTour() {
  if (!fingers.zones) return;
  fingers.startTour(fingers.zones[Math.max(fingers.zones.length - 2, 0)], fingers.zones[0]);
}

// Once something plays, the fingers of the link come; without a link the tour, unless somebody touched first. A link to
// `#no-tour` asks for nothing.
function welcome() {
  if (!scene || scene.mode !== "demo") return;
  if (link === null) {
    link = readLink(location.hash, scene);
    if (Object.keys(link.switches).length) wire.choose(link.switches);
  }
  if (isWelcomed || !scene.plays) return;
  if (link.switches.device !== undefined && scene.plays.device !== link.switches.device) return;
  isWelcomed = true;
  if (fingers.down.size) return;
  if (link.fingers.length) fingers.place(link.fingers.map((at) => shareOf(at, scene.device.corner_m)));
  else if (!location.hash) startTour();
}

// The address says what is chosen and which fingers stay, so that it can be passed on.
function linkScene() {
  if (!isWelcomed || !scene || fingers.isTouring) return;
  const found = linkOf(scene.choice, fingers.staying.map((share) => pointAt(share, scene.device.corner_m)));
  if (found !== location.hash && location.hash !== "#no-tour") history.replaceState(null, "", found);
}

// One sentence: the outcome of the last command; the tour's own words before the first and at its end.
function tell() {
  const promised = byId("promised"), said = promiseOf(wire.picture, fingers.surface, scene?.device.spread);
  if (promised.textContent !== said) {
    promised.textContent = said;
    fit(promised);
  }
  const outcome = byId("outcome"), found = outcomeOf(wire.picture, wire.paper, fingers.isTouring);
  const text = fingers.says ?? found ?? (wire.picture.command || fingers.isTouring ? null : `Touch the ${fingers.surface}.`);
  outcome.toggleAttribute("data-old", text === null); // Of the command before, until the newest has settled
  if (text === null || outcome.textContent === text) return;
  outcome.textContent = text;
  outcome.toggleAttribute("data-tour", fingers.says !== null);
  fit(outcome);
}

// Set a text smaller until it fits into its place.
function fit(box) {
  for (let share = 1; share > 0.5; share -= 0.05) {
    box.style.setProperty("--share", share);
    if (box.scrollHeight <= box.clientHeight) return;
  }
}

new ResizeObserver(() => fit(byId("outcome"))).observe(byId("outcome"));
new ResizeObserver(() => courses.draw()).observe(byId("course"));
byId("show-me").addEventListener("click", startTour);
function slow() {
  bar.slowed = second.slowed = Math.round(5 * 40 ** (byId("slowed").value / 100)); // 5 to 200 times, even in ratio.
  byId("slowed-text").textContent = `${bar.slowed}×`;
}
byId("slowed").addEventListener("input", () => bar && slow());
// The page as a picture that can stand alone: it says what is simulated, and above which threshold levels are.
function pictureUrl() {
  const style = getComputedStyle(document.documentElement), colour = (name) => style.getPropertyValue(`--${name}`).trim();
  const small = (text) => ({ text, size: 12.5, colour: colour("muted") }), isShown = (id) => !byId(id).hidden;
  return snapshotOf([
    small(`tactable: ${byId("device-name").textContent}${isShown("badge") ? `. ${byId("badge").textContent}` : ""}`),
    { text: byId("outcome").textContent, size: 24, weight: 700, colour: colour("ink") },
    ...(byId("promised").textContent ? [small(byId("promised").textContent)] : []),
    { canvas: bar.canvas },
    ...(isShown("paper") ? [{ canvas: second.canvas }, small(byId("paper-title").textContent)] : []),
    ...(isShown("courses") && courses.isDrawn ? [small(byId("courses").innerText.trim()), { canvas: courses.canvas }] : []),
    small(byId("estimates").textContent),
  ], { paper: colour("paper"), font: getComputedStyle(document.body).fontFamily });
}

byId("save").addEventListener("click", () => {
  const link = document.createElement("a");
  link.href = pictureUrl();
  link.download = `tactable-${scene?.device.name ?? "surface"}.png`;
  link.click();
});
byId("hear").addEventListener("click", () => { sound.wake(); wire.listen(Number(ear.value)); });
byId("always").addEventListener("change", () => sound.wake());
fingers.onUse = () => { byId("lift").hidden = !fingers.anyKept; };

function listen() {
  const { command } = wire.picture;
  if (command === heard) return;
  heard = command;
  if (command && byId("always").checked) setTimeout(() => wire.listen(Number(ear.value)), HEARD_AFTER_MS);
}

function frame(now_ms) {
  if (!bar || bar.isDue(now_ms)) { // The sentence and the labels are of one picture.
    tell();
    bar?.draw(now_ms);
    if (wire.picture.hasPaper) second?.draw(now_ms);
  }
  if (scene && !isDrawn) {
    isDrawn = true;
    performance.mark("first-drawing");
  }
  if (now_ms - panel_ms > PANEL_MS) {
    panel_ms = now_ms;
    panel.update(wire.picture, wire.received);
    listen();
    welcome();
    linkScene();
  }
  requestAnimationFrame(frame);
}

// For tests, and for the console of the browser.
window.tactable = { wire, get bar() { return bar; }, get second() { return second; }, courses, fingers, deviceHand, panel, sound, get scene() { return scene; } };
wire.connect();
requestAnimationFrame(frame);
