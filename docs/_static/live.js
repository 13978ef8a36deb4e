// 3D views with baked light: each <figure class="live" data-model="FILE.js" data-name="NAME"> gets a canvas, a slider of
// the sun and a switch to hours of sun. scripts/live_models.py makes the models and describes their columns. Where there
// is no WebGL 2, the figure keeps its image.
"use strict";

const LIVE_VERTEX = `#version 300 es
in vec3 place, tint;
in uvec2 hidden;
in float sky, count;
uniform mat4 camera;
uniform vec3 lower, size;
uniform ivec2 suns;
out vec3 world, colour;
out vec2 lit;
out float open, hours;

float seen(int sun) {
  uint word = sun < 32 ? hidden.x : hidden.y;
  return float(1u - (word >> uint(sun & 31) & 1u));
}

void main() {
  world = lower + place * size;
  colour = pow(tint, vec3(2.2));
  lit = vec2(seen(suns.x), seen(suns.y));
  open = sky;
  hours = count;
  gl_Position = camera * vec4(world, 1.0);
}`;

const LIVE_FRAGMENT = `#version 300 es
precision highp float;
in vec3 world, colour;
in vec2 lit;
in float open, hours;
uniform vec3 sun, ramp[9];
uniform float between, most, exposure;
uniform bool counting;
out vec4 pixel;

void main() {
  vec3 normal = normalize(cross(dFdx(world), dFdy(world)));
  if (counting) { // the ramp, shaded a little so that shapes stay visible
    float at = clamp(hours / most, 0.0, 1.0) * 8.0;
    int stop = min(int(at), 7);
    pixel = vec4(mix(ramp[stop], ramp[stop + 1], at - float(stop)) * (0.75 + 0.25 * open), 1.0);
    return;
  }
  vec2 edges = smoothstep(0.3, 0.7, lit); // of shadows, between vertices
  float direct = mix(edges.x, edges.y, between) * max(dot(normal, sun), 0.0) * smoothstep(0.0, 0.12, sun.y);
  vec3 warm = mix(vec3(1.0, 0.62, 0.32), vec3(1.0, 0.95, 0.87), smoothstep(0.0, 0.45, sun.y));
  vec3 day = mix(vec3(0.20, 0.24, 0.34), vec3(0.46, 0.53, 0.66), smoothstep(0.0, 0.5, sun.y));
  vec3 light = 1.25 * direct * warm + day * open + 0.05;
  vec3 shown = exposure * colour * light;
  shown = shown / (1.0 + 0.25 * shown); // rolls off highlights
  pixel = vec4(pow(shown, vec3(1.0 / 2.2)), 1.0);
}`;

// --- Vectors and matrices, column by column --------------------------------------------------------------------------

const minus = (a, b) => a.map((x, i) => x - b[i]);
const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((x) => x / Math.hypot(...a));

function cameraMatrix(model, eye, aspect) {
  const target = model.target;
  const back = unit(minus(eye, target)), right = unit(cross([0, 1, 0], back)), up = cross(back, right);
  const distance = Math.hypot(...minus(eye, target)), near = distance / 50, far = distance * 10;
  const fy = 1 / Math.tan((model.vfov * Math.PI) / 360), fx = fy / aspect, depth = (near + far) / (near - far);
  const rows = [right, up, back].map((axis) => [...axis, -dot(axis, eye)]);
  const out = [];
  for (let k = 0; k < 4; k++) {
    const z = rows[2][k];
    out.push(fx * rows[0][k], fy * rows[1][k], depth * z + (k === 3 ? (2 * near * far) / (near - far) : 0), -z);
  }
  return new Float32Array(out);
}

// --- Models: columns of bytes, see scripts/live_models.py ------------------------------------------------------------

function scriptOf(file) {
  return new Promise((resolve, reject) => {
    const script = Object.assign(document.createElement("script"), { src: file, onload: resolve, onerror: reject });
    document.head.append(script);
  });
}

async function columnsOf(model) {
  const packed = Uint8Array.from(atob(model.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  let start = 0;
  const column = (rows, width) => { // byte k of all rows, for each k
    const out = new Uint8Array(rows * width);
    for (let k = 0; k < width; k++) for (let i = 0; i < rows; i++) out[i * width + k] = bytes[start++];
    return out;
  };
  const n = model.vertices;
  const place = new Uint16Array(column(n, 6).buffer), hidden = new Uint32Array(column(n, 8).buffer);
  const steps = new Uint32Array(column(model.faces, 12).buffer).map((x) => (x >>> 1) ^ -(x & 1));
  const tint = column(n, 3), sky = column(n, 1), count = new Uint8Array(n);
  for (let i = 0; i < steps.length; i += 3) {
    steps[i] += i ? steps[i - 3] : 0; // modulo 2**32
    steps[i + 1] += steps[i];
    steps[i + 2] += steps[i];
  }
  for (let i = 0; i < n; i++) {
    for (let s = 0; s < model.suns.length; s++) count[i] += 1 - ((hidden[2 * i + (s >> 5)] >>> (s & 31)) & 1);
  }
  return { place, hidden, faces: steps, tint, sky, count };
}

// --- The view --------------------------------------------------------------------------------------------------------

function programOf(gl) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, LIVE_VERTEX], [gl.FRAGMENT_SHADER, LIVE_FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

function upload(gl, program, columns) {
  const attribute = (name, width, kind) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, columns[name], gl.STATIC_DRAW);
    const at = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(at);
    if (kind === gl.UNSIGNED_INT) gl.vertexAttribIPointer(at, width, kind, 0, 0);
    else gl.vertexAttribPointer(at, width, kind, name !== "count", 0, 0);
  };
  attribute("place", 3, gl.UNSIGNED_SHORT);
  attribute("hidden", 2, gl.UNSIGNED_INT);
  attribute("tint", 3, gl.UNSIGNED_BYTE);
  attribute("sky", 1, gl.UNSIGNED_BYTE);
  attribute("count", 1, gl.UNSIGNED_BYTE);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, columns.faces, gl.STATIC_DRAW);
}

function drawer(gl, model, columns) {
  const program = programOf(gl), where = (name) => gl.getUniformLocation(program, name);
  upload(gl, program, columns);
  gl.useProgram(program);
  gl.enable(gl.DEPTH_TEST);
  gl.uniform3fv(where("lower"), model.lower);
  gl.uniform3fv(where("size"), model.size);
  gl.uniform3fv(where("ramp"), model.ramp.flat());
  gl.uniform1f(where("most"), model.suns.length);
  gl.uniform1f(where("exposure"), model.exposure);
  return (state) => {
    const first = Math.min(Math.floor(state.sun), model.suns.length - 2), between = state.sun - first;
    const [a, b] = [model.suns[first], model.suns[first + 1]];
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const aspect = gl.drawingBufferWidth / gl.drawingBufferHeight;
    gl.uniformMatrix4fv(where("camera"), false, cameraMatrix(model, eyeOf(model, state), aspect));
    gl.uniform2i(where("suns"), first, first + 1);
    gl.uniform1f(where("between"), between);
    gl.uniform3fv(where("sun"), unit(a.map((x, i) => x + between * (b[i] - x))));
    gl.uniform1i(where("counting"), state.counting);
    gl.drawElements(gl.TRIANGLES, columns.faces.length, gl.UNSIGNED_INT, 0);
  };
}

function eyeOf(model, state) {
  const level = Math.cos(state.high) * state.away;
  const along = [Math.sin(state.turn) * level, Math.sin(state.high) * state.away, Math.cos(state.turn) * level];
  return along.map((x, i) => x + model.target[i]);
}

function startOf(model) {
  const [x, y, z] = minus(model.eye, model.target), away = Math.hypot(x, y, z);
  return { turn: Math.atan2(x, z), high: Math.asin(y / away), away, sun: model.start * (model.suns.length - 1), counting: false };
}

function timeAt(model, sun) {
  const minutes = (time) => 60 * Number(time.slice(0, 2)) + Number(time.slice(3));
  const now = minutes(model.times[0]) + Math.round(sun * model.step * 60);
  return `${String(Math.floor(now / 60)).padStart(2, "0")}:${String(now % 60).padStart(2, "0")}`;
}

function followInput(canvas, state, redraw) {
  const away = state.away;
  let last = null;
  const move = (right, up) => {
    state.turn -= right;
    state.high = Math.min(1.5, Math.max(0.05, state.high + up));
    redraw();
  };
  const zoom = (factor) => {
    state.away = Math.min(2.5 * away, Math.max(0.3 * away, state.away * factor));
    redraw();
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    last = [event.clientX, event.clientY];
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons || !last) return;
    const [right, down] = minus([event.clientX, event.clientY], last);
    last = [event.clientX, event.clientY];
    move(0.008 * right, event.pointerType === "touch" ? 0 : 0.008 * down); // on a phone, up and down scroll the page
  });
  canvas.addEventListener("wheel", (event) => { // the page scrolls until the view has been clicked
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    zoom(Math.exp(0.001 * event.deltaY));
  });
  const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
  canvas.addEventListener("keydown", (event) => {
    if (event.key in keys) move(...keys[event.key]);
    else if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? 0.9 : 1 / 0.9);
    else return;
    event.preventDefault();
  });
}

const LIVE_CONTROLS = `
<canvas tabindex="0" role="img"></canvas>
<div class="live-controls">
  <label>Time <input type="range" min="0" step="0.01"><output></output></label>
  <label><input type="checkbox"> Hours of sun <span class="live-ramp" hidden></span></label>
</div>`;

async function show(figure) {
  await scriptOf(figure.dataset.model);
  const model = window.liveModels[figure.dataset.name], columns = await columnsOf(model);
  const made = document.createElement("div"), image = figure.querySelector("img");
  made.innerHTML = LIVE_CONTROLS;
  const [canvas, slider, text, box, ramp] = ["canvas", "[type=range]", "output", "[type=checkbox]", ".live-ramp"].map(
    (selector) => made.querySelector(selector));
  const gl = canvas.getContext("webgl2", { antialias: true });
  const draw = drawer(gl, model, columns), state = startOf(model), size = model.suns.length - 1;
  let queued = false;
  const redraw = () => {
    if (queued) return;
    queued = true;
    requestAnimationFrame(() => {
      queued = false;
      text.textContent = timeAt(model, state.sun);
      slider.setAttribute("aria-valuetext", text.textContent);
      draw(state);
    });
  };
  canvas.setAttribute("aria-label", `${image.alt}. Drag or use the arrow keys to turn it.`);
  slider.max = size;
  slider.value = state.sun;
  ramp.style.background = `linear-gradient(90deg, ${model.ramp.map((c) => `rgb(${c.map((x) => 255 * x)})`)})`;
  ramp.textContent = `0 to ${(model.suns.length * model.step).toFixed(0)} h`;
  slider.addEventListener("input", () => { state.sun = Number(slider.value); redraw(); });
  box.addEventListener("change", () => { state.counting = box.checked; ramp.hidden = !box.checked; redraw(); });
  followInput(canvas, state, redraw);
  image.replaceWith(...made.children);
  new ResizeObserver(() => {
    const sharp = Math.min(2, window.devicePixelRatio);
    [canvas.width, canvas.height] = [canvas.clientWidth * sharp, canvas.clientHeight * sharp].map(Math.round);
    redraw();
  }).observe(canvas);
  figure.dataset.state = "ready";
}

function watch() {
  const can = document.createElement("canvas").getContext("webgl2") && "DecompressionStream" in window;
  const figures = document.querySelectorAll("figure.live");
  if (!can) return figures.forEach((figure) => { figure.dataset.state = "image"; });
  const seen = new IntersectionObserver((entries) => entries.filter((e) => e.isIntersecting).forEach((entry) => {
    seen.unobserve(entry.target);
    show(entry.target).catch((error) => {
      entry.target.dataset.state = "image";
      console.error(error);
    });
  }));
  figures.forEach((figure) => seen.observe(figure));
}

watch();
