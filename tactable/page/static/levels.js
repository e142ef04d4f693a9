// Draws levels along the bar above the threshold: the scale, the present ones as an area, what counts as a line.

import { FINGERTIP_M, HIGHEST_DB, LOWEST_DB, Role, SurfaceView, isFresh, line } from "./surface.js";

export class LevelPlot extends SurfaceView {
  _layOut() {
    const narrow = this._narrow;
    this._left = narrow ? 40 : 58;
    this._right = this._width - (narrow ? 14 : 24);
    this._top = this._isSecond ? 10 : 26;
    this._floor = Math.round(this._height * (this._isSecond ? 0.62 : 0.6));
    this._middle = Math.round(this._height * (this._isSecond ? 0.83 : 0.765));
    this._bottom = this._height - (this._isSecond ? 4 : 34);
    this._thick = narrow ? 9 : 11;
  }

  _x(position_m) { return this._left + (this._right - this._left) * (position_m.x / this._device.corner_m.x); }

  _y(db) {
    const share = (Math.min(Math.max(db, LOWEST_DB), HIGHEST_DB) - LOWEST_DB) / (HIGHEST_DB - LOWEST_DB);
    return this._floor - share * (this._floor - this._top);
  }

  _drawScale(c) {
    const colour = this._colour;
    c.font = `11px ${colour.font}`;
    c.textBaseline = "middle";
    c.textAlign = "right";
    c.fillStyle = colour.muted;
    c.strokeStyle = colour.line;
    c.lineWidth = 1;
    for (let db = LOWEST_DB; db <= HIGHEST_DB; db += 20) {
      const y = this._y(db);
      if (db) line(c, this._left, y, this._right, y);
      c.fillText(db < 0 ? `−${-db}` : `${db}`, this._left - 7, y);
    }
    c.textAlign = "left";
    c.textBaseline = "alphabetic";
    if (!this._isSecond) c.fillText(this._narrow ? "dB over threshold" : "level along the bar, dB above the detection threshold", this._left - (this._narrow ? 30 : 44), 13);
    c.setLineDash([5, 4]);
    c.strokeStyle = colour.ink;
    line(c, this._left, this._y(0), this._right, this._y(0));
    c.setLineDash([]);
    c.fillStyle = colour.ink;
    c.textAlign = "right";
    c.fillText("just felt", this._right - 4, this._y(0) - 5);
  }

  _levelPath(c, values) {
    const count = this.picture.levelCount, step = (this._right - this._left) / (count - 1);
    c.beginPath();
    c.moveTo(this._left, this._y(values[0]));
    for (let i = 1; i < count; i++) c.lineTo(this._left + i * step, this._y(values[i]));
  }

  _drawLevels(c) {
    if (this.picture.levelCount < 2) return;
    const colour = this._colour;
    for (const [bottom, alpha] of [[this._floor, 0.1], [this._y(0), 0.2]]) {
      c.save();
      c.beginPath();
      c.rect(this._left, this._top - 2, this._right - this._left, bottom - this._top + 2);
      c.clip();
      this._levelPath(c, this._shown);
      c.lineTo(this._right, this._floor);
      c.lineTo(this._left, this._floor);
      c.closePath();
      c.globalAlpha = alpha;
      c.fillStyle = colour.level;
      c.fill();
      c.restore();
    }
    // The present level is an area; what counts for the command is a line, as the server gives it.
    c.strokeStyle = colour.level;
    c.lineWidth = 2;
    c.lineJoin = "round";
    const hasGaps = isFresh(this.picture) && this.picture.madeCount > 0;
    c.globalAlpha = hasGaps ? 0.3 : 1;
    this._countedPath(c);
    c.stroke();
    c.globalAlpha = 1;
    if (hasGaps) this._drawGaps(c);
  }

  // Where no finger is nothing needs to rest: the line is faded and the ground hatched there, and whole under fingers.
  _drawGaps(c) {
    const colour = this._colour, gaps = this._gaps();
    c.save();
    c.beginPath();
    c.rect(this._left, this._top - 2, this._right - this._left, this._floor - this._top + 4);
    for (const [from, to] of gaps) c.rect(to, this._top - 2, from - to, this._floor - this._top + 4);
    c.clip("evenodd");
    this._countedPath(c);
    c.stroke();
    c.restore();
    c.save();
    c.beginPath();
    for (const [from, to] of gaps) c.rect(from, this._top, to - from, this._floor - this._top);
    c.clip();
    c.strokeStyle = colour.muted;
    c.globalAlpha = 0.16;
    c.lineWidth = 1;
    const height = this._floor - this._top;
    c.beginPath();
    for (let x = this._left - height; x < this._right; x += 11) { c.moveTo(x, this._floor); c.lineTo(x + height, this._top); }
    c.stroke();
    c.restore();
    c.font = `12px ${colour.font}`;
    c.textAlign = "center";
    c.textBaseline = "alphabetic";
    const text = "no finger here: may move", width = c.measureText(text).width + 12;
    for (const [from, to] of gaps) {
      if (to - from < width + 8) continue;
      c.fillStyle = colour.paper;
      c.globalAlpha = 0.85;
      c.fillRect((from + to - width) / 2, this._floor - 22, width, 17);
      c.globalAlpha = 1;
      c.fillStyle = colour.muted;
      c.fillText(text, (from + to) / 2, this._floor - 9);
    }
  }

  // Stretches of the canvas, from and to, without a finger of the last command.
  _gaps() {
    const { made, madeCount } = this.picture, half = (FINGERTIP_M / 2 / this._device.corner_m.x) * (this._right - this._left);
    const at = made.slice(0, madeCount).map((finger) => this._x(finger.position_m)).sort((a, b) => a - b), gaps = [];
    let from = this._left;
    for (const x of at) {
      if (x - half > from) gaps.push([from, x - half]);
      from = Math.max(from, x + half);
    }
    if (from < this._right) gaps.push([from, this._right]);
    return gaps;
  }

  // The line of what counts, through the level of every finger too: where one rests the bar may be still between points.
  _countedPath(c) {
    const { counted, levelCount, fingers, fingerCount, drive } = this.picture, fresh = isFresh(this.picture);
    const step_m = this._device.corner_m.x / (levelCount - 1);
    c.beginPath();
    c.moveTo(this._left, this._y(counted[0]));
    for (let i = 1; i < levelCount; i++) {
      for (let k = 0; fresh && k < fingerCount; k++) {
        const { position_m, role, level_db, felt_db } = fingers[k];
        if (role === Role.NONE || position_m.x <= (i - 1) * step_m || position_m.x >= i * step_m) continue;
        c.lineTo(this._x(position_m), this._y(drive === 1 ? level_db : felt_db));
      }
      c.lineTo(this._x({ x: i * step_m }), this._y(counted[i]));
    }
  }
}
