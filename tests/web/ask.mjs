// Asks a scene what a test wants to know: node ask.mjs PACKAGE FOLDER. FOLDER has questions.json, and arrays as files;
// the answers become files of it.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [, , packageFolder, folder] = process.argv;
const { Scene } = await import(pathToFileURL(`${packageFolder}/antumbra.mjs`));
const TYPES = { "<f4": Float32Array, "<f8": Float64Array, "<i4": Int32Array };

function arrayOf(value) {
  if (value === null || typeof value !== "object" || !value.file) return value;
  const bytes = readFileSync(`${folder}/${value.file}`);
  return new TYPES[value.dtype](bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
}

const { scene: files, questions } = JSON.parse(readFileSync(`${folder}/questions.json`));
const answers = [];
let scene;
try {
  scene = await Scene.create(arrayOf(files.positions), arrayOf(files.indices));
} catch (error) {
  answers.push({ error: error.message });
}
for (const [k, { method, values, options }] of (scene ? questions : []).entries()) {
  const named = Object.fromEntries(Object.entries(options).map(([name, value]) => [name, arrayOf(value)]));
  try {
    const found = scene[method](...values.map(arrayOf), named);
    const whole = { occluded: "blocked", sunHours: "hours" }[method]; // the name of an answer that is one array
    const arrays = whole ? { [whole]: found } : { ...found, seenSamples: found.seenSamples };
    for (const [name, array] of Object.entries(arrays))
      if (ArrayBuffer.isView(array)) writeFileSync(`${folder}/${k}-${name}`, array);
    answers.push({});
  } catch (error) {
    answers.push({ error: error.message });
  }
}
writeFileSync(`${folder}/answers.json`, JSON.stringify(answers));
