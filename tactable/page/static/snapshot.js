// The page's picture as one PNG: what is simulated, the sentence, the bars and the courses, as they are now.

const MARGIN = 16, GAP = 8;

// Parts below one another: { text, size, weight, colour }, sizes in pixels of the page, or { canvas }.
export function snapshotOf(parts, { paper, font }) {
  const ratio = window.devicePixelRatio || 1, copy = document.createElement("canvas"), c = copy.getContext("2d");
  const inner = Math.max(...parts.map(({ canvas }) => canvas?.width ?? 0)), written = (part) => `${part.weight ?? 400} ${part.size * ratio}px ${font}`;
  const rows = parts.flatMap((part) => {
    if (part.canvas) return [{ ...part, height: part.canvas.height }];
    c.font = written(part);
    return wrapped(c, part.text, inner).map((text) => ({ ...part, text, height: 1.3 * part.size * ratio }));
  });
  copy.width = inner + 2 * MARGIN * ratio;
  copy.height = rows.reduce((sum, { height }) => sum + height + GAP * ratio, 2 * MARGIN * ratio);
  c.fillStyle = paper; // A canvas is transparent.
  c.fillRect(0, 0, copy.width, copy.height);
  c.textBaseline = "top";
  let top = MARGIN * ratio;
  for (const row of rows) {
    if (row.canvas) c.drawImage(row.canvas, MARGIN * ratio, top);
    else {
      c.font = written(row);
      c.fillStyle = row.colour;
      c.fillText(row.text, MARGIN * ratio, top);
    }
    top += row.height + GAP * ratio;
  }
  return copy.toDataURL("image/png");
}

function wrapped(c, text, width) {
  const lines = [""];
  for (const word of text.split(" ")) {
    const longer = lines.at(-1) ? `${lines.at(-1)} ${word}` : word;
    if (c.measureText(longer).width <= width || !lines.at(-1)) lines[lines.length - 1] = longer;
    else lines.push(word);
  }
  return lines;
}
