// Shows a GLB file in three.js in headless Chromium, and saves the picture:
//   NODE_PATH=... node show.mjs MODEL.glb OUT.png '{"size": [640, 480], "position": [...], "target": [...], ...}'
// `ambient`: intensity of an ambient light; `linear`: write linear light, so that pixels are the values themselves;
// `lightmap`: read lightmaps, with the loader of the examples, and remove the lights of the file; `exposure`: of ACES.
import {createRequire} from "node:module";
import fs from "node:fs";
import http from "node:http";
import path from "node:path";

const require = createRequire(path.join(process.env.NODE_PATH, "/"));
const {chromium} = require("playwright-core");
const three = path.dirname(path.dirname(require.resolve("three")));
const [model, out, text] = process.argv.slice(2);
const view = JSON.parse(text);
const lightmaps = path.join(import.meta.dirname, "../../examples/lightmaps/three_lightmap.js");

const page = `<!doctype html><body style="margin:0"><script type="importmap">
{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import {GLTFLoader} from "three/addons/loaders/GLTFLoader.js";
import {LightmapExtension, removeLights} from "/three_lightmap.js";
const view = ${text};
const renderer = new THREE.WebGLRenderer({preserveDrawingBuffer: true, antialias: !view.linear});
renderer.setSize(...view.size);
if (view.linear) renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
if (view.exposure) [renderer.toneMapping, renderer.toneMappingExposure] = [THREE.ACESFilmicToneMapping, view.exposure];
document.body.append(renderer.domElement);
const scene = new THREE.Scene();
scene.background = new THREE.Color(view.background ?? 0);
scene.add(new THREE.AmbientLight(0xffffff, view.ambient ?? Math.PI));
const camera = new THREE.PerspectiveCamera(view.vfov ?? 60, view.size[0] / view.size[1], view.near ?? 0.01, view.far ?? 1000);
camera.position.set(...view.position);
camera.lookAt(...view.target);
try {
  const loader = new GLTFLoader();
  if (view.lightmap) loader.register((parser) => new LightmapExtension(parser));
  const gltf = await loader.loadAsync("/model.glb");
  if (view.lightmap) removeLights(gltf.scene);
  scene.add(gltf.scene);
  renderer.render(scene, camera);
  document.title = "drawn";
} catch (error) { document.title = "failed: " + error; }
</script>`;
const server = http.createServer((request, response) => {
  const url = request.url;
  const send = (type, body) => { response.setHeader("Content-Type", type); response.end(body); };
  if (url === "/") send("text/html", page);
  else if (url === "/model.glb") send("model/gltf-binary", fs.readFileSync(model));
  else if (url === "/three_lightmap.js") send("text/javascript", fs.readFileSync(lightmaps));
  else if (url.startsWith("/three/")) send("text/javascript", fs.readFileSync(path.join(three, url.slice(7))));
  else { response.statusCode = 404; response.end(); }
}).listen(0, "127.0.0.1", async () => {
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM,
    args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
  try {
    const tab = await browser.newPage({viewport: {width: view.size[0], height: view.size[1]}});
    await tab.goto(`http://127.0.0.1:${server.address().port}/`);
    await tab.waitForFunction(() => document.title, null, {timeout: 60000});
    const title = await tab.title();
    if (title !== "drawn") throw new Error(title);
    const data = await tab.evaluate(() => document.querySelector("canvas").toDataURL("image/png"));
    fs.writeFileSync(out, Buffer.from(data.split(",")[1], "base64"));
  } finally {
    await browser.close();
    server.close();
  }
});
