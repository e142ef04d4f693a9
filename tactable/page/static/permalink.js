// The part of the address after "#": what is chosen, and the fingers that stay, so that a link shows the same scene.

import { plainOf, pointOf } from "./points.js";

const NAMES = { device: "device", source: "source", rules: "rules" };

// What a link asks for: switches for the server, and positions of fingers, first down first.
// Points as millimetres: "40.0" on a bar, "40.0x60.0" on a plate.
function readPoints(text) { return text.split(",").filter(Boolean).map((mm) => pointOf(mm.split("x").map((part) => Number(part) / 1000))); }

function textOf(points) { return points.map((point) => [plainOf(point)].flat().map((at) => (1000 * at).toFixed(1)).join("x")).join(","); }

// Whether it is a point of this device's surface, or one of its kind beyond its edges.
function isPointOf({ corner_m }) { return ({ x, y }) => Number.isFinite(x) && Number.isNaN(y) === Number.isNaN(corner_m.y); }

export function readLink(hash, scene) {
  const asked = new URLSearchParams(hash.slice(1)), switches = {};
  for (const name of Object.keys(NAMES)) if (asked.has(name)) switches[name] = asked.get(name);
  if (asked.has("level")) switches.level_db = asked.get("level") === "full" ? null : Number(asked.get("level"));
  if (asked.has("actuators")) switches.actuators_m = readPoints(asked.get("actuators"));
  if (asked.has("loaded")) switches.is_loaded = asked.get("loaded") !== "0";
  if (asked.has("other")) switches.is_other = asked.get("other") !== "0";
  const zones = scene.device.zones.map(({ name }) => name);
  const isOther = switches.device !== undefined && switches.device !== scene.choice.device;
  if (asked.has("quiet")) switches.quiet_zones = asked.get("quiet").split(",").filter((name) => isOther ? name : zones.includes(name));
  // What this page does not offer is left out.
  if (switches.device !== undefined && !scene.devices.includes(switches.device)) delete switches.device;
  if (switches.rules !== undefined && !scene.rules.includes(switches.rules)) delete switches.rules;
  if (switches.level_db !== undefined && !scene.levels_db.includes(switches.level_db)) delete switches.level_db;
  if (!["click", "steady", "zones", undefined].includes(switches.source)) delete switches.source;
  if (switches.actuators_m?.some(({ x }) => !Number.isFinite(x))) delete switches.actuators_m;
  else switches.actuators_m &&= switches.actuators_m.map(plainOf);
  const fingers = readPoints(asked.get("fingers") ?? "");
  return { switches, fingers: fingers.filter(({ x, y }) => x >= 0 && Number.isFinite(x) && !(y < 0)).slice(0, 10) };
}

// The link to a scene with fingers that stay at these points.
export function linkOf(choice, fingers) {
  const parts = [
    ...Object.keys(NAMES).map((name) => [name, choice[name]]),
    ["level", choice.level_db === null ? "full" : `${choice.level_db}`],
    ...(choice.quiet_zones.length ? [["quiet", choice.quiet_zones.join(",")]] : []),
    ...(choice.actuators_m.length ? [["actuators", textOf(choice.actuators_m)]] : []),
    ...(choice.is_other ? [["other", "1"]] : []),
    ...(choice.is_loaded ? [] : [["loaded", "0"]]),
    ...(fingers.length ? [["fingers", textOf(fingers)]] : []),
  ];
  return `#${parts.map(([name, value]) => `${name}=${encodeURIComponent(value).replaceAll("%2C", ",").replaceAll("%3A", ":")}`).join("&")}`;
}
