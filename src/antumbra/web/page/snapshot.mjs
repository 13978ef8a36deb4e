// @ts-check
/** The picture to download: what is shown, with its title, moment, credits and proof. */

const [PAPER, INK, SOFT, ALERT] = ["#ffffff", "#1a2030", "#5a6375", "#b3261e"];
const FONT = "system-ui, sans-serif";

/**
 * A line of text: its size in pixels of the page, and its colour.
 * @typedef {{text: string, size: number, colour: string, bold?: boolean}} Line
 */

/**
 * What the picture says.
 * @typedef {{title: string, when: string, credits: string, about: string, proof: string, proved: boolean}} Caption
 */

/**
 * Draw the picture with its caption.
 * @param {HTMLElement} main the part of the page with the pictures and what lies above them
 * @param {Caption} caption
 * @returns {Promise<Blob>} PNG
 */
export function snapshot(main, { title, when, credits, about, proof, proved }) {
  const pictures = /** @type {HTMLCanvasElement[]} */ ([...main.querySelectorAll("canvas.layer:not([hidden])")]);
  const { width, height } = pictures[0];
  const scale = width / Math.max(1, pictures[0].clientWidth);
  const canvas = document.createElement("canvas");
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  /** @type {(line: Line) => Line[]} */
  const wrap = (line) => wrapped(context, line, width / scale - 28);
  const above = [
    { text: title, size: 18, colour: INK, bold: true },
    { text: when, size: 13, colour: SOFT },
  ].flatMap(wrap);
  const below = [
    { text: credits, size: 12, colour: INK },
    { text: about, size: 11, colour: SOFT },
    { text: proof, size: 11, colour: proved ? SOFT : ALERT, bold: !proved },
  ].flatMap(wrap);
  const [top, bottom] = [above, below].map((lines) => lines.reduce((sum, { size }) => sum + 1.45 * size, 18) * scale);
  Object.assign(canvas, { width, height: Math.round(height + top + bottom) });
  context.fillStyle = PAPER;
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.setTransform(scale, 0, 0, scale, 0, 0);
  write(context, above, 8);
  write(context, below, (top + height) / scale + 8);
  context.setTransform(1, 0, 0, 1, 0, top);
  for (const picture of pictures) drawCut(context, picture, width, height);
  context.setTransform(scale, 0, 0, scale, 0, top);
  context.beginPath();
  context.rect(0, 0, width / scale, height / scale);
  context.clip();
  drawSigns(context, main);
  return new Promise((done, failed) =>
    canvas.toBlob((blob) => (blob ? done(blob) : failed(new Error("out of memory"))), "image/png"),
  );
}

/**
 * Offer a file to the user.
 * @param {Blob} blob
 * @param {string} name
 */
export function offer(blob, name) {
  const link = document.createElement("a");
  Object.assign(link, { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {HTMLCanvasElement} picture
 * @param {number} width
 * @param {number} height
 */
function drawCut(context, picture, width, height) {
  const share = Number(picture.dataset.share ?? 1);
  if (share > 0) context.drawImage(picture, 0, 0, share * picture.width, picture.height, 0, 0, share * width, height);
}

/**
 * The arrow, the scale, the divider, the names of its sides, and the panels, as they are shown.
 * @param {CanvasRenderingContext2D} context
 * @param {HTMLElement} main
 */
function drawSigns(context, main) {
  const frame = main.getBoundingClientRect();
  Object.assign(context, { fillStyle: "#fff", strokeStyle: "#fff", shadowColor: "#000", shadowBlur: 3, lineWidth: 2 });
  for (const sign of /** @type {HTMLElement[]} */ ([...main.querySelectorAll("[data-sign]")])) {
    const box = sign.getBoundingClientRect();
    if (box.width === 0 || getComputedStyle(sign).visibility === "hidden") continue;
    const [x, y, w, h] = [box.left - frame.left, box.top - frame.top, box.width, box.height];
    if (sign.dataset.sign === "panel") {
      drawPanel(context, sign, frame);
      continue;
    }
    if (sign.dataset.sign === "arrow") {
      context.save();
      context.translate(x + w / 2, y + h / 2);
      context.rotate((Number.parseFloat(sign.dataset.turn ?? "0") * Math.PI) / 180);
      const path = sign.querySelector("path")?.getAttribute("d") ?? "";
      context.scale(0.92, 0.92);
      context.fill(new Path2D(path));
      context.restore();
      continue;
    }
    if (sign.dataset.sign === "line") context.fillRect(x + w / 2 - 1, 0, 2, frame.height);
    if (sign.dataset.sign === "bar") context.stroke(new Path2D(`M${x + 1} ${y}V${y + h - 1}H${x + w - 1}V${y}`));
    context.font = `${getComputedStyle(sign).fontWeight} ${getComputedStyle(sign).fontSize} ${FONT}`;
    Object.assign(context, { textAlign: "center", textBaseline: "middle" });
    context.fillText(sign.textContent ?? "", x + w / 2, y + h / 2);
  }
}

/**
 * A panel: its ground, and the canvases, patches and texts in it.
 * @param {CanvasRenderingContext2D} context
 * @param {HTMLElement} panel
 * @param {DOMRect} frame
 */
function drawPanel(context, panel, frame) {
  context.save();
  Object.assign(context, { shadowBlur: 0, textAlign: "left", textBaseline: "alphabetic" });
  const within = /** @type {HTMLElement[]} */ ([panel, ...panel.querySelectorAll("*")]);
  for (const each of within) {
    const box = each.getBoundingClientRect();
    if (box.width === 0) continue;
    const [x, y, w, h] = [box.left - frame.left, box.top - frame.top, box.width, box.height];
    const { backgroundColor, borderTopLeftRadius, color, fontSize } = getComputedStyle(each);
    const radius = Number.parseFloat(borderTopLeftRadius) * (borderTopLeftRadius.endsWith("%") ? w / 100 : 1);
    context.fillStyle = backgroundColor;
    context.beginPath();
    context.roundRect(x, y, w, h, radius);
    context.fill();
    if (each instanceof HTMLCanvasElement) context.drawImage(each, x, y, w, h);
    for (const text of [...each.childNodes].filter((node) => node instanceof Text)) {
      const range = document.createRange();
      range.selectNode(text);
      const { left, top, width } = range.getBoundingClientRect();
      const line = { text: text.data, size: Number.parseFloat(fontSize), colour: color };
      write(context, wrapped(context, line, width + 1), top - frame.top, left - frame.left);
    }
  }
  context.restore();
}

/**
 * Lines that are as wide as there is room.
 * @param {CanvasRenderingContext2D} context
 * @param {Line} line
 * @param {number} room
 * @returns {Line[]}
 */
function wrapped(context, line, room) {
  context.font = fontOf(line);
  const lines = [""];
  for (const word of line.text.split(/\s+/)) {
    const last = lines[lines.length - 1];
    const longer = last ? `${last} ${word}` : word;
    if (last && context.measureText(longer).width > room) lines.push(word);
    else lines[lines.length - 1] = longer;
  }
  return lines.filter(Boolean).map((text) => ({ ...line, text }));
}

/** @param {Line} line */
function fontOf({ size, bold }) {
  return `${bold ? "bold " : ""}${size}px ${FONT}`;
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Line[]} lines
 * @param {number} top
 * @param {number} left
 */
function write(context, lines, top, left = 14) {
  let y = top;
  for (const line of lines) {
    context.font = fontOf(line);
    context.fillStyle = line.colour;
    y += 1.45 * line.size;
    context.fillText(line.text, left, y - 0.4 * line.size);
  }
}
