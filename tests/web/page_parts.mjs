// Calls modules of the page for a test: node page_parts.mjs MODULES FOLDER. FOLDER has calls.json; answers.json is written.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [, , modules, folder] = process.argv;
const { sunAngles } = await import(pathToFileURL(`${modules}/../module/sun_position.mjs`));
const { offsetAt, midnight, daysAfter } = await import(pathToFileURL(`${modules}/sun.mjs`));
const { dayOf, sentenceOf, sunsAbove } = await import(pathToFileURL(`${modules}/answer.mjs`));
const { lookOf } = await import(pathToFileURL(`${modules}/appearance.mjs`));
const { ColourScale } = await import(pathToFileURL(`${modules}/colour_scale.mjs`));
const { measured, measureSentence } = await import(pathToFileURL(`${modules}/measure.mjs`));
const { QUESTIONS } = await import(pathToFileURL(`${modules}/questions.mjs`));
const { levelsOf, SurfaceGrid } = await import(pathToFileURL(`${modules}/surface_grid.mjs`));
const { Tracer } = await import(pathToFileURL(`${modules}/tracer.mjs`));
const { unpack } = await import(pathToFileURL(`${modules}/unpack.mjs`));
const { WORDS } = await import(pathToFileURL(`${modules}/words.mjs`));
const { colourOf, textOf } = await import(pathToFileURL(`${modules}/layer.mjs`));
const { SurfaceValues } = await import(pathToFileURL(`${modules}/surface_values.mjs`));
const { reasonOf } = await import(pathToFileURL(`${modules}/checks.mjs`));
const { askBoth } = await import(pathToFileURL(`${modules}/before_after.mjs`));
const { scaleBar } = await import(pathToFileURL(`${modules}/scale.mjs`));
const { textOf: linkOf, viewOf } = await import(pathToFileURL(`${modules}/toolbar.mjs`));

/** The tracer of the page that was asked last. */
let opened = { data: "", tracer: null };

async function tracerOf({ data, about }) {
  if (opened.data !== data) {
    const arrays = await unpack(data, about.columns, () => {});
    opened = { data, tracer: await Tracer.create(arrays.wasm, about.kernels, lookOf(about, arrays, [])) };
  }
  return opened.tracer;
}

const calls = {
  ask: async ({ page, name, question }) => {
    const answer = QUESTIONS[name](await tracerOf(page), question);
    return ArrayBuffer.isView(answer) ? [...answer] : answer;
  },
  paint: async ({ page, most, place, days, step }) => {
    const tracer = await tracerOf(page);
    const suns = sunsAbove(days.map((day) => dayOf(place, day, page.about.up, step)));
    return levelsOf(tracer.mesh, most).map(({ spacing, cells, parts }) => {
      const found = new Float64Array(cells).fill(Number.NaN);
      const sensors = [];
      for (const part of parts) {
        const { start, values } = QUESTIONS.hours(tracer, { spacing, part, suns });
        found.set(values, start);
        sensors.push(...new SurfaceGrid(tracer.mesh, spacing).sensors(part).cells);
      }
      return { spacing, cells, unknown: found.filter(Number.isNaN).length, hours: sensors.map((cell) => found[cell]) };
    });
  },
  sensors: ({ mesh, spacing }) => {
    const arrays = { positions: Float32Array.from(mesh.positions), indices: Int32Array.from(mesh.indices) };
    const grid = new SurfaceGrid({ ...mesh, ...arrays }, spacing);
    const all = grid.sensors({ first: 0, last: grid.faces, from: 0, to: Number.MAX_SAFE_INTEGER });
    const cells = grid.parts().flatMap((part) => [...grid.sensors(part).cells]);
    return { points: [...all.points], normals: [...all.normals], cells: [...all.cells], inParts: cells };
  },
  scale: ({ palette, most, values }) => {
    const scale = new ColourScale(palette, most);
    return { ticks: scale.ticks, colours: values.map((value) => scale.colour(value)) };
  },
  sentence: ({ place, date, altitude, blocked, names, language, ...found }) => {
    if (!place) return sentenceOf(found, null, altitude, WORDS[language], (face) => names[face] ?? "");
    const day = dayOf(place, date, "z");
    const local = (k) => (day.starts[k] - day.starts[0]) / 3600;
    const spanOf = (k) => blocked.findIndex(([from, to]) => local(k) >= from && local(k) < to);
    const states = day.starts.map((_, k) => (spanOf(k) >= 0 ? 2 : 1));
    const blockers = day.starts.map((_, k) => spanOf(k));
    const when = { place, date, day };
    return sentenceOf({ ...found, states, blockers }, when, altitude, WORDS[language], (face) => names[face] ?? "");
  },
  measure: ({ first, second, about, eye, sight, language, name }) =>
    measureSentence(measured(first, second, about), eye, sight, WORDS[language], () => name),
  angles: ({ place, seconds }) => seconds.map((second) => Object.values(sunAngles(place, second))),
  offsets: ({ place, seconds }) => seconds.map((second) => offsetAt(place, second)),
  midnights: ({ place, days }) => days.map((day) => [midnight(place, day), midnight(place, daysAfter(day, 1))]),
  words: () => WORDS,
  colours: ({ scale, values }) => values.map((value) => colourOf(scale, value)),
  texts: ({ scale, values }) => values.map((value) => textOf(scale, value, "en")),
  values: ({ layer, arrays, hits }) => {
    const surface = new SurfaceValues(layer, arrays);
    return hits.map(({ face, point, normal }) => surface.at(face, point, normal));
  },
  reasons: ({ messages }) => messages.map((message) => reasonOf(new Error(message), WORDS.en, 1234567)),
  views: ({ own, links }) => [linkOf(own), ...links.map((link) => viewOf(link, own))],
  both: ({ state, faces, height, tilt }) => {
    const normal = [0, Math.sin(tilt), Math.cos(tilt)];
    const ask = async ({ state: asked, at }) =>
      asked === state || at
        ? { face: 0, point: [1, 2, 3], normal: [0, 0, 1], at: Boolean(at) }
        : { face: 1, point: [1, 2, 3 + height], normal };
    return askBoth(ask, {}, state, faces, 0.01);
  },
  bar: ({ about, distance }) => {
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
