// Puts the outcome of the last command into one sentence, and draws what each finger got of a click over time.

import { NO_NUMBER, NOTHING } from "./wire.js";
import { pointText } from "./points.js";
import { LOWEST_DB, Role, isSettled, levelText } from "./surface.js";

const COURSE_S = 0.06;
const MOST_NAMED = 3;

function nameOf(finger) {
  return finger.called === NO_NUMBER ? `the finger at ${pointText(finger.position_m)}`.replaceAll(" mm", "\u00a0mm") : `finger\u00a0${finger.called + 1}`;
}

// Names as they are said; of many fingers only the number.
function listed(fingers) {
  if (fingers.length > MOST_NAMED) return `${fingers.length} fingers`;
  const names = fingers.map(nameOf);
  return names.length < 2 ? names.join("") : `${names.slice(0, -1).join(", ")} and ${names.at(-1)}`;
}

function sentence(text) { return text.charAt(0).toUpperCase() + text.slice(1); }

// The weakest felt and the strongest quiet level of a bar, dB; without quiet fingers the latter is null.
function levelsOf(picture) {
  const made = picture.made.slice(0, picture.madeCount).filter((finger) => finger.simulated !== NOTHING);
  const felt = made.filter((finger) => finger.role === Role.FELT), quiet = made.filter((finger) => finger.role === Role.QUIET);
  if (!felt.length) return null;
  const weakest = Math.min(...felt.map((finger) => finger.simulated)) / 100;
  return { felt, quiet, weakest, strongest: quiet.length ? Math.max(...quiet.map((finger) => finger.simulated)) / 100 : null };
}

// How much more the felt fingers get than the quiet ones, dB, as the labels have the levels.
function apartText({ weakest, strongest }) {
  const least = strongest < LOWEST_DB ? "at least " : "";
  return `${least}${Math.round(weakest - Math.max(strongest, LOWEST_DB))} dB`.replace("-", "−");
}

// What the paper's drive does at the same time, after the words for ours.
function besides(paper) {
  const levels = paper.hasPaper ? levelsOf(paper) : null;
  if (!levels) return "";
  if (levels.weakest < 0) return "; the paper’s drive is not felt";
  if (levels.strongest === null) return `; the paper’s drive: ${levelText(levels.weakest)}`;
  return `; the paper’s drive: ${apartText(levels)}`;
}

// The outcome of the last command in words, or null while it is not known yet. `isTour`: its touches never overlap by
// themselves, and that of its resting finger alone, which comes again where a run begins anew, is no outcome.
export function outcomeOf(picture, paper, isTour) {
  if (!picture.command || !isSettled(picture) || (isTour && picture.madeCount < 2)) return null;
  if (picture.isLate || (picture.isMixed && isTour)) return "The machine was late: not judged.";
  if (picture.isMixed) return "Two clicks overlapped: touch one finger after the other to compare them.";
  const levels = levelsOf(picture);
  if (!levels) return null;
  const { felt, quiet, weakest, strongest } = levels;
  const what = picture.drive === 2 ? "the click" : "the vibration", verb = felt.length > 1 ? "feel" : "feels";
  const names = listed(felt);
  if (weakest < 0) return sentence(`${names} ${felt.length > 1 ? "do" : "does"} not feel ${what}${besides(paper)}.`);
  if (!quiet.length) return sentence(`${names} ${verb} ${what}, ${levelText(weakest)} above threshold${besides(paper)}.`);
  const others = listed(quiet);
  const rest = strongest < 0 ? `, which feel${quiet.length > 1 ? "" : "s"} nothing` : "";
  if (Math.round(weakest - strongest) < 1) return sentence(`${names} ${verb} ${what} no more than ${others}${besides(paper)}.`);
  return sentence(`${names} ${verb} ${what} ${apartText(levels)} more than ${others}${rest}${besides(paper)}.`);
}

// What sampled bars and fingers give of the last command, from 5th to 95th percentile, and whether this bar kept it;
// empty where it is not known. A felt finger may feel more than that, and a quiet one less. `spread`: of the device, in
// words that begin with its name.
export function promiseOf(picture, surface, spread) {
  const made = picture.made.slice(0, picture.madeCount);
  if (!picture.command || !isSettled(picture) || made.some(({ low }) => low === NOTHING) || !made.length) return "";
  const rangeOf = (fingers) => {
    const [low, high] = [Math.min(...fingers.map(({ low }) => low)), Math.max(...fingers.map(({ high }) => high))];
    return `${levelText(low / 100).replace(" dB", "")} to ${levelText(high / 100)}`;
  };
  const alike = [["those to feel", Role.FELT], ["those to rest", Role.QUIET]].map(([name, asked]) => [name, made.filter(({ role }) => role === asked)]);
  const named = made.length > MOST_NAMED ? alike.filter(([, fingers]) => fingers.length) : made.map((finger) => [nameOf(finger), [finger]]);
  const ranges = named.map(([name, fingers]) => `${name} ${rangeOf(fingers)}`);
  const judged = made.filter(({ simulated }) => simulated !== NOTHING), isJudged = judged.length && !picture.isLate && !picture.isMixed;
  const isKept = judged.every(({ role, simulated, low, high }) => (role === Role.FELT ? simulated >= low : simulated <= high));
  const verdict = isJudged ? (isKept ? ": kept" : `: not kept, as by one ${surface} in ten`) : "";
  return `Promised over sampled ${surface}s and fingers (${spread.split(":")[0]}), 5 to 95\u00a0%: ${ranges.join(", ")}${verdict}.`;
}

export class Courses {
  // The acceleration under each finger that a click was made for, over its first 60 ms.
  constructor(canvas, picture) {
    this.canvas = canvas;
    this._picture = picture;
    this._courses = [];
  }

  // Take the motion of the last click, and what the paper's drive did meanwhile; whether there is a course to show.
  take(motion, papers) {
    if (!motion.isClick || motion.command !== this._picture.command) return this._courses.length > 0;
    const steps = Math.min(motion.steps, Math.round(COURSE_S / motion.step_s)), { made, madeCount } = this._picture;
    this._step_s = motion.step_s;
    const courseOf = ({ along, rows, columns, scale, words }, index) =>
      Float32Array.from({ length: steps }, (_, i) => (words[i * columns + along * rows + index] * scale) / 32767);
    this._courses = made.slice(0, madeCount).map((finger, index) => ({
      name: sentence(nameOf(finger)), role: finger.role, values: courseOf(motion, index),
      beside: papers ? courseOf(papers, index) : new Float32Array(0),
    }));
    this.draw();
    return this._courses.length > 0;
  }

  get isDrawn() { return this._courses.length > 0; }

  // Forget the courses: they are another device's.
  clear() {
    this._courses = [];
    this.canvas.getContext("2d").clearRect(0, 0, this.canvas.width, this.canvas.height);
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
    const peakOf = (values) => values.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
    const greatest = Math.max(1e-6, ...this._courses.flatMap(({ values, beside }) => [peakOf(values), peakOf(beside)]));
    c.font = `12px ${font}`;
    this._courses.forEach(({ name, role, values, beside }, index) => {
      const middle = 4 + row * (index + 0.5), reach = 0.46 * row;
      c.strokeStyle = colour("line");
      c.lineWidth = 1;
      c.beginPath(); c.moveTo(left, middle); c.lineTo(right, middle); c.stroke();
      c.fillStyle = c.strokeStyle = colour(role === Role.FELT ? "felt" : "quiet");
      c.textAlign = "left";
      c.textBaseline = "middle";
      c.fillText(name, 4, middle - 7);
      c.fillText(`${peakOf(values).toPrecision(2)} m/s²`, 4, middle + 8);
      const draw = (course) => {
        c.beginPath();
        for (let i = 0; i < course.length; i++) c.lineTo(left + ((right - left) * i * this._step_s) / COURSE_S, middle - (reach * course[i]) / greatest);
        c.stroke();
      };
      c.lineWidth = 1.6;
      draw(values);
      c.lineWidth = 1;
      c.strokeStyle = colour("muted");
      draw(beside);
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
