// @ts-check
/** All words of the page, by language. */

/** @typedef {typeof EN} Words */

const EN = {
  unpacking: "Unpacking the scene",
  building: "Preparing the rays",
  failed: "This page could not be opened: {reason}",
  old: "This browser is too old for the page: it has no {missing}. Any browser from 2023 on has.",
  picture: "Picture of the scene. Arrow keys turn it, with Shift they move it, + and - zoom, Enter asks at the centre.",
  date: "Date",
  time: "Time",
  play: "Play the day",
  stop: "Stop",
  bearing: "Direction of the sun",
  height: "Height of the sun",
  sunAt: "Sun {altitude}° high, direction {azimuth}°",
  night: "The sun is below the horizon",
  hint: "Click a place to ask when it has sun.",
  hintSky: "Click a place to ask how much of the sky it sees.",
  nothing: "There is no surface here.",
  inSun: "In the sun.",
  inShadow: "In the shadow of {blocker}.",
  behind: "Turned away from the sun.",
  atNight: "The sun is below the horizon.",
  hours: "{hours} of sun on this day",
  hoursBlocked: "{hours} of sun on this day, blocked {spans}",
  span: "{from} to {to} by {blocker}",
  sky: "Sees {share} % of the sky.",
  something: "the scene itself",
  day: "The day at this place: {sentence}",
  proofRunning: "Checking bits",
  proved: "Same bits as Antumbra {version}: {n} of {n} rays",
  wrong: "WARNING: {wrong} of {n} rays differ from Antumbra {version} on this device. Do not rely on this page.",
  samples: "{n} of {all} samples",
  north: "North",
  scale: "Scale at the centre of the picture",
  scene: "{triangles} triangles, scene {digest}",
  help: "Drag to turn, right button or two fingers to move, wheel or pinch to zoom.",
  walk: "Walk",
  walkHelp:
    "W A S D or arrow keys walk, Shift runs, drag to look around, two fingers or the wheel walk too, Escape ends.",
  controls: "Sun",
};

/** @type {Words} */
const DE = {
  unpacking: "Die Szene wird entpackt",
  building: "Die Strahlen werden vorbereitet",
  failed: "Diese Seite lässt sich nicht öffnen: {reason}",
  old: "Dieser Browser ist zu alt für die Seite: ihm fehlt {missing}. Browser ab 2023 haben es.",
  picture:
    "Bild der Szene. Pfeiltasten drehen sie, mit Umschalttaste verschieben sie, + und - zoomen, Eingabe fragt in der Bildmitte.",
  date: "Datum",
  time: "Uhrzeit",
  play: "Tag abspielen",
  stop: "Anhalten",
  bearing: "Richtung der Sonne",
  height: "Höhe der Sonne",
  sunAt: "Sonne {altitude}° hoch, Richtung {azimuth}°",
  night: "Die Sonne steht unter dem Horizont",
  hint: "Auf eine Stelle klicken, um zu fragen, wann dort Sonne ist.",
  hintSky: "Auf eine Stelle klicken, um zu fragen, wie viel Himmel sie sieht.",
  nothing: "Hier ist keine Fläche.",
  inSun: "In der Sonne.",
  inShadow: "Im Schatten von {blocker}.",
  behind: "Von der Sonne abgewandt.",
  atNight: "Die Sonne steht unter dem Horizont.",
  hours: "{hours} Sonne an diesem Tag",
  hoursBlocked: "{hours} Sonne an diesem Tag, verdeckt {spans}",
  span: "{from} bis {to} von {blocker}",
  sky: "Sieht {share} % des Himmels.",
  something: "der Szene selbst",
  day: "Der Tag an dieser Stelle: {sentence}",
  proofRunning: "Bits werden geprüft",
  proved: "Dieselben Bits wie Antumbra {version}: {n} von {n} Strahlen",
  wrong:
    "WARNUNG: {wrong} von {n} Strahlen weichen auf diesem Gerät von Antumbra {version} ab. Die Seite ist hier unzuverlässig.",
  samples: "{n} von {all} Abtastungen",
  north: "Norden",
  scale: "Maßstab in der Bildmitte",
  scene: "{triangles} Dreiecke, Szene {digest}",
  help: "Ziehen dreht, rechte Taste oder zwei Finger verschieben, Rad oder Spreizen zoomt.",
  walk: "Gehen",
  walkHelp:
    "W A S D oder Pfeiltasten gehen, Umschalttaste läuft, Ziehen schaut umher, zwei Finger oder Rad gehen auch, Escape beendet.",
  controls: "Sonne",
};

/** @type {Record<string, Words>} */
export const WORDS = { en: EN, de: DE };

/**
 * A phrase with its gaps filled.
 * @param {string} phrase
 * @param {Record<string, string | number>} values
 */
export function fill(phrase, values) {
  return phrase.replace(/\{(\w+)\}/g, (_, name) => String(values[name]));
}
