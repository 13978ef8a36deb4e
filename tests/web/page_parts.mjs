// Calls modules of the page for a test: node page_parts.mjs MODULES FOLDER. FOLDER has calls.json; answers.json is written.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [, , modules, folder] = process.argv;
const { sunAngles } = await import(pathToFileURL(`${modules}/../module/sun_position.mjs`));
const { offsetAt, midnight, daysAfter } = await import(pathToFileURL(`${modules}/sun.mjs`));
const { unpack } = await import(pathToFileURL(`${modules}/unpack.mjs`));
const { WORDS } = await import(pathToFileURL(`${modules}/words.mjs`));
const { reasonOf } = await import(pathToFileURL(`${modules}/checks.mjs`));
const { askBoth } = await import(pathToFileURL(`${modules}/before_after.mjs`));
const { scaleBar } = await import(pathToFileURL(`${modules}/scale.mjs`));
const { textOf, viewOf } = await import(pathToFileURL(`${modules}/tools.mjs`));

const calls = {
  angles: ({ place, seconds }) => seconds.map((second) => Object.values(sunAngles(place, second))),
  offsets: ({ place, seconds }) => seconds.map((second) => offsetAt(place, second)),
  midnights: ({ place, days }) => days.map((day) => [midnight(place, day), midnight(place, daysAfter(day, 1))]),
  words: () => WORDS,
  reasons: ({ messages }) => messages.map((message) => reasonOf(new Error(message), WORDS.en, 1234567)),
  views: ({ own, links }) => [textOf(own), ...links.map((link) => viewOf(link, own))],
  both: ({ state, faces, height, tilt }) => {
    const normal = [0, Math.sin(tilt), Math.cos(tilt)];
    const ask = async ({ state: asked, at }) =>
      asked === state || at
        ? { face: 0, point: [1, 2, 3], normal: [0, 0, 1], at: Boolean(at) }
        : { face: 1, point: [1, 2, 3 + height], normal };
    return askBoth(ask, {}, state, faces, 0.01);
  },
  scale: ({ about, distance }) => {
    const element = { style: {}, setAttribute() {} };
    scaleBar(element, { tangent: 0.5, distance }, 800, about, WORDS.en);
    return [element.textContent, Number.parseFloat(element.style.width)];
  },
  columns: async ({ data, columns }) => {
    const arrays = await unpack(data, columns, () => {});
    for (const [name, array] of Object.entries(arrays)) writeFileSync(`${folder}/${name}`, array);
    return Object.keys(arrays);
  },
};
const answers = [];
for (const { call, ...given } of JSON.parse(readFileSync(`${folder}/calls.json`)))
  answers.push(await calls[call](given));
writeFileSync(`${folder}/answers.json`, JSON.stringify(answers));
