// Prints the report of Khronos' glTF validator on a file as JSON: NODE_PATH=... node validate.mjs MODEL.glb
import {createRequire} from "node:module";
import fs from "node:fs";
import path from "node:path";

const validator = createRequire(path.join(process.env.NODE_PATH, "/"))("gltf-validator");
const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[2])));
console.log(JSON.stringify(report.issues));
