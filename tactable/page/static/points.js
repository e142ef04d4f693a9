// Points of the surface, {x, y} in metres: y is NaN on a bar. In JSON they are numbers or pairs of numbers.

const POINTS = new Set(["corner_m", "position_m", "start_m", "stop_m", "file_m"]);
const LISTS = new Set(["actuators_m", "last_m"]);

export function pointOf(value) {
  const [x, y = NaN] = [value].flat();
  return { x, y };
}

export function plainOf({ x, y }) { return Number.isNaN(y) ? x : [x, y]; }

// A scene whose points are points.
export function parseScene(text) {
  return JSON.parse(text, (key, value) => POINTS.has(key) ? pointOf(value) : LISTS.has(key) ? value.map(pointOf) : value);
}

function both(one, other, of) { return { x: of(one.x, other.x), y: of(one.y, other.y) }; }

// A point as fractions of the surface, whose corner is `corner_m`; and back, on the surface.
export function shareOf(point, corner_m) { return both(point, corner_m, (at, side) => Math.min(at / side, 1)); }

export function pointAt(share, corner_m) { return both(share, corner_m, (part, side) => part * side); }

export function middleOf({ start_m, stop_m }) { return both(start_m, stop_m, (a, b) => (a + b) / 2); }

export function distanceOf(one, other) { return Math.hypot(one.x - other.x, Number.isNaN(one.y) ? 0 : one.y - other.y); }

// A point as people write it: "35 mm", "35 × 60 mm".
export function pointText(point, digits = 0) {
  return `${[plainOf(point)].flat().map((at) => (1000 * at).toFixed(digits).replace(/\.0$/, "")).join(" × ")} mm`;
}
