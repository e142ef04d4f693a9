// The device that plays: device files that are dropped or chosen, and actuators that are dragged to see what if.

import { byId } from "./panel.js";
import { plainOf, pointAt, pointText } from "./points.js";

const GRAB_PX = 22;
const STEP_M = 0.0005;

export class DeviceHand {
  constructor(wire) {
    this.scene = null;
    this.isDragging = false;
    this._wire = wire;
    this.drawings = []; // They draw the actuators; the pointer takes them from the first.
    this._places = null; // of the actuators while one is dragged, and until they play
    this._dragged = -1;
    this._sent = "";
    for (const name of ["dragenter", "dragover", "dragleave", "drop"]) window.addEventListener(name, (event) => this._drag(event));
    byId("open-device").addEventListener("click", () => byId("device-file").click());
    byId("device-file").addEventListener("change", (event) => { this._take(event.target.files[0]); event.target.value = ""; });
    byId("reset-actuators").addEventListener("click", () => { this._places = null; wire.choose({ actuators_m: [] }); });
    byId("save-device").addEventListener("click", () => this._save());
  }

  get _canDrop() { return this.scene?.mode === "demo"; }

  _drag(event) {
    if (!this._canDrop || ![...event.dataTransfer.types].includes("Files")) return;
    event.preventDefault();
    document.body.toggleAttribute("data-drop", event.type === "dragenter" || event.type === "dragover");
    if (event.type === "drop") this._take(event.dataTransfer.files[0]);
  }

  async _take(file) {
    if (!file) return;
    const isShort = file.size <= 60000 && this._wire.drop(file.name, await file.text());
    if (!isShort) this.onTrouble(`${file.name} has ${file.size} bytes: a device file has some thousands`);
  }

  onTrouble() {}

  // The actuator under a place of the canvas in CSS pixels; -1 for none.
  at(x, y) {
    return this._canDrop ? this.drawings[0]?.actuatorAt(x, y, GRAB_PX) ?? -1 : -1;
  }

  grab(index) {
    const device = this.scene.device;
    this._dragged = index;
    this._places ??= device.actuators.map((each) => each.position_m);
    this.isDragging = true;
  }

  // Move the grabbed actuator to a point as fractions of the surface; the others stay.
  move(share) {
    const { x, y } = pointAt(share, this.scene.device.corner_m), rounded = (at) => Math.round(at / STEP_M) * STEP_M;
    this._places[this._dragged] = { x: rounded(x), y: rounded(y) };
    this._show();
    this._send();
  }

  release() {
    this.isDragging = false;
    this._dragged = -1;
    this._send();
  }

  // A place is sent once the one before plays, so that a slow machine is not flooded; the last one always is.
  _send() {
    if (!this._places) return;
    const { choice, plays, trouble } = this.scene, asked = JSON.stringify(this._places);
    const isIdle = trouble || JSON.stringify(plays?.actuators_m) === JSON.stringify(choice.actuators_m);
    if (asked === this._sent || (this.isDragging && !isIdle)) return;
    this._sent = asked;
    this._wire.choose({ actuators_m: this._places.map(plainOf) });
  }

  // What the server says of the device has come.
  update(scene) {
    const isOther = this.scene !== null && scene.choice.device !== this.scene.choice.device;
    this.scene = scene;
    const plays = JSON.stringify(scene.plays?.actuators_m) === this._sent;
    if (!this.isDragging && (isOther || plays || scene.trouble || !scene.choice.actuators_m?.length)) {
      this._places = null;
      this._sent = "";
    } else this._send();
    this._show();
    this._say(scene);
  }

  _show() {
    for (const drawing of this.drawings) drawing.places = this._places;
  }

  _say({ what_if, clicks }) {
    byId("what-if").hidden = !what_if;
    if (!what_if) return;
    const plays = clicks ? "Clicks are solved for these places as fingers ask for them."
      : "Steady drives play; clicks follow once their kernels are compiled.";
    const moved = what_if.moved.map(({ name, position_m, file_m }) => `${name} at ${pointText(position_m, 1)} (device file: ${pointText(file_m, 1)})`);
    byId("what-if-text").textContent = `What if: actuator ${moved.join(", ")}. ${plays}`;
  }

  _save() {
    const { what_if, device } = this.scene, link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([what_if.text], { type: "application/toml" }));
    link.download = `${device.name}-moved.toml`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
}
