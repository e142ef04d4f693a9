// The browser's side of tactable/page/page_messages.py: decodes pictures, encodes touches and switches, and reconnects.

import { parseScene, pointOf } from "./points.js";

export const VERSION = 9;
export const Kind = { SCENE: 1, PICTURE: 2, MOTION: 3, SOUND: 4, TOUCHES: 0x81, CHOICE: 0x82, LISTEN: 0x83, DEVICE: 0x84 };
export const Phase = { DOWN: 0, MOVE: 1, UP: 2, CANCEL: 3 };
export const NOTHING = -32768;
export const NO_ZONE = 255;
export const NO_NUMBER = 0xffffffff;
const MOST_TOUCHES = 64;
const MOST_BYTES = 65536;
const MOST_LEVELS = 4096;
const FIRST_BACK_OFF_MS = 250;
const LONGEST_BACK_OFF_MS = 4000;
const ENDED = 1012; // how a server closes that ends in order
const FATAL = new Set([1003, 1007, 4001]);

// One picture object, which every message fills.
export function makePicture() {
  return {
    time_s: 0, counters: [0, 0, 0, 0, 0, 0], command: 0, age_s: 0, wanted_db: 0, last_ns: [], median_ns: [], latencies: 0, drive: 0,
    isLoaded: true, isPlaying: false, isLate: false, hasPaper: false, isMixed: false, fingerCount: 0, fingers: [],
    // The fingers that the last command was made for. `called`: the number that each had, which it keeps when it has left.
    madeCount: 0, made: [], channelCount: 0, frequency_hz: [], amplitude: [], phase_rad: [],
    levelCount: 0, rows: 1, levels: new Float32Array(MOST_LEVELS), counted: new Float32Array(MOST_LEVELS),
  };
}

// What of a picture is another for the second surface, which the paper's drives move; all else is the picture's own.
export function makePaper(picture) {
  const { fingers, made, levels, counted } = makePicture();
  return Object.assign(Object.create(picture), { fingers, made, levels, counted });
}

// A level of JSON in hundredths of a decibel.
function wordOf(level_db) { return level_db === null ? NOTHING : Math.round(100 * level_db); }

function fingerOf({ number, zone, role, position_m }) {
  return { number: number ?? NO_NUMBER, zone: zone ?? NO_ZONE, role, position_m: pointOf(position_m) };
}

export function decodePicture(view, picture, paper) {
  const start = 6 + view.getUint32(2, true), told = JSON.parse(new TextDecoder().decode(new Uint8Array(view.buffer, 6, start - 6)));
  const { time_s, counters, age_s, last_ns, median_ns, latencies, drive, rows, channels } = told;
  const before = told.command === picture.command ? picture.made : [];
  const fingers = told.fingers.map((finger) => ({ ...fingerOf(finger), level_db: finger.level_db, felt_db: finger.felt_db }));
  const made = told.made.map((finger, i) => ({
    ...fingerOf(finger), called: finger.number ?? before[i]?.called ?? NO_NUMBER,
    promised: wordOf(finger.promised_db), simulated: wordOf(finger.simulated_db), low: wordOf(finger.low_db), high: wordOf(finger.high_db),
  }));
  Object.assign(picture, {
    time_s, counters, command: told.command, age_s, wanted_db: told.wanted_db ?? Infinity, last_ns, median_ns, latencies, drive, rows,
    isLoaded: told.is_loaded, isPlaying: told.is_playing, isLate: told.is_late, isMixed: told.is_mixed, hasPaper: told.paper !== null,
    fingers, fingerCount: fingers.length, made, madeCount: made.length, channelCount: channels.length,
    frequency_hz: channels.map((each) => each.frequency_hz), amplitude: channels.map((each) => each.amplitude),
    phase_rad: channels.map((each) => each.phase_rad),
  });
  const fields = [picture.levels, picture.counted, ...(told.paper ? [paper.levels, paper.counted] : [])];
  picture.levelCount = (view.byteLength - start) / 2 / fields.length;
  let at = start;
  for (const levels of fields) for (let i = 0; i < picture.levelCount; i++, at += 2) levels[i] = view.getInt16(at, true) / 100;
  if (!told.paper) return;
  paper.fingers = fingers.map((finger, i) => ({ ...finger, level_db: told.paper.fingers_db[i][0], felt_db: told.paper.fingers_db[i][1] }));
  paper.made = made.map((finger, i) => ({ ...finger, simulated: wordOf(told.paper.simulated_db[i]) }));
}

// The same moment of every surface, ours first, in one scale. A step has the points, row by row, then the fingers that
// the command was made for.
export function decodeMotions(view) {
  const along = view.getUint8(2), rows = view.getUint8(3), columns = along * rows + view.getUint8(4);
  const steps = view.getUint16(6, true), motions = [];
  for (let at = 20; at < view.byteLength; ) {
    const words = new Int16Array(columns * steps);
    for (let i = 0; i < words.length; i++, at += 2) words[i] = view.getInt16(at, true);
    motions.push({
      along, rows, columns, steps, words, isClick: Boolean(view.getUint8(5)), command: view.getUint32(8, true),
      step_s: view.getFloat32(12, true), scale: view.getFloat32(16, true),
    });
  }
  return motions;
}

export function decodeSound(view) {
  const samples = new Float32Array((view.byteLength - 10) / 2);
  for (let i = 0, at = 10; i < samples.length; i++, at += 2) samples[i] = view.getInt16(at, true) / 32767;
  return { finger: view.getUint32(2, true), rate_hz: view.getUint32(6, true), samples };
}

// The connection. `on` has scene(object), picture(), motions(list), sound(object), state(text, isUp, hasEnded).
export class Wire {
  constructor(on) {
    this.picture = makePicture();
    this.paper = makePaper(this.picture);
    this.received = 0;
    this.connections = 0;
    this._on = on;
    this._socket = null;
    this._backOff_ms = FIRST_BACK_OFF_MS;
    this._hasEnded = false;
    this._touches = new DataView(new ArrayBuffer(2 + 13 * MOST_TOUCHES));
    this._touches.setUint8(0, VERSION);
    this._touches.setUint8(1, Kind.TOUCHES);
    this._count = 0;
  }

  get isUp() { return this._socket !== null && this._socket.readyState === WebSocket.OPEN; }

  connect() {
    const address = new URL("socket", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    this._socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => this._take(event.data);
    socket.onopen = () => { this.connections++; this._hasEnded = false; this._on.state("connected", true); };
    socket.onclose = (event) => this._lost(event);
  }

  _lost(event) {
    this._socket = null;
    this._count = 0;
    if (FATAL.has(event.code)) {
      this._on.state(`closed: ${event.reason || event.code}; load the page again`, false);
      return;
    }
    // What has ended is looked for all the same: it may be started again at this address.
    this._hasEnded ||= event.code === ENDED;
    this._on.state("reconnecting", false, this._hasEnded);
    setTimeout(() => this.connect(), this._backOff_ms * (0.75 + 0.5 * Math.random()));
    this._backOff_ms = Math.min(2 * this._backOff_ms, LONGEST_BACK_OFF_MS);
  }

  _take(data) {
    const view = new DataView(data);
    this._backOff_ms = FIRST_BACK_OFF_MS;
    if (view.getUint8(0) !== VERSION) {
      this._on.state("the server speaks another version; load the page again", false);
      return;
    }
    this.received++;
    switch (view.getUint8(1)) {
      case Kind.SCENE:
        this._on.scene(parseScene(new TextDecoder().decode(new Uint8Array(data, 2))));
        break;
      case Kind.PICTURE:
        decodePicture(view, this.picture, this.paper);
        this._on.picture();
        break;
      case Kind.MOTION:
        this._on.motions(decodeMotions(view));
        break;
      case Kind.SOUND:
        this._on.sound(decodeSound(view));
        break;
    }
  }

  // Collect a touch until `flush`.
  touch(finger, phase, x, y) {
    const at = 2 + 13 * this._count++;
    this._touches.setUint32(at, finger, true);
    this._touches.setUint8(at + 4, phase);
    this._touches.setFloat32(at + 5, x, true);
    this._touches.setFloat32(at + 9, y, true);
    if (this._count === MOST_TOUCHES) this.flush();
  }

  flush() {
    if (this._count && this.isUp) this._socket.send(new Uint8Array(this._touches.buffer, 0, 2 + 13 * this._count));
    this._count = 0;
  }

  choose(switches) { this._sendObject(Kind.CHOICE, switches); }

  // Hand over a device file, so that it plays; whether it is short enough to be one.
  drop(name, text) { return this._sendObject(Kind.DEVICE, { name, text }); }

  _sendObject(kind, object) {
    const text = new TextEncoder().encode(JSON.stringify(object));
    if (!this.isUp || text.length > MOST_BYTES) return false;
    const message = new Uint8Array(2 + text.length);
    message.set([VERSION, kind]);
    message.set(text, 2);
    this._socket.send(message);
    return true;
  }

  listen(finger) {
    if (!this.isUp) return;
    const message = new DataView(new ArrayBuffer(6));
    message.setUint8(0, VERSION);
    message.setUint8(1, Kind.LISTEN);
    message.setUint32(2, finger, true);
    this._socket.send(message);
  }
}
