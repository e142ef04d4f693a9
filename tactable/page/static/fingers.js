// Pointers and keys to fingers on the bar: mouse, pen and real multi-touch, coalesced; fingers that stay; a short tour.

import { Phase } from "./wire.js";

const REPEAT_MS = 40; // The server takes a finger that is silent for 120 ms for gone.
const GRAB_PX = 26;
const STILL_PX = 4;
const MIDDLE = 0.5;

export class Fingers {
  // `place` gives {left, width, height} of the bar in the canvas, in CSS pixels.
  constructor(canvas, wire, place) {
    this.down = new Map(); // by our number: {x, y, kept, moved}
    this.keeps = false;
    this.onUse = () => {};
    this._canvas = canvas;
    this._wire = wire;
    this._place = place;
    this._pointers = new Map(); // browser's pointer to our number
    this._keys = new Map();
    this._next = 1;
    this._tour = [];
    for (const name of ["pointerdown", "pointermove", "pointerup", "pointercancel"])
      canvas.addEventListener(name, (event) => this[`_${name}`](event));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    window.addEventListener("keydown", (event) => this._keydown(event));
    window.addEventListener("keyup", (event) => this._keyup(event));
    window.addEventListener("blur", () => this._releaseKeys());
    setInterval(() => this._repeat(), REPEAT_MS);
  }

  _at(event) {
    const { left, width, height } = this._place(), box = this._canvas.getBoundingClientRect();
    return [
      Math.min(Math.max((event.clientX - box.left - left) / width, 0), 1),
      Math.min(Math.max((event.clientY - box.top) / height, 0), 1),
    ];
  }

  _pointerdown(event) {
    if (event.pointerType === "mouse" && event.button !== 0) return;
    event.preventDefault();
    this._canvas.setPointerCapture(event.pointerId);
    this.stopTour();
    const [x, y] = this._at(event);
    const near = this._keptNear(x);
    this._pointers.set(event.pointerId, near ?? this._press(x, y, this.keeps || event.shiftKey));
    this._wire.flush();
    this.onUse();
  }

  _keptNear(x) {
    const reach = GRAB_PX / this._place().width;
    for (const [number, finger] of this.down) {
      if (finger.kept && Math.abs(finger.x - x) < reach) {
        finger.grabbed = finger.x;
        finger.moved = false;
        return number;
      }
    }
    return undefined;
  }

  _pointermove(event) {
    const number = this._pointers.get(event.pointerId);
    if (number === undefined) return;
    const events = event.getCoalescedEvents ? event.getCoalescedEvents() : [];
    for (const each of events.length ? events : [event]) this._move(number, ...this._at(each));
    this._wire.flush();
  }

  _pointerup(event) {
    const number = this._pointers.get(event.pointerId);
    if (number === undefined) return;
    this._pointers.delete(event.pointerId);
    const finger = this.down.get(number);
    if (!finger) return;
    // A finger that stays is lifted by a tap on it.
    const stays = finger.kept && (finger.grabbed === undefined || finger.moved);
    if (stays) finger.grabbed = finger.x;
    else this._release(number, Phase.UP);
    this._wire.flush();
    this.onUse();
  }

  _pointercancel(event) {
    const number = this._pointers.get(event.pointerId);
    if (number === undefined) return;
    this._pointers.delete(event.pointerId);
    this._release(number, Phase.CANCEL);
    this._wire.flush();
  }

  _press(x, y, kept) {
    const number = this._next++;
    this.down.set(number, { x, y, kept, moved: false, grabbed: undefined });
    this._wire.touch(number, Phase.DOWN, x, y);
    return number;
  }

  _move(number, x, y) {
    const finger = this.down.get(number);
    if (!finger) return;
    if (finger.grabbed !== undefined && Math.abs(x - finger.grabbed) * this._place().width > STILL_PX) finger.moved = true;
    finger.x = x;
    finger.y = y;
    this._wire.touch(number, Phase.MOVE, x, y);
  }

  _release(number, phase) {
    const finger = this.down.get(number);
    if (!finger) return;
    this.down.delete(number);
    this._wire.touch(number, phase, finger.x, finger.y);
  }

  _repeat() {
    for (const [number, finger] of this.down) this._wire.touch(number, Phase.MOVE, finger.x, finger.y);
    this._wire.flush();
  }

  liftAll() {
    this.stopTour();
    for (const number of [...this.down.keys()]) this._release(number, Phase.UP);
    this._pointers.clear();
    this._keys.clear();
    this._wire.flush();
    this.onUse();
  }

  get anyKept() {
    for (const finger of this.down.values()) if (finger.kept) return true;
    return false;
  }

  // Keys 1 to 9: a finger in the middle of that zone while the key is down.
  set zones(middles) { this._middles = middles; }

  _keydown(event) {
    if (event.repeat || event.ctrlKey || event.metaKey || event.altKey || !/^Digit[1-9]$/.test(event.code)) return;
    if (event.target instanceof HTMLElement && event.target.closest("select, input:not([type=checkbox]):not([type=radio])")) return;
    const middle = this._middles?.[Number(event.code.at(-1)) - 1];
    if (middle === undefined || this._keys.has(event.code)) return;
    this.stopTour();
    this._keys.set(event.code, this._press(middle, MIDDLE, false));
    this._wire.flush();
    this.onUse();
  }

  _keyup(event) {
    const number = this._keys.get(event.code);
    if (number === undefined) return;
    this._keys.delete(event.code);
    this._release(number, Phase.UP);
    this._wire.flush();
    this.onUse();
  }

  _releaseKeys() {
    for (const number of this._keys.values()) this._release(number, Phase.UP);
    this._keys.clear();
    this._wire.flush();
  }

  // One finger rests, another taps: what the first one feels of it, and what the second.
  startTour(resting, tapping, taps = 4) {
    this.liftAll();
    let rests, taps_ = null;
    const steps = [[0, () => { rests = this._press(resting, MIDDLE, false); }]];
    for (let i = 0; i < taps; i++) {
      steps.push([1400 + 2600 * i, () => { taps_ = this._press(tapping, MIDDLE, false); }]);
      steps.push([2500 + 2600 * i, () => { this._release(taps_, Phase.UP); }]);
    }
    steps.push([1800 + 2600 * taps, () => { this._release(rests, Phase.UP); this._tour = []; }]);
    this._tour = steps.map(([after_ms, act]) => setTimeout(() => { act(); this._wire.flush(); this.onUse(); }, after_ms));
  }

  get isTouring() { return this._tour.length > 0; }

  stopTour() {
    if (!this._tour.length) return;
    this._tour.forEach(clearTimeout);
    this._tour = [];
    for (const [number, finger] of [...this.down]) if (!finger.kept) this._release(number, Phase.UP);
  }
}
