// Puts the outcome of the last command into one sentence, and draws what each finger got of a click over time.

import { NO_NUMBER, NOTHING } from "./wire.js";
import { Role, levelText } from "./bar.js";

const SETTLED_S = { 1: 0.25, 2: 0.06 }; // By kind of drive: from then on the levels say what was felt.
const COURSE_S = 0.06;

function nameOf(finger) {
  return finger.number === NO_NUMBER ? `the finger at ${(1000 * finger.position_m).toFixed(0)} mm` : `finger ${finger.number + 1}`;
}

function listed(names) {
  return names.length < 2 ? names.join("") : `${names.slice(0, -1).join(", ")} and ${names.at(-1)}`;
}

function sentence(text) { return text.charAt(0).toUpperCase() + text.slice(1); }

// The outcome of the last command in words, or null while it is not known yet.
export function outcomeOf(picture) {
  if (!picture.command || picture.age_s < SETTLED_S[picture.drive]) return null;
  if (picture.isLate) return "The machine was late: not judged.";
  const made = picture.made.slice(0, picture.madeCount).filter((finger) => finger.simulated !== NOTHING);
  const felt = made.filter((finger) => finger.role === Role.FELT), quiet = made.filter((finger) => finger.role === Role.QUIET);
  if (!felt.length) return null;
  const what = picture.drive === 2 ? "the click" : "the vibration", verb = felt.length > 1 ? "feel" : "feels";
  const names = listed(felt.map(nameOf)), weakest = Math.min(...felt.map((finger) => finger.simulated)) / 100;
  if (weakest < 0) return sentence(`${names} ${felt.length > 1 ? "do" : "does"} not feel ${what}.`);
  if (!quiet.length) return sentence(`${names} ${verb} ${what}, ${levelText(weakest)} above threshold.`);
  const strongest = Math.max(...quiet.map((finger) => finger.simulated)) / 100, apart = Math.round(weakest - strongest);
  const others = listed(quiet.map(nameOf)), rest = strongest < 0 ? `, which feel${quiet.length > 1 ? "" : "s"} nothing` : "";
  if (apart < 1) return sentence(`${names} ${verb} ${what} no more than ${others}.`);
  return sentence(`${names} ${verb} ${what} ${apart} dB more than ${others}${rest}.`);
}

export class Courses {
  // The acceleration under each finger that a click was made for, over its first 60 ms.
  constructor(canvas, picture) {
    this.canvas = canvas;
    this._picture = picture;
    this._courses = [];
  }

  // Take the motion of the last click; whether there is a course to show.
  take(motion, length_m) {
    if (!motion.isClick || motion.command !== this._picture.command) return this._courses.length > 0;
    const steps = Math.min(motion.steps, Math.round(COURSE_S / motion.step_s)), { made, madeCount } = this._picture;
    this._step_s = motion.step_s;
    this._courses = made.slice(0, madeCount).map((finger) => {
      const at = (finger.position_m / length_m) * (motion.points - 1), left = Math.min(Math.floor(at), motion.points - 2);
      const values = new Float32Array(steps);
      for (let i = 0; i < steps; i++) {
        const here = motion.words[i * motion.points + left], next = motion.words[i * motion.points + left + 1];
        values[i] = ((here + (next - here) * (at - left)) * motion.scale) / 32767;
      }
      return { name: sentence(nameOf(finger)), role: finger.role, values };
    });
    this.draw();
    return this._courses.length > 0;
  }

  draw() {
    const box = this.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    if (!box.width || !this._courses.length) return;
    this.canvas.width = Math.round(box.width * ratio);
    this.canvas.height = Math.round(box.height * ratio);
    const c = this.canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const font = getComputedStyle(document.body).fontFamily, left = 92, right = box.width - 14, row = (box.height - 20) / this._courses.length;
    c.scale(ratio, ratio);
    const greatest = Math.max(1e-6, ...this._courses.map(({ values }) => values.reduce((most, value) => Math.max(most, Math.abs(value)), 0)));
    c.font = `12px ${font}`;
    this._courses.forEach(({ name, role, values }, index) => {
      const middle = 4 + row * (index + 0.5), reach = 0.46 * row;
      c.strokeStyle = colour("line");
      c.lineWidth = 1;
      c.beginPath(); c.moveTo(left, middle); c.lineTo(right, middle); c.stroke();
      c.fillStyle = c.strokeStyle = colour(role === Role.FELT ? "felt" : "quiet");
      c.textAlign = "left";
      c.textBaseline = "middle";
      c.fillText(name, 4, middle - 7);
      const peak = values.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
      c.fillText(`${peak.toPrecision(2)} m/s²`, 4, middle + 8);
      c.lineWidth = 1.6;
      c.beginPath();
      for (let i = 0; i < values.length; i++) c.lineTo(left + ((right - left) * i * this._step_s) / COURSE_S, middle - (reach * values[i]) / greatest);
      c.stroke();
    });
    c.fillStyle = colour("muted");
    c.textBaseline = "alphabetic";
    c.textAlign = "center";
    for (let ms = 0; ms <= 60; ms += 20) {
      c.textAlign = ms === 60 ? "right" : "center";
      c.fillText(ms === 60 ? "60 ms" : `${ms}`, left + ((right - left) * ms) / 60, box.height - 3);
    }
  }
}
