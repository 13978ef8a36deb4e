// What the viewer's page adds to viser's: a panel that starts folded where it would cover the scene, taps that count,
// names for controls, keys, and a command to copy.

/** The head of viser's mobile panel, until we have named it. */
const HEAD = '[style*="user-select: none"][style*="height: 3.5em"]:not([data-panel])';

/** Controls that viser leaves without a name; each stands in a row that begins with its label. */
const NAMELESS = [".mantine-Slider-thumb", ".mantine-Input-input", ".mantine-Checkbox-input"]
  .map((control) => `${control}:is(:not([aria-label]), [aria-label=""])`)
  .join();
const ICONS = { ".mantine-Notification-closeButton": "Close", ".mantine-ActionIcon-root": "Settings of the page" };
const LABEL = '.mantine-Text-root[style*="font-weight: 450"]';

const KEYS = [
  ["← → ↑ ↓", "turn around the scene"],
  ["W A S D", "move forwards, left, back and right"],
  ["Q E", "move down and up"],
  ["+ -", "zoom"],
  ["R", "reset the view"],
  ["C", "copy the command that renders the view"],
  ["?", "show these keys"],
];

const HELP = `<button id="help" aria-label="Keyboard shortcuts" title="Keyboard shortcuts (?)">?</button>
<dialog id="keys" aria-label="Keyboard shortcuts"><table>${KEYS.map(
  ([keys, what]) => `<tr><th><kbd>${keys.split(" ").join("</kbd> <kbd>")}</kbd><td>${what}`,
).join("")}</table><form method="dialog"><button>Close</button></form></dialog>`;

const ACTIONS = {
  "+": () => zoom(-1),
  "=": () => zoom(-1),
  "-": () => zoom(1),
  r: () => press("Reset view"),
  c: () => press("Copy view"),
  "?": () => document.querySelector("#keys:not([open])")?.showModal(),
};

/** Zoom in (-1) or out (1), as one notch of a wheel does. */
function zoom(sign) {
  const canvas = document.querySelector("canvas[data-engine]");
  if (!canvas) return;
  const { left, top, width, height } = canvas.getBoundingClientRect();
  const middle = { clientX: left + width / 2, clientY: top + height / 2 };
  canvas.dispatchEvent(new WheelEvent("wheel", { deltaY: 240 * sign, bubbles: true, cancelable: true, ...middle }));
}

function press(label) {
  for (const button of document.querySelectorAll(".mantine-Button-root")) {
    if (button.textContent === label) button.click();
  }
}

function key(event) {
  const typing = event.target.closest?.("input:not([type=checkbox]), textarea, [contenteditable]");
  if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
  ACTIONS[event.key.length === 1 ? event.key.toLowerCase() : ""]?.();
}

/** Fold a panel that has just appeared. One tap, Enter or Space opens it. */
function fold() {
  const head = document.querySelector(HEAD);
  if (!head) return;
  Object.assign(head, { tabIndex: 0, role: "button", ariaLabel: "Controls" });
  head.dataset.panel = "";
  head.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === " ") head.click();
  });
  head.click();
}

/** Give controls the names of their rows. */
function name() {
  for (const control of document.querySelectorAll(NAMELESS)) {
    let row = control.parentElement;
    while (row && !row.querySelector(LABEL)) row = row.parentElement;
    if (row) control.ariaLabel = row.querySelector(LABEL).textContent;
  }
  for (const [icon, label] of Object.entries(ICONS)) {
    for (const button of document.querySelectorAll(`${icon}:not([aria-label])`)) button.ariaLabel = label;
  }
}

/** The number of the command in the clipboard. */
let copied = "";

/** Copy a command that has just appeared, unless viser has only drawn the panel again. Pages that are not secure have
 * no clipboard; there, it can be selected. */
async function copy() {
  const command = document.querySelector("[data-copy]");
  if (!command) return;
  const number = command.dataset.copy;
  delete command.dataset.copy;
  const said = command.parentElement.querySelector("output");
  try {
    if (number !== copied) await navigator.clipboard.writeText(command.textContent);
    copied = number;
    said.textContent = "Copied the command that renders this view:";
  } catch {
    said.textContent = "This command renders the view:";
  }
}

/** Browsers capture touches for what they start on, which viser mistakes for the drag of a handle. */
function release(event) {
  if (event.pointerType === "touch" && event.target.tagName === "CANVAS") {
    event.target.releasePointerCapture(event.pointerId);
  }
}

/** Whether WebGL is drawn by the processor. */
function isSoftware() {
  const gl = new OffscreenCanvas(1, 1).getContext("webgl2");
  const exact = gl?.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL;
  return /swiftshader|llvmpipe|software|basic render/i.test(gl?.getParameter(exact ?? gl.RENDERER));
}

if (isSoftware()) {
  const { getContext } = HTMLCanvasElement.prototype; // pictures arrive smooth, and multisampling costs half the time
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    return getContext.call(this, kind, options && { ...options, antialias: false });
  };
}
document.body.insertAdjacentHTML("beforeend", HELP);
document.querySelector("#help").addEventListener("click", ACTIONS["?"]);
new MutationObserver(() => [fold(), name(), copy()]).observe(document.documentElement, {
  childList: true,
  subtree: true,
});
window.addEventListener("pointerdown", release, true);
window.addEventListener("keydown", key);
