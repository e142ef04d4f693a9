// Draws the bar: zones, fingers, the level along it above the threshold, and its motion, slowed.

import { LevelPlot } from "./levels.js";
import { FINGERTIP_M, GHOST_MS, ORDERS, RADIUS, Role, disc, freshness, isFresh, line } from "./surface.js";

const STEM_GAP = 5;

export class Bar extends LevelPlot {
  _footOf(index) { return { x: this._x(this._placeOf(index)), y: this._middle + this._reach() + (this._isSecond ? 4 : 12) }; }

  // The actuator whose foot is within `reach` of a place of the canvas; -1 for none.
  actuatorAt(x, y, reach) {
    if (!this._device || y < this._middle + this._thick) return -1;
    const distances = this._device.actuators.map((_, index) => Math.abs(this._footOf(index).x - x));
    const nearest = distances.indexOf(Math.min(...distances));
    return distances[nearest] < reach && Math.abs(this._footOf(nearest).y + 4 - y) < reach ? nearest : -1;
  }

  // Position of the bar in the canvas, for pointers, which have no y on it.
  place() { return { left: this._left, top: 0, width: this._right - this._left, height: NaN }; }

  _paint(c, now_ms) {
    this._drawZones(c);
    this._drawScale(c);
    this._drawLevels(c);
    this._drawBar(c);
    this._drawFingers(c, now_ms);
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
    const half = (FINGERTIP_M / 2 / this._device.corner_m.x) * (this._right - this._left);
    c.globalAlpha = 0.07 + 0.15 * fresh;
    for (let i = 0; i < madeCount; i++) {
      c.fillStyle = made[i].role === Role.FELT ? colour.felt : colour.quiet;
      const x = this._x(made[i].position_m);
      c.fillRect(x - half, this._top, 2 * half, this._bottom - this._top);
    }
    c.globalAlpha = 1;
  }

  _bendAt(share) {
    const count = this._motion ? this._motion.along : 0;
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

  _fingerAt(position_m) {
    const x = this._x(position_m);
    return { x, y: this._middle + this._bendAt((x - this._left) / (this._right - this._left)) };
  }

  // Draw a stem to the level, and the level in words.
  _drawLevelOf(c, slot, x, y, tone, labels) {
    const level_y = this._y(slot.level_db);
    c.strokeStyle = tone;
    c.lineWidth = 1.5;
    line(c, x, y - RADIUS, x, level_y);
    c.fillStyle = tone;
    disc(c, x, level_y, 5);
    return this._drawLabel(c, slot, x, Math.max(level_y - 42, 2), tone, labels);
  }
}
