// Draws a plate from above: zones, actuators, a map of the level around fingers, and the plate's motion, slowed.

import { Bar } from "./bar.js";
import { FINGERTIP_M, RADIUS, SurfaceView, disc, freshness, isFresh } from "./surface.js";

const MARGIN = 10, HEAD = 24, FOOT = 26;
const FINE = 4; // pixels of a map between two points of its field, each way
const NEAR_M = 0.014, FAR_M = 0.024; // The map is whole near a finger of the command, and faint far from all.
const FAINT = 0.22;
const BANDS_DB = [0, 10, 20, 30];
const HANDLE = 6;

// The kind of drawing for a device: the page's only question of what surface it has.
export function drawingFor(device) { return Number.isNaN(device.corner_m.y) ? Bar : Plate; }

// How densely a level is coloured, in steps, so that the edge of what is felt shows.
function densityOf(db) { return db < 0 ? 0.07 * Math.max(0, 1 + db / 10) : 0.36 + 0.15 * Math.min(Math.floor(db / 10), 3); }

function rgbOf(hex) { return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)); }

export class Plate extends SurfaceView {
  constructor(...parts) {
    super(...parts);
    this._pause_ms = 25; // A map takes 2.5 ms to draw here: every second frame of most screens.
    this._map = document.createElement("canvas");
    this._slope = new Float32Array(this._bend.length);
  }

  // The largest plate that has room; y points up.
  _layOut() {
    if (!this._device) return;
    const { x: length_m, y: width_m } = this._device.corner_m;
    this._scale = Math.min((this._width - 2 * MARGIN) / length_m, (this._height - HEAD - FOOT) / width_m);
    this._left = (this._width - this._scale * length_m) / 2;
    this._right = this._width - this._left;
    this._top = HEAD + (this._height - HEAD - FOOT - this._scale * width_m) / 2;
    this._bottom = this._top + this._scale * width_m;
  }

  _fingerAt({ x, y }) { return { x: this._left + this._scale * x, y: this._bottom - this._scale * y }; }

  _footOf(index) { return this._fingerAt(this._placeOf(index)); }

  // The actuator within half of `reach` of a place of the canvas; -1 for none. Beside it a finger may touch.
  actuatorAt(x, y, reach) {
    if (!this._device || this._scale === undefined) return -1;
    return this._device.actuators.findIndex((_, index) => Math.hypot(this._footOf(index).x - x, this._footOf(index).y - y) < reach / 2);
  }

  // Position of the plate in the canvas, for pointers.
  place() { return { left: this._left, top: this._top, width: this._right - this._left, height: this._bottom - this._top }; }

  _paint(c, now_ms) {
    this._layOut();
    const colour = this._colour, size = [this._left, this._top, this._right - this._left, this._bottom - this._top];
    c.fillStyle = colour.metal;
    c.globalAlpha = 0.5;
    c.fillRect(...size);
    c.globalAlpha = 1;
    if (this._motion) this._drawRelief(c, size);
    this._drawLevels(c, size);
    this._drawZones(c);
    c.strokeStyle = colour.edge;
    c.lineWidth = 1.5;
    c.strokeRect(...size);
    this._drawMade(c);
    this._drawActuators(c);
    this._drawWords(c);
    this._drawFingers(c, now_ms);
  }

  // Draw a field over the plate, finely interpolated: `paint` gives red, green, blue and opacity (0 to 1) of a value
  // at a point as fractions of the plate, from its upper left corner.
  _drawField(c, size, values, along, rows, paint) {
    const width = FINE * (along - 1) + 1, height = FINE * (rows - 1) + 1;
    if (this._map.width !== width || this._map.height !== height) Object.assign(this._map, { width, height });
    const context = this._map.getContext("2d"), image = context.createImageData(width, height);
    for (let row = 0, at = 0; row < height; row++) {
      const v = (height - 1 - row) / FINE, j = Math.min(Math.floor(v), rows - 2), dv = v - j;
      for (let column = 0; column < width; column++, at += 4) {
        const u = column / FINE, i = Math.min(Math.floor(u), along - 2), du = u - i, k = j * along + i;
        const low = values[k] + (values[k + 1] - values[k]) * du;
        const high = values[k + along] + (values[k + along + 1] - values[k + along]) * du;
        const [red, green, blue, opacity] = paint(low + (high - low) * dv, column / (width - 1), row / (height - 1));
        image.data[at] = red;
        image.data[at + 1] = green;
        image.data[at + 2] = blue;
        image.data[at + 3] = 255 * opacity;
      }
    }
    context.putImageData(image, 0, 0);
    c.drawImage(this._map, ...size);
  }

  // The bent plate lit from the upper left.
  _drawRelief(c, size) {
    const { along, rows } = this._motion, bend = this._bend, light = [255, 255, 255, 0], shade = [0, 0, 0, 0];
    for (let j = 0, k = 0; j < rows; j++) {
      for (let i = 0; i < along; i++, k++) {
        const across = bend[j ? k - along : k] - bend[j < rows - 1 ? k + along : k];
        this._slope[k] = bend[i < along - 1 ? k + 1 : k] - bend[i ? k - 1 : k] + across;
      }
    }
    this._drawField(c, size, this._slope, along, rows, (slope) => {
      const tone = slope > 0 ? light : shade;
      tone[3] = Math.min(0.75, 1.8 * Math.abs(slope));
      return tone;
    });
  }

  // What counts for the last command while that is fresh, and what rings down after it.
  _drawLevels(c, size) {
    const { levelCount, rows, counted, made, madeCount } = this.picture;
    if (rows < 2) return;
    const fresh = freshness(this.picture), values = fresh ? counted : this._shown, { x: length_m, y: width_m } = this._device.corner_m;
    const tone = [...rgbOf(this._colour.level), 0], fade = fresh ? Math.min(1, 0.25 + fresh) : 1;
    this._drawField(c, size, values, levelCount / rows, rows, (db, x, y) => {
      let far_m = Infinity;
      for (let i = 0; i < madeCount; i++) far_m = Math.min(far_m, Math.hypot(x * length_m - made[i].position_m.x, (1 - y) * width_m - made[i].position_m.y));
      tone[3] = fade * densityOf(db) * Math.max(FAINT, Math.min(1, (FAR_M - far_m) / (FAR_M - NEAR_M)));
      return tone;
    });
  }

  _drawZones(c) {
    const colour = this._colour;
    c.strokeStyle = colour.edge;
    c.lineWidth = 1;
    c.setLineDash([3, 5]);
    c.font = `600 12px ${colour.font}`;
    c.textAlign = "left";
    for (const { name, start_m, stop_m } of this._device.zones) {
      const from = this._fingerAt(start_m), to = this._fingerAt(stop_m);
      c.strokeRect(from.x, to.y, to.x - from.x, from.y - to.y);
      c.fillStyle = colour.muted;
      if (!this._isSecond) c.fillText(name, from.x + 6, to.y + 15);
    }
    c.setLineDash([]);
  }

  // The fingers that the last command was made for: a ring as wide as a fingertip at the position of each.
  _drawMade(c) {
    const { made, madeCount } = this.picture, colour = this._colour, fresh = freshness(this.picture);
    c.globalAlpha = 0.3 * fresh;
    for (let i = 0; i < madeCount; i++) {
      const { x, y } = this._fingerAt(made[i].position_m);
      c.fillStyle = made[i].role === 2 ? colour.felt : colour.quiet;
      disc(c, x, y, Math.max(RADIUS + 4, 0.5 * FINGERTIP_M * this._scale));
    }
    c.globalAlpha = 1;
  }

  _drawActuators(c) {
    for (let index = 0; index < this._device.actuators.length; index++) {
      const { x, y } = this._footOf(index);
      c.fillStyle = this._colour.paper;
      c.strokeStyle = this._colour.ink;
      c.lineWidth = 1.5;
      c.beginPath();
      c.rect(x - HANDLE, y - HANDLE, 2 * HANDLE, 2 * HANDLE);
      c.fill();
      c.stroke();
      c.fillStyle = this._colour.ink;
      disc(c, x, y, 2);
    }
  }

  _drawWords(c) {
    const colour = this._colour, y = this._bottom + 17;
    c.fillStyle = colour.ink;
    c.font = `600 13px ${colour.font}`;
    c.textAlign = "left";
    c.fillText(this._isSecond ? "the paper’s drive" : "solved for these fingers", this._left, this._top - 8);
    c.font = `11px ${colour.font}`;
    c.fillStyle = colour.muted;
    let x = this._left;
    for (const db of this._motion && this._width < 480 ? [] : BANDS_DB) {
      const text = db ? `${db}` : "felt from 0 dB";
      c.fillStyle = colour.level;
      c.globalAlpha = densityOf(db);
      c.fillRect(x, y - 9, 12, 11);
      c.globalAlpha = 1;
      c.fillStyle = colour.muted;
      c.fillText(text, x + 16, y);
      x += 26 + c.measureText(text).width;
    }
    if (!this._motion) return;
    c.textAlign = "right";
    c.fillText(`slowed ${this.slowed}×: ${this._motionAt_ms.toFixed(0)} ms`, this._right, y);
  }

  // The level in words above the finger, below it at the upper edge.
  _drawLevelOf(c, slot, x, y, tone, labels) {
    const above = y - RADIUS - 40;
    return this._drawLabel(c, slot, x, above > 0 ? above : y + RADIUS + 7, tone, labels);
  }
}
