// Pictures of a page in node: node page_picture.mjs MODULES FOLDER. FOLDER has page.html, and request.json: the size, the
// passes, the sun, and decoded textures; picture.bin (float32 light and coverage) and screen.bin (bytes) are written.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [, , modules, folder] = process.argv;
const load = (name) => import(pathToFileURL(`${modules}/${name}.mjs`));
const { lookOf } = await load("appearance");
const { Orbit } = await load("orbit");
const { mipLevels } = await load("textures");
const { backdrop, dimmed, exposureOf, toScreen } = await load("tone");
const { Tracer } = await load("tracer");
const { unpack } = await load("unpack");

const page = readFileSync(`${folder}/page.html`, "utf8");
const partOf = (id) => page.match(new RegExp(`<script [^>]*id="${id}"[^>]*>(.*?)</script>`, "s"))[1];
const {
  width,
  height,
  passes,
  sun,
  images,
  view,
  ambient: given,
  rows = 64,
} = JSON.parse(readFileSync(`${folder}/request.json`));
const about = JSON.parse(partOf("scene"));
const arrays = await unpack(partOf("data"), about.columns, () => {});
const textures = about.look.textures.map(({ wraps, nearest }, k) => {
  const [w, h] = images[k];
  const pixels = new Uint8Array(readFileSync(`${folder}/image${k}`));
  return { width: w, height: h, pixels, mips: mipLevels(pixels, w, h), wraps, nearest };
});
const tracer = await Tracer.create(arrays.wasm, about.kernels, lookOf(about, arrays, textures));
const camera = new Orbit(about.camera, about.up);
const rays = view ?? camera.rays(width, height);
const draw = (pass, ambient) => {
  const light = new Float32Array(4 * width * height);
  const arrived = [0, 0, 0];
  let surfaces = 0;
  for (let first = 0; first < height; first += rows) {
    const band = {
      rays,
      width,
      height,
      first,
      rows: Math.min(rows, height - first),
      pass,
      sun,
      daylight: 1,
      painted: false,
      ambient,
    };
    const part = tracer.band(band);
    light.set(part.light, 4 * width * first);
    for (let k = 0; k < 3; k++) arrived[k] += part.arrived[k];
    surfaces += part.surfaces;
  }
  return { light, ambient: arrived.map((each) => (0.12 * each) / surfaces) };
};
const { ambient } = draw(0, [0, 0, 0]);
const sum = new Float32Array(4 * width * height);
const seconds = [];
let exposure = 1;
for (let pass = 0; pass < passes; pass++) {
  const start = performance.now();
  const { light } = draw(pass, given ?? ambient);
  seconds.push((performance.now() - start) / 1000);
  if (pass === 0) exposure = exposureOf(light);
  for (let i = 0; i < sum.length; i++) sum[i] += light[i];
}
const shown = about.look.sky ? dimmed(exposure, about.look.sky.daylight) : { dim: 1, sky: 0 };
const behind = shown && backdrop(rays, width, height, about.up === "z" ? 2 : 1);
writeFileSync(
  `${folder}/picture.bin`,
  sum.map((each) => each / passes),
);
writeFileSync(`${folder}/screen.bin`, toScreen(sum, passes, exposure, behind, shown?.dim ?? 1, shown?.sky));
writeFileSync(`${folder}/answers.json`, JSON.stringify({ ambient, exposure, seconds }));
