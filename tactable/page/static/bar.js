// Draws the bar: zones, fingers, the level along it above the threshold, and its motion, slowed.

import { FINGERTIP_M, LevelPlot, Role, freshness, isFresh, line } from "./levels.js";

// What a command asks of a finger, by role.
export const ORDERS = { [Role.QUIET]: "to rest", [Role.FELT]: "to feel" };
const GHOST_MS = 1500;
const PAUSE_MS = 700;
const PASSES = 3;
const SLOTS = 32;
const RADIUS = 15;
const STEM_GAP = 5;

export function levelText(db) { return db <= -59.9 ? "nothing" : `${db < 0 ? "−" : ""}${Math.abs(db).toFixed(1)} dB`; }

// What a finger perceives, whatever was asked for: 0 dB is the detection threshold.
function outcomeText(db) { return db >= 0 ? "felt" : "not felt"; }

function disc(c, x, y, radius) { c.beginPath(); c.arc(x, y, radius, 0, 2 * Math.PI); c.fill(); }

export class Bar extends LevelPlot {
  constructor(canvas, picture, isSecond = false) {
    super(canvas, picture, isSecond);
    this.frames = 0;
    this.slowed = 50;
    this._bend = new Float32Array(256);
    this._motion = null;
    this._motionStart_ms = 0;
    this._slots = Array.from({ length: SLOTS }, () =>
      ({ number: -1, position_m: 0, level_db: 0, role: 0, seen_ms: -1e9 }));
    this._labels = new Float32Array(3 * SLOTS);
    this._places = null;
    this._last_ms = 0;
    this._still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  }

  set device(device) { this._device = device; this._motion = null; this.dirty = true; }

  get shownDevice() { return this._device; }

  // Where the actuators are drawn while one is dragged; null: where the device has them.
  set places(places) { this._places = places; this.dirty = true; }

  _placeOf(index) { return this._places?.[index] ?? this._device.actuators[index].position_m; }

  _footOf(index) { return { x: this._x(this._placeOf(index)), y: this._middle + this._reach() + (this._isSecond ? 4 : 12) }; }

  // The actuator whose foot is within `reach` of a place of the canvas; -1 for none.
  actuatorAt(x, y, reach) {
    if (!this._device || y < this._middle + this._thick) return -1;
    const distances = this._device.actuators.map((_, index) => Math.abs(this._footOf(index).x - x));
    const nearest = distances.indexOf(Math.min(...distances));
    return distances[nearest] < reach && Math.abs(this._footOf(nearest).y + 4 - y) < reach ? nearest : -1;
  }

  // Position of the bar in the canvas, for pointers.
  place() { return { left: this._left, width: this._right - this._left, height: this._height }; }

  show(motion) {
    this._motion = motion;
    this._motionStart_ms = performance.now();
  }

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
    this._drawZones(c);
    this._drawScale(c);
    this._drawLevels(c);
    this._drawBar(c);
    this._drawFingers(c, now_ms);
  }

  // Bend of the bar at each point, -1 to 1.
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
    // A click is faded out: its moment ends before the bar is still.
    const ease = motion.isClick ? Math.min(1, (1 - in_ms / (once_ms + pause_ms)) * 4) : 1;
    for (let i = 0; i < motion.points; i++) {
      const a = motion.words[step * motion.points + i], b = motion.words[(step + 1) * motion.points + i];
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
      slot.position_m = finger.position_m;
      slot.role = isFresh(picture) ? finger.role : Role.NONE;
      slot.level_db = picture.drive === 1 ? finger.level_db : finger.felt_db;
      slot.seen_ms = now_ms;
    }
    return this._slots.some((slot) => now_ms - slot.seen_ms < GHOST_MS);
  }

  _drawZones(c) {
    const { zones } = this._device, colour = this._colour;
    c.textAlign = "center";
    c.textBaseline = "alphabetic";
    for (let zone = 0; zone < zones.length; zone++) {
      const x0 = this._x(zones[zone].start_m), x1 = this._x(zones[zone].stop_m);
      c.strokeStyle = colour.line;
      c.lineWidth = 1;
      c.beginPath();
      for (const x of [x0, x1]) { c.moveTo(x, this._top); c.lineTo(x, this._bottom); }
      c.stroke();
      if (this._isSecond) continue;
      const middle = (x0 + x1) / 2;
      c.fillStyle = colour.ink;
      c.font = `600 14px ${colour.font}`;
      c.fillText(zones[zone].name, middle, this._height - 17);
      c.font = `12px ${colour.font}`;
      const [feels, rests, touched] = this._rolesIn(zone);
      c.fillStyle = feels ? colour.felt : rests ? colour.quiet : colour.muted;
      const orders = [feels && ORDERS[Role.FELT], rests && ORDERS[Role.QUIET]].filter(Boolean).join(", ");
      c.fillText(orders || (touched ? "touched" : "free"), middle, this._height - 2);
    }
    this._drawMade(c);
  }

  // Whether the last command has a finger in a zone that is to feel, and one that is to rest; whether one is there now.
  _rolesIn(zone) {
    const { made, madeCount, fingers, fingerCount } = this.picture, fresh = isFresh(this.picture);
    let feels = false, rests = false, touched = false;
    for (let i = 0; fresh && i < madeCount; i++) {
      feels ||= made[i].zone === zone && made[i].role === Role.FELT;
      rests ||= made[i].zone === zone && made[i].role === Role.QUIET;
    }
    for (let i = 0; i < fingerCount; i++) touched ||= fingers[i].zone === zone;
    return [feels, rests, touched];
  }

  // The fingers that the last command was made for: a band as wide as a fingertip at the position of each.
  _drawMade(c) {
    const { made, madeCount } = this.picture, colour = this._colour, fresh = freshness(this.picture);
    if (!fresh) return;
    const half = (FINGERTIP_M / 2 / this._device.length_m) * (this._right - this._left);
    c.globalAlpha = 0.07 + 0.15 * fresh;
    for (let i = 0; i < madeCount; i++) {
      c.fillStyle = made[i].role === Role.FELT ? colour.felt : colour.quiet;
      const x = this._x(made[i].position_m);
      c.fillRect(x - half, this._top, 2 * half, this._bottom - this._top);
    }
    c.globalAlpha = 1;
  }

  _bendAt(share) {
    const count = this._motion ? this._motion.points : 0;
    if (!count) return 0;
    const at = share * (count - 1), i = Math.min(Math.floor(at), count - 2);
    return (this._bend[i] + (this._bend[i + 1] - this._bend[i]) * (at - i)) * this._reach();
  }

  _reach() { return Math.min(30, this._height * 0.07); }

  _drawBar(c) {
    const colour = this._colour, width = this._right - this._left, steps = 120, half = this._thick / 2;
    for (let index = 0; index < this._device.actuators.length; index++) {
      const { x, y } = this._footOf(index);
      c.strokeStyle = colour.muted;
      c.lineWidth = 1.5;
      line(c, x, this._middle + this._bendAt((x - this._left) / width), x, y);
      c.fillStyle = colour.muted;
      c.beginPath();
      c.moveTo(x, y - 2);
      c.lineTo(x - 6, y + 8);
      c.lineTo(x + 6, y + 8);
      c.closePath();
      c.fill();
    }
    c.beginPath();
    for (let i = 0; i <= steps; i++) c.lineTo(this._left + (width * i) / steps, this._middle - half + this._bendAt(i / steps));
    for (let i = steps; i >= 0; i--) c.lineTo(this._left + (width * i) / steps, this._middle + half + this._bendAt(i / steps));
    c.closePath();
    c.fillStyle = colour.metal;
    c.fill();
    c.strokeStyle = colour.edge;
    c.lineWidth = 1;
    c.stroke();
    c.font = `11px ${colour.font}`;
    c.textAlign = "right";
    c.fillStyle = colour.muted;
    if (this._motion) {
      const what = this._narrow ? `slowed ${this.slowed}×` : `the bar's acceleration, slowed ${this.slowed} times`;
      this._drawBesideStems(c, `${what}: ${this._motionAt_ms.toFixed(0)} ms`, this._floor + 16);
    }
  }

  // Draw a text as far right as no finger's stem crosses it; nowhere where it has no room.
  _drawBesideStems(c, text, y) {
    const right = this._roomFor(c.measureText(text).width);
    if (right !== null) c.fillText(text, right, y);
  }

  // Right end of the rightmost stretch between stems that is as wide as a text; null for none.
  _roomFor(width) {
    const stems = this._slots.filter((slot) => this._last_ms - slot.seen_ms < GHOST_MS && slot.role !== Role.NONE)
      .map((slot) => this._x(slot.position_m)).sort((a, b) => b - a);
    let right = this._right;
    for (const x of [...stems, this._left - STEM_GAP]) {
      if (right - (x + STEM_GAP) >= width) return right;
      right = Math.min(right, x - STEM_GAP);
    }
    return null;
  }

  _drawFingers(c, now_ms) {
    const colour = this._colour, width = this._right - this._left;
    let labels = 0;
    for (const slot of this._slots) {
      const age_ms = now_ms - slot.seen_ms;
      if (age_ms >= GHOST_MS) continue;
      const x = this._x(slot.position_m), y = this._middle + this._bendAt((x - this._left) / width);
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

  // Draw a stem to the level, and the level in words; labels do not overlap.
  _drawLevelOf(c, slot, x, y, tone, labels) {
    const colour = this._colour, level_y = this._y(slot.level_db), text = levelText(slot.level_db);
    c.strokeStyle = tone;
    c.lineWidth = 1.5;
    line(c, x, y - RADIUS, x, level_y);
    c.fillStyle = tone;
    disc(c, x, level_y, 5);
    c.font = `600 13px ${colour.font}`;
    const word = outcomeText(slot.level_db), box = Math.max(c.measureText(text).width, 46) + 12;
    const label_x = Math.min(Math.max(x, this._left + box / 2), this._right - box / 2);
    let label_y = Math.max(level_y - 42, 2);
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
