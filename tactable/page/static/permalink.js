// The part of the address after "#": what is chosen, and the fingers that stay, so that a link shows the same scene.

const NAMES = { device: "device", source: "source", rules: "rules" };

// What a link asks for: switches for the server, and positions of fingers in metres, first down first.
export function readLink(hash, scene) {
  const asked = new URLSearchParams(hash.slice(1)), switches = {};
  for (const name of Object.keys(NAMES)) if (asked.has(name)) switches[name] = asked.get(name);
  if (asked.has("level")) switches.level_db = asked.get("level") === "full" ? null : Number(asked.get("level"));
  if (asked.has("actuators")) switches.actuators_m = asked.get("actuators").split(",").map((mm) => Number(mm) / 1000);
  if (asked.has("loaded")) switches.is_loaded = asked.get("loaded") !== "0";
  const zones = scene.device.zones.map(({ name }) => name);
  const isOther = switches.device !== undefined && switches.device !== scene.choice.device;
  if (asked.has("quiet")) switches.quiet_zones = asked.get("quiet").split(",").filter((name) => isOther ? name : zones.includes(name));
  // What this page does not offer is left out.
  if (switches.device !== undefined && !scene.devices.includes(switches.device)) delete switches.device;
  if (switches.rules !== undefined && !scene.rules.includes(switches.rules)) delete switches.rules;
  if (switches.level_db !== undefined && !scene.levels_db.includes(switches.level_db)) delete switches.level_db;
  if (!["click", "steady", "zones", undefined].includes(switches.source)) delete switches.source;
  if (switches.actuators_m?.some((at_m) => !Number.isFinite(at_m))) delete switches.actuators_m;
  const fingers = (asked.get("fingers") ?? "").split(",").filter(Boolean).map((mm) => Number(mm) / 1000);
  return { switches, fingers: fingers.filter((at_m) => Number.isFinite(at_m) && at_m >= 0).slice(0, 10) };
}

// The link to a scene with fingers that stay at these positions, in metres.
export function linkOf(choice, fingers) {
  const parts = [
    ...Object.keys(NAMES).map((name) => [name, choice[name]]),
    ["level", choice.level_db === null ? "full" : `${choice.level_db}`],
    ...(choice.quiet_zones.length ? [["quiet", choice.quiet_zones.join(",")]] : []),
    ...(choice.actuators_m.length ? [["actuators", choice.actuators_m.map((at_m) => (1000 * at_m).toFixed(1)).join(",")]] : []),
    ...(choice.is_loaded ? [] : [["loaded", "0"]]),
    ...(fingers.length ? [["fingers", fingers.map((at_m) => (1000 * at_m).toFixed(1)).join(",")]] : []),
  ];
  return `#${parts.map(([name, value]) => `${name}=${encodeURIComponent(value).replaceAll("%2C", ",").replaceAll("%3A", ":")}`).join("&")}`;
}
