// Draws levels along the bar above the threshold: the scale, the present ones as an area, what counts as a line.

export const Role = { NONE: 0, QUIET: 1, FELT: 2 };
const LOWEST_DB = -20, HIGHEST_DB = 40;
const FALL_DB_PER_S = 30; // A click of 30 ms stays in sight.
const FRESH_S = 3;
export const FINGERTIP_M = 0.016;

// How much the last command still counts: 1 while it plays, 0 after FRESH_S.
export function freshness(picture) {
  if (!picture.command) return 0;
  return picture.isPlaying ? 1 : Math.max(0, 1 - picture.age_s / FRESH_S);
}

export function isFresh(picture) { return freshness(picture) > 0; }

export function line(c, x0, y0, x1, y1) { c.beginPath(); c.moveTo(x0, y0); c.lineTo(x1, y1); c.stroke(); }

export class LevelPlot {
  // `isSecond`: it stands below another one, which has the words.
  constructor(canvas, picture, isSecond = false) {
    this.canvas = canvas;
    this.picture = picture;
    this.dirty = true;
    this._isSecond = isSecond;
    this._context = canvas.getContext("2d");
    this._device = null;
    this._shown = new Float32Array(256).fill(LOWEST_DB);
    this._counted = new Float32Array(256).fill(LOWEST_DB);
    this._countedOf = 0;
    this._dark = matchMedia("(prefers-color-scheme: dark)");
    this._dark.addEventListener("change", () => this._readColours());
    this._readColours();
    new ResizeObserver(() => this._resize()).observe(canvas);
    this._resize();
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
    const narrow = box.width < 560;
    this._left = narrow ? 40 : 58;
    this._right = box.width - (narrow ? 14 : 24);
    this._top = this._isSecond ? 10 : 26;
    this._floor = Math.round(box.height * (this._isSecond ? 0.62 : 0.6));
    this._middle = Math.round(box.height * (this._isSecond ? 0.83 : 0.765));
    this._bottom = box.height - (this._isSecond ? 4 : 34);
    this._thick = narrow ? 9 : 11;
    this._narrow = narrow;
    this.dirty = true;
  }

  _x(position_m) { return this._left + (this._right - this._left) * (position_m / this._device.length_m); }

  _y(db) {
    const share = (Math.min(Math.max(db, LOWEST_DB), HIGHEST_DB) - LOWEST_DB) / (HIGHEST_DB - LOWEST_DB);
    return this._floor - share * (this._floor - this._top);
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
    const { made, madeCount } = this.picture, half = (FINGERTIP_M / 2 / this._device.length_m) * (this._right - this._left);
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
    const step_m = this._device.length_m / (levelCount - 1);
    c.beginPath();
    c.moveTo(this._left, this._y(counted[0]));
    for (let i = 1; i < levelCount; i++) {
      for (let k = 0; fresh && k < fingerCount; k++) {
        const { position_m, role, level_db, felt_db } = fingers[k];
        if (role === Role.NONE || position_m <= (i - 1) * step_m || position_m >= i * step_m) continue;
        c.lineTo(this._x(position_m), this._y(drive === 1 ? level_db : felt_db));
      }
      c.lineTo(this._x(i * step_m), this._y(counted[i]));
    }
  }
}
