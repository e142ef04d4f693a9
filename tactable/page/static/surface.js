// What the drawings of a bar and of a plate share: colours, the field of levels, its slowed motion, fingers with their levels.

import { NOTHING } from "./wire.js";

export const Role = { NONE: 0, QUIET: 1, FELT: 2 };
// What a command asks of a finger, by role.
export const ORDERS = { [Role.QUIET]: "to rest", [Role.FELT]: "to feel" };
export const LOWEST_DB = -20, HIGHEST_DB = 40;
export const FINGERTIP_M = 0.016;
export const GHOST_MS = 1500;
export const RADIUS = 15;
const FALL_DB_PER_S = 30; // A click of 30 ms stays in sight.
const FRESH_S = 3;
const PAUSE_MS = 700;
const PASSES = 3;
const SLOTS = 32;

// How much the last command still counts: 1 while it plays, 0 after FRESH_S.
export function freshness(picture) {
  if (!picture.command) return 0;
  return picture.isPlaying ? 1 : Math.max(0, 1 - picture.age_s / FRESH_S);
}

export function isFresh(picture) { return freshness(picture) > 0; }

export function line(c, x0, y0, x1, y1) { c.beginPath(); c.moveTo(x0, y0); c.lineTo(x1, y1); c.stroke(); }

const SETTLED_S = { 1: 0.25, 2: 0.06 }; // By kind of drive: from then on the levels say what was felt.

export function isSettled(picture) { return !picture.command || picture.age_s >= SETTLED_S[picture.drive]; }

// A level as a label says it. A deeper null than LOWEST_DB exists in the model alone; no real surface shows it.
export function levelText(db) {
  if (db <= -59.9) return "nothing";
  return db < LOWEST_DB ? `below −${-LOWEST_DB} dB` : `${db < 0 ? "−" : ""}${Math.abs(db).toFixed(1)} dB`;
}

// The level that counts for a finger: the judged one, which the sentence has too, or its own where it is none of those
// that the command was made for.
function levelOf(picture, number, otherwise_db) {
  for (let i = 0; i < picture.madeCount; i++) {
    const made = picture.made[i];
    if (made.called === number && made.simulated !== NOTHING) return made.simulated / 100;
  }
  return otherwise_db;
}

// What a finger perceives, whatever was asked for: 0 dB is the detection threshold.
function outcomeText(db) { return db >= 0 ? "felt" : "not felt"; }

export function disc(c, x, y, radius) { c.beginPath(); c.arc(x, y, radius, 0, 2 * Math.PI); c.fill(); }

const MOST_POINTS = 4096;

export class SurfaceView {
  // `isSecond`: it stands below or beside another one, which has the words.
  constructor(canvas, picture, isSecond = false) {
    this.canvas = canvas;
    this.picture = picture;
    this.dirty = true;
    this._isSecond = isSecond;
    this._context = canvas.getContext("2d");
    this._device = null;
    this._shown = new Float32Array(MOST_POINTS).fill(LOWEST_DB);
    this._counted = new Float32Array(MOST_POINTS).fill(LOWEST_DB);
    this._countedOf = 0;
    this.frames = 0;
    this.slowed = 50;
    this._bend = new Float32Array(MOST_POINTS);
    this._motion = null;
    this._motionStart_ms = 0;
    this._slots = Array.from({ length: SLOTS }, () =>
      ({ number: -1, position_m: { x: 0, y: NaN }, level_db: 0, role: 0, seen_ms: -1e9, said: "" }));
    this._labels = new Float32Array(3 * SLOTS);
    this._places = null;
    this._last_ms = 0;
    this._pause_ms = 0; // between two drawings
    this._still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this._dark = matchMedia("(prefers-color-scheme: dark)");
    this._onDark = () => this._readColours();
    this._dark.addEventListener("change", this._onDark);
    this._readColours();
    this._observer = new ResizeObserver(() => this._resize());
    this._observer.observe(canvas);
    this._resize();
  }

  // Another drawing takes the canvas.
  close() {
    this._observer.disconnect();
    this._dark.removeEventListener("change", this._onDark);
  }

  _readColours() {
    const style = getComputedStyle(document.documentElement), colour = (name) => style.getPropertyValue(name).trim();
    this._colour = { edge: colour("--metal-edge"), font: getComputedStyle(document.body).fontFamily };
    for (const name of ["ink", "muted", "line", "felt", "quiet", "level", "metal", "paper"]) this._colour[name] = colour(`--${name}`);
    this.dirty = true;
  }

  _resize() {
    const box = this.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    if (!box.width) return;
    this._width = box.width;
    this._height = box.height;
    this.canvas.width = Math.round(box.width * ratio);
    this.canvas.height = Math.round(box.height * ratio);
    this._ratio = ratio;
    this._narrow = box.width < 560;
    this._layOut();
    this.dirty = true;
  }

  set device(device) { this._device = device; this._motion = null; this.dirty = true; }

  get shownDevice() { return this._device; }

  // Where the actuators are drawn while one is dragged; null: where the device has them.
  set places(places) { this._places = places; this.dirty = true; }

  _placeOf(index) { return this._places?.[index] ?? this._device.actuators[index].position_m; }

  show(motion) {
    this._motion = motion;
    this._motionStart_ms = performance.now();
  }

  // Whether the pause between two drawings is over.
  isDue(now_ms) { return now_ms >= this._last_ms + this._pause_ms; }

  // Draw one frame, unless nothing has changed.
  draw(now_ms) {
    const passed_s = Math.min((now_ms - this._last_ms) / 1000, 0.1);
    this._last_ms = now_ms;
    if (!this._device || !this._width) return;
    const falls = this._fall(passed_s), moves = this._move(now_ms), fades = this._note(now_ms);
    if (!this.dirty && !falls && !moves && !fades) return;
    this.dirty = false;
    this.frames++;
    const c = this._context;
    c.setTransform(this._ratio, 0, 0, this._ratio, 0, 0);
    c.clearRect(0, 0, this._width, this._height);
    this._paint(c, now_ms);
  }

  // Bend of the surface at each point, -1 to 1.
  _move(now_ms) {
    const motion = this._motion;
    if (!motion) return false;
    const once_ms = 1000 * motion.steps * motion.step_s * this.slowed, pause_ms = motion.isClick ? PAUSE_MS : 0;
    const since_ms = now_ms - this._motionStart_ms;
    const passes = !motion.isClick && this.picture.isPlaying && this.picture.command === motion.command ? Infinity : PASSES;
    if (since_ms < 0 || since_ms > passes * (once_ms + pause_ms)) {
      this._motion = null;
      this._bend.fill(0);
      return true;
    }
    const in_ms = this._still ? 0.3 * once_ms : since_ms % (once_ms + pause_ms);
    const at = Math.min(in_ms / once_ms, 1) * (motion.steps - 1), step = Math.min(Math.floor(at), motion.steps - 2), part = at - step;
    // A click is faded out: its moment ends before the surface is still.
    const ease = motion.isClick ? Math.min(1, (1 - in_ms / (once_ms + pause_ms)) * 4) : 1;
    for (let i = 0; i < motion.along * motion.rows; i++) {
      const a = motion.words[step * motion.columns + i], b = motion.words[(step + 1) * motion.columns + i];
      this._bend[i] = ease * (a + (b - a) * part) / 32767;
    }
    this._motionAt_ms = (at * motion.step_s) * 1000;
    return true;
  }

  // Note the fingers; those that lifted a moment ago stay in their slots as ghosts.
  _note(now_ms) {
    const picture = this.picture;
    for (let i = 0; i < picture.fingerCount; i++) {
      const finger = picture.fingers[i];
      let slot = this._slots.find((each) => each.number === finger.number && now_ms - each.seen_ms < GHOST_MS);
      slot ??= this._slots.reduce((oldest, each) => (each.seen_ms < oldest.seen_ms ? each : oldest));
      slot.number = finger.number;
      Object.assign(slot.position_m, finger.position_m);
      slot.role = isFresh(picture) ? finger.role : Role.NONE;
      slot.level_db = picture.drive === 1 ? finger.level_db : finger.felt_db;
      slot.seen_ms = now_ms;
    }
    const shown = this._slots.filter((slot) => now_ms - slot.seen_ms < GHOST_MS);
    for (const slot of shown) slot.level_db = levelOf(picture, slot.number, slot.level_db);
    return shown.length > 0;
  }

  _fall(passed_s) {
    const { levels, counted, levelCount, command } = this.picture;
    let falls = false;
    if (command !== this._countedOf) {
      this._countedOf = command;
      this._counted.fill(LOWEST_DB);
    }
    for (let i = 0; i < levelCount; i++) {
      const before = this._shown[i], fallen = Math.max(before - FALL_DB_PER_S * passed_s, LOWEST_DB);
      // What counts has risen since the last picture: it was so loud in between, in pictures that never came here.
      const risen = counted[i] > this._counted[i] ? counted[i] : LOWEST_DB;
      this._counted[i] = counted[i];
      this._shown[i] = Math.max(levels[i], risen, fallen);
      falls ||= this._shown[i] > LOWEST_DB || before > LOWEST_DB;
    }
    return falls;
  }

  _drawFingers(c, now_ms) {
    const colour = this._colour;
    let labels = 0;
    for (const slot of this._slots) {
      const age_ms = now_ms - slot.seen_ms;
      slot.said = "";
      if (age_ms >= GHOST_MS) continue;
      const { x, y } = this._fingerAt(slot.position_m);
      const tone = slot.role === Role.FELT ? colour.felt : slot.role === Role.QUIET ? colour.quiet : colour.muted;
      const isHere = age_ms < 100;
      c.globalAlpha = isHere ? 1 : Math.max(0, 0.8 * (1 - age_ms / GHOST_MS));
      if (slot.role !== Role.NONE) labels = this._drawLevelOf(c, slot, x, y, tone, labels);
      c.lineWidth = 3;
      c.strokeStyle = tone;
      c.fillStyle = colour.paper;
      if (!isHere) c.setLineDash([4, 4]);
      c.globalAlpha *= 0.88;
      disc(c, x, y, RADIUS);
      c.globalAlpha /= 0.88;
      c.stroke();
      c.setLineDash([]);
      c.fillStyle = colour.ink;
      c.font = `600 12px ${colour.font}`;
      c.textAlign = "center";
      c.textBaseline = "middle";
      c.fillText(`${slot.number + 1}`, x, y + 0.5);
      c.textBaseline = "alphabetic";
      c.globalAlpha = 1;
    }
  }

  // Draw the level in words, its top at `label_y` unless another label is there; labels do not overlap.
  _drawLabel(c, slot, x, label_y, tone, labels) {
    // Until a command has settled, a finger that has felt nothing may still feel it.
    const isKnown = slot.level_db >= 0 || isSettled(this.picture), colour = this._colour;
    const text = isKnown ? levelText(slot.level_db) : "…", word = isKnown ? outcomeText(slot.level_db) : "wait";
    slot.said = `${text}, ${word}`;
    c.font = `600 13px ${colour.font}`;
    const box = Math.max(c.measureText(text).width, 46) + 12;
    const label_x = Math.min(Math.max(x, this._left + box / 2), this._right - box / 2);
    for (let i = 0; i < labels; i++) {
      const apart = Math.abs(this._labels[3 * i] - label_x) < (this._labels[3 * i + 2] + box) / 2;
      if (apart && Math.abs(this._labels[3 * i + 1] - label_y) < 34) { label_y = this._labels[3 * i + 1] + 35; i = -1; }
    }
    this._labels[3 * labels] = label_x;
    this._labels[3 * labels + 1] = label_y;
    this._labels[3 * labels + 2] = box;
    c.save();
    c.globalAlpha *= 0.92;
    c.fillStyle = colour.paper;
    c.beginPath();
    c.roundRect(label_x - box / 2, label_y, box, 33, 6);
    c.fill();
    c.restore();
    c.strokeStyle = tone;
    c.lineWidth = 1;
    c.stroke();
    c.textAlign = "center";
    c.fillStyle = colour.ink;
    c.fillText(text, label_x, label_y + 14);
    c.font = `11px ${colour.font}`;
    c.fillStyle = tone;
    c.fillText(word, label_x, label_y + 27);
    return Math.min(labels + 1, SLOTS - 1);
  }
}
