// The browser's side of tactable/page/page_messages.py: decodes pictures, encodes touches and switches, and reconnects.

import { parseScene } from "./points.js";

export const VERSION = 8;
export const Kind = { SCENE: 1, PICTURE: 2, MOTION: 3, SOUND: 4, TOUCHES: 0x81, CHOICE: 0x82, LISTEN: 0x83, DEVICE: 0x84 };
export const Phase = { DOWN: 0, MOVE: 1, UP: 2, CANCEL: 3 };
export const NOTHING = -32768;
export const NO_ZONE = 255;
export const NO_NUMBER = 0xffffffff;
const MOST_TOUCHES = 64;
const MOST_BYTES = 65536;
const MOST_FINGERS = 16;
const MOST_LEVELS = 4096;
const STAGES = 5;
const FIRST_BACK_OFF_MS = 250;
const LONGEST_BACK_OFF_MS = 4000;
const ENDED = 1012; // how a server closes that ends in order
const FATAL = new Set([1003, 1007, 4001]);

// One picture object, which every message fills: a page that runs for hours makes no garbage.
export function makePicture() {
  return {
    time_s: 0, counters: new Uint32Array(6), command: 0, age_s: 0, wanted_db: 0,
    last_ns: new Uint32Array(STAGES), median_ns: new Uint32Array(STAGES), latencies: 0, drive: 0,
    isLoaded: true, isPlaying: false, isLate: false, hasPaper: false, isMixed: false, fingerCount: 0,
    fingers: Array.from({ length: MOST_FINGERS }, () =>
      ({ number: 0, zone: NO_ZONE, role: 0, position_m: { x: 0, y: NaN }, level_db: -60, felt_db: -60 })),
    // The fingers that the last command was made for. `called`: the number that each had, which it keeps when it has left.
    madeCount: 0,
    made: Array.from({ length: MOST_FINGERS }, () =>
      ({ number: NO_NUMBER, called: NO_NUMBER, zone: NO_ZONE, role: 0, position_m: { x: 0, y: NaN }, promised: NOTHING, simulated: NOTHING, low: NOTHING, high: NOTHING })),
    channelCount: 0, frequency_hz: new Float32Array(64), amplitude: new Float32Array(64), phase_rad: new Float32Array(64),
    levelCount: 0, rows: 1, levels: new Float32Array(MOST_LEVELS), counted: new Float32Array(MOST_LEVELS),
  };
}

// What of a picture is another for the second surface, which the paper's drives move; all else is the picture's own.
export function makePaper(picture) {
  const { fingers, made } = makePicture();
  return Object.assign(Object.create(picture), { fingers, made, levels: new Float32Array(MOST_LEVELS), counted: new Float32Array(MOST_LEVELS) });
}

function readPoint(view, at, point) {
  point.x = view.getFloat32(at, true);
  point.y = view.getFloat32(at + 4, true);
}

export function decodePicture(view, picture, paper) {
  let at = 2;
  picture.time_s = view.getFloat64(at, true); at += 8;
  for (let i = 0; i < 6; i++, at += 4) picture.counters[i] = view.getUint32(at, true);
  const before = picture.command;
  picture.command = view.getUint32(at, true); at += 4;
  picture.age_s = view.getFloat32(at, true); at += 4;
  picture.wanted_db = view.getFloat32(at, true); at += 4;
  for (let i = 0; i < STAGES; i++, at += 4) picture.last_ns[i] = view.getUint32(at, true);
  for (let i = 0; i < STAGES; i++, at += 4) picture.median_ns[i] = view.getUint32(at, true);
  picture.latencies = view.getUint32(at, true); at += 4;
  picture.drive = view.getUint8(at++);
  const flags = view.getUint8(at++);
  picture.isLoaded = Boolean(flags & 1);
  picture.isPlaying = Boolean(flags & 2);
  picture.isLate = Boolean(flags & 4);
  picture.hasPaper = Boolean(flags & 8);
  picture.isMixed = Boolean(flags & 16);
  picture.fingerCount = Math.min(view.getUint8(at++), MOST_FINGERS);
  picture.madeCount = Math.min(view.getUint8(at++), MOST_FINGERS);
  picture.channelCount = view.getUint8(at++);
  const along = view.getUint8(at++);
  picture.rows = view.getUint8(at++);
  picture.levelCount = along * picture.rows;
  for (let i = 0; i < picture.fingerCount; i++, at += 22) {
    const finger = picture.fingers[i];
    finger.number = view.getUint32(at, true);
    finger.zone = view.getUint8(at + 4);
    finger.role = view.getUint8(at + 5);
    readPoint(view, at + 6, finger.position_m);
    finger.level_db = view.getFloat32(at + 14, true);
    finger.felt_db = view.getFloat32(at + 18, true);
  }
  for (let i = 0; i < picture.madeCount; i++, at += 22) {
    const finger = picture.made[i];
    finger.number = view.getUint32(at, true);
    if (finger.number !== NO_NUMBER || picture.command !== before) finger.called = finger.number;
    finger.zone = view.getUint8(at + 4);
    finger.role = view.getUint8(at + 5);
    readPoint(view, at + 6, finger.position_m);
    finger.promised = view.getInt16(at + 14, true);
    finger.simulated = view.getInt16(at + 16, true);
    finger.low = view.getInt16(at + 18, true);
    finger.high = view.getInt16(at + 20, true);
  }
  for (let i = 0; i < picture.channelCount; i++, at += 12) {
    picture.frequency_hz[i] = view.getFloat32(at, true);
    picture.amplitude[i] = view.getFloat32(at + 4, true);
    picture.phase_rad[i] = view.getFloat32(at + 8, true);
  }
  for (let i = 0; i < picture.levelCount; i++, at += 2) picture.levels[i] = view.getInt16(at, true) / 100;
  for (let i = 0; i < picture.levelCount; i++, at += 2) picture.counted[i] = view.getInt16(at, true) / 100;
  if (picture.hasPaper) decodePaper(view, at, picture, paper);
}

function decodePaper(view, at, picture, paper) {
  for (let i = 0; i < picture.levelCount; i++, at += 2) paper.levels[i] = view.getInt16(at, true) / 100;
  for (let i = 0; i < picture.levelCount; i++, at += 2) paper.counted[i] = view.getInt16(at, true) / 100;
  for (let i = 0; i < picture.fingerCount; i++, at += 4) {
    const { number, zone, role, position_m } = picture.fingers[i], finger = paper.fingers[i];
    Object.assign(finger, { number, zone, role, position_m });
    finger.level_db = view.getInt16(at, true) / 100;
    finger.felt_db = view.getInt16(at + 2, true) / 100;
  }
  for (let i = 0; i < picture.madeCount; i++, at += 2) {
    const { number, called, zone, role, position_m } = picture.made[i];
    Object.assign(paper.made[i], { number, called, zone, role, position_m, simulated: view.getInt16(at, true) });
  }
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
