// Turns mouse, pen, touch and keys into fingers on the surface; keeps fingers that stay; plays a short tour.

import { distanceOf } from "./points.js";
import { Phase } from "./wire.js";

const REPEAT_MS = 200; // The server releases a finger that is not mentioned for 1 s.
const GRAB_PX = 26;
const STILL_PX = 4;
const TOLD_S = 0.3; // A click has rung down by then.
const PATIENCE_MS = 5000;

const passing = (time_ms) => new Promise((done) => setTimeout(done, time_ms));

export class Fingers {
  // `place` gives {left, top, width, height} of the surface in the canvas, in CSS pixels; `hand` takes actuators.
  constructor(canvas, wire, place, hand) {
    this._hand = hand;
    this._handPointer = null;
    this.down = new Map(); // by our number: {x, y, kept, moved}; x and y are fractions of the surface
    this.keeps = false;
    this.surface = "bar"; // what it is called
    this.onUse = () => {};
    this._canvas = canvas;
    this._wire = wire;
    this._place = place;
    this._pointers = new Map(); // browser's pointer to our number
    this._keys = new Map();
    this._next = 1;
    // Fingers that come down together are told one by one, in one task: they are sent after it, as one frame.
    this._soon = new MessageChannel();
    this._soon.port1.onmessage = () => this._sent();
    this._tour = null;
    this.says = null; // What the tour says in place of the outcome.
    for (const name of ["pointerdown", "pointermove", "pointerup", "pointercancel"])
      canvas.addEventListener(name, (event) => this[`_${name}`](event));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    window.addEventListener("keydown", (event) => this._keydown(event));
    window.addEventListener("keyup", (event) => this._keyup(event));
    window.addEventListener("blur", () => this._releaseKeys());
    setInterval(() => this._repeat(), REPEAT_MS);
  }

  _at(event) {
    const { left, top, width, height } = this._place(), box = this._canvas.getBoundingClientRect();
    const x = (event.clientX - box.left - left) / width, y = 1 - (event.clientY - box.top - top) / height;
    return { x: Math.min(Math.max(x, 0), 1), y: Math.min(Math.max(y, 0), 1) };
  }

  _pointerdown(event) {
    if (event.pointerType === "mouse" && event.button !== 0) return;
    event.preventDefault();
    this._canvas.setPointerCapture(event.pointerId);
    this.stopTour();
    const box = this._canvas.getBoundingClientRect(), actuator = this._hand.at(event.clientX - box.left, event.clientY - box.top);
    if (actuator >= 0 && this._handPointer === null) {
      this._handPointer = event.pointerId;
      this._hand.grab(actuator);
      return;
    }
    const at = this._at(event);
    this._pointers.set(event.pointerId, this._keptNear(at) ?? this._press(at, this.keeps || event.shiftKey));
    this._soon.port2.postMessage(null);
  }

  _sent() {
    this._wire.flush();
    this.onUse();
  }

  // How far apart two points are on the screen.
  _apart(one, other) {
    const { width, height } = this._place();
    return distanceOf({ x: one.x * width, y: one.y * height }, { x: other.x * width, y: other.y * height });
  }

  _keptNear(at) {
    for (const [number, finger] of this.down) {
      if (finger.kept && this._apart(finger, at) < GRAB_PX) {
        finger.grabbed = { x: finger.x, y: finger.y };
        finger.moved = false;
        return number;
      }
    }
    return undefined;
  }

  _pointermove(event) {
    if (event.pointerId === this._handPointer) {
      this._hand.move(this._at(event));
      return;
    }
    if (!this._pointers.size && event.pointerType === "mouse") this._pointAt(event);
    const number = this._pointers.get(event.pointerId);
    if (number === undefined) return;
    const events = event.getCoalescedEvents ? event.getCoalescedEvents() : [];
    for (const each of events.length ? events : [event]) this._move(number, this._at(each));
    this._wire.flush();
  }

  // An actuator under the mouse says that it can be taken.
  _pointAt(event) {
    const box = this._canvas.getBoundingClientRect();
    this._canvas.style.cursor = this._hand.at(event.clientX - box.left, event.clientY - box.top) >= 0 ? "move" : "";
  }

  _letGo(event) {
    if (event.pointerId !== this._handPointer) return false;
    this._handPointer = null;
    this._hand.release();
    return true;
  }

  _pointerup(event) {
    if (this._letGo(event)) return;
    const number = this._takeOut(this._pointers, event.pointerId), finger = this.down.get(number);
    if (!finger) return;
    // A kept finger is lifted by a tap on it.
    const stays = finger.kept && (finger.grabbed === undefined || finger.moved);
    if (stays) finger.grabbed = { x: finger.x, y: finger.y };
    else this._release(number, Phase.UP);
    this._sent();
  }

  _pointercancel(event) {
    if (this._letGo(event)) return;
    this._release(this._takeOut(this._pointers, event.pointerId), Phase.CANCEL);
    this._wire.flush();
  }

  _takeOut(map, key) {
    const number = map.get(key);
    map.delete(key);
    return number;
  }

  _press({ x, y }, kept) {
    const number = this._next++;
    this.down.set(number, { x, y, kept, moved: false, grabbed: undefined });
    this._tell(number, Phase.DOWN);
    return number;
  }

  _move(number, { x, y }) {
    const finger = this.down.get(number);
    if (!finger) return;
    if (finger.grabbed !== undefined && this._apart({ x, y }, finger.grabbed) > STILL_PX) finger.moved = true;
    finger.x = x;
    finger.y = y;
    this._tell(number, Phase.MOVE);
  }

  // On a bar, where y is NaN, the middle is as good as any.
  _tell(number, phase) {
    const { x, y } = this.down.get(number);
    this._wire.touch(number, phase, x, Number.isNaN(y) ? 0.5 : y);
  }

  _release(number, phase) {
    const finger = this.down.get(number);
    if (!finger) return;
    this._tell(number, phase);
    this.down.delete(number);
  }

  _repeat() {
    for (const number of this.down.keys()) this._tell(number, Phase.MOVE);
    this._wire.flush();
  }

  liftAll() {
    this.stopTour();
    for (const number of [...this.down.keys()]) this._release(number, Phase.UP);
    this._pointers.clear();
    this._keys.clear();
    this._sent();
  }

  get anyKept() { return [...this.down.values()].some((finger) => finger.kept); }

  // Where the fingers that stay are, in the order in which they came down.
  get staying() { return [...this.down.values()].filter((finger) => finger.kept).map(({ x, y }) => ({ x, y })); }

  // Put fingers down that stay, one after another, so that each is a touch beside those before it.
  place(places) {
    this.stopTour();
    this._lead(places.map((at, i) => [i ? 1400 : 0, () => this._press(at, true)]));
  }

  // Keys 1 to 9 put a finger on the middle of that zone while the key is down.
  set zones(middles) { this._middles = middles; }

  get zones() { return this._middles; }

  _keydown(event) {
    if (event.repeat || event.ctrlKey || event.metaKey || event.altKey || !/^Digit[1-9]$/.test(event.code)) return;
    if (event.target instanceof HTMLElement && event.target.closest("select, input:not([type=checkbox]):not([type=radio])")) return;
    const middle = this._middles?.[Number(event.code.at(-1)) - 1];
    if (middle === undefined || this._keys.has(event.code)) return;
    this.stopTour();
    this._keys.set(event.code, this._press(middle, false));
    this._sent();
  }

  _keyup(event) {
    if (!this._keys.has(event.code)) return;
    this._release(this._takeOut(this._keys, event.code), Phase.UP);
    this._sent();
  }

  _releaseKeys() {
    for (const number of this._keys.values()) this._release(number, Phase.UP);
    this._keys.clear();
    this._wire.flush();
  }

  // The tour: one finger rests while another taps, so that both levels show.
  startTour(resting, tapping, taps = 4) {
    this.liftAll();
    let rests, tapped;
    const tap = () => { tapped = this._press(tapping, false); };
    const lift = () => this._release(tapped, Phase.UP);
    this._lead([
      [0, () => { this.says = "Finger 1 comes first, and rests."; rests = this._press(resting, false); }],
      [1300, () => { this.says = "Finger 2 taps: only finger 2 is to feel it."; }],
      [100, tap],
      [600, () => { this.says = null; }],
      [500, lift],
      ...Array.from({ length: taps - 1 }, () => [[1500, tap], [1100, lift]]).flat(),
      [1900, () => { this._release(rests, Phase.UP); this.says = `Your turn: touch the ${this.surface}.`; }],
    ]);
  }

  // Take steps one after another, each so many milliseconds after the one before, and no sooner than the last touch was
  // told: on a late machine two clicks would overlap.
  async _lead(steps) {
    const tour = (this._tour = {}), { picture } = this._wire;
    let before = null;
    for (const [after_ms, act] of steps) {
      const end_ms = performance.now() + after_ms + PATIENCE_MS, isTold = () => picture.command !== before && picture.age_s > TOLD_S;
      await passing(after_ms);
      while (this._tour === tour && before !== null && !isTold() && performance.now() < end_ms) await passing(REPEAT_MS);
      if (this._tour !== tour) return;
      const fingers = this.down.size;
      act();
      if (this.down.size > fingers) before = picture.command;
      this._sent();
    }
    this._tour = null;
  }

  get isTouring() { return this._tour !== null; }

  stopTour() {
    this.says = null;
    if (!this.isTouring) return;
    this._tour = null;
    for (const [number, finger] of [...this.down]) if (!finger.kept) this._release(number, Phase.UP);
  }
}
