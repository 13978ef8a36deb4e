// @ts-check
/** All words of the page: a row for each phrase, a column for each language. */

const LANGUAGES = ["en", "de"];

const TABLE = {
  locale: ["en-GB", "de"],

  // opening, and what can go wrong
  unpacking: ["Unpacking the scene", "Die Szene wird entpackt"],
  building: ["Preparing the rays", "Die Strahlen werden vorbereitet"],
  drawing: ["Drawing the first picture", "Das erste Bild wird berechnet"],
  failed: ["This page could not be opened: {reason}", "Diese Seite lässt sich nicht öffnen: {reason}"],
  old: [
    "This browser is too old for this page: it lacks {missing}. Browsers from 2023 on have it.",
    "Dieser Browser ist zu alt für die Seite: ihm fehlt {missing}. Browser ab 2023 haben es.",
  ],
  memory: [
    "This device has too little memory for the scene, which has {triangles} triangles. Close other pages, or open this page on a computer.",
    "Dieses Gerät hat zu wenig Speicher für die Szene mit {triangles} Dreiecken. Andere Seiten schließen, oder die Seite an einem Computer öffnen.",
  ],
  damaged: [
    "The file is damaged. Download or copy it again.",
    "Die Datei ist beschädigt. Bitte erneut von der Quelle kopieren.",
  ],

  // picture and tools
  picture: [
    "Picture of the scene. Arrow keys turn it, Shift and arrow keys move it, + and - zoom, Enter clicks its centre.",
    "Bild der Szene. Pfeiltasten drehen sie, mit Umschalttaste verschieben sie, + und - zoomen, Eingabe fragt in der Bildmitte.",
  ],
  help: [
    "Drag to turn. Use the right button or two fingers to move, and the wheel or a pinch to zoom.",
    "Ziehen dreht, rechte Taste oder zwei Finger verschieben, Rad oder Spreizen zoomt.",
  ],
  walk: ["Walk", "Gehen"],
  walkHelp: [
    "Walk with W A S D, arrow keys, the wheel or two fingers. Hold Shift to run, drag to look around, and press Escape to stop.",
    "W A S D oder Pfeiltasten gehen, Umschalttaste läuft, Ziehen schaut umher, zwei Finger oder Rad gehen auch, Escape beendet.",
  ],
  tools: ["View", "Ansicht"],
  reset: ["Reset view", "Zurücksetzen"],
  resetDone: ["View reset.", "Die erste Ansicht ist zu sehen."],
  link: ["Copy link", "Link kopieren"],
  linkCopied: ["Link to this view copied.", "Ein Link zu dieser Ansicht ist kopiert."],
  linkShown: [
    "The address bar contains the link to this view.",
    "Der Link zu dieser Ansicht steht in der Adresszeile.",
  ],
  linkWrong: [
    "The link contains no view of this page, so you see the first one.",
    "Der Link hat keine Ansicht dieser Seite; die erste Ansicht ist zu sehen.",
  ],
  save: ["Save picture", "Bild speichern"],
  saved: ["Picture saved as {name}.", "Das Bild ist als {name} gespeichert."],
  north: ["North", "Norden"],
  scale: ["Scale at the centre of the picture", "Maßstab in der Bildmitte"],
  samples: ["drawing: {n} of {all} samples", "Bild: {n} von {all} Abtastungen"],

  // sun
  controls: ["Sun", "Sonne"],
  date: ["Date", "Datum"],
  time: ["Time", "Uhrzeit"],
  play: ["Play the day", "Tag abspielen"],
  stop: ["Stop", "Anhalten"],
  bearing: ["Direction of the sun", "Richtung der Sonne"],
  height: ["Height of the sun", "Höhe der Sonne"],
  sunAt: ["Sun {altitude}° high, direction {azimuth}°", "Sonne {altitude}° hoch, Richtung {azimuth}°"],
  night: ["The sun is below the horizon", "Die Sonne steht unter dem Horizont"],

  // answers
  hint: [
    "Exact shadows, traced in your browser. Click a place to see when it is in the sun.",
    "Genaue Schatten, im Browser berechnet. Auf eine Stelle klicken, um zu fragen, wann dort Sonne ist.",
  ],
  hintSky: [
    "Click a place to see how much of the sky it sees.",
    "Auf eine Stelle klicken, um zu fragen, wie viel Himmel sie sieht.",
  ],
  nothing: ["There is no surface here.", "Hier ist keine Fläche."],
  inSun: ["In the sun.", "In der Sonne."],
  inShadow: ["In the shade.", "Im Schatten."],
  inShadowOf: ["In the shade of {blocker}.", "Im Schatten von {blocker}."],
  behind: ["Faces away from the sun.", "Von der Sonne abgewandt."],
  atNight: ["The sun is below the horizon.", "Die Sonne steht unter dem Horizont."],
  today: ["today", "heute"],
  onDay: ["on {date}", "am {date}"],
  sun: ["{hours} of sun {day}", "{hours} Sonne {day}"],
  noSun: ["No sun {day}", "Keine Sonne {day}"],
  openSky: ["{sun}; sees {share} % of the sky.", "{sun}; {share} % des Himmels sichtbar."],
  blockedSky: [
    "{sun}, blocked {spans}; sees {share} % of the sky.",
    "{sun}, verschattet {spans}; {share} % des Himmels sichtbar.",
  ],
  span: ["{from} to {to}", "von {from} bis {to} Uhr"],
  spanBy: ["{from} to {to} by {blocker}", "von {from} bis {to} Uhr durch {blocker}"],
  sky: ["Sees {share} % of the sky.", "{share} % des Himmels sichtbar."],
  noValue: ["no value", "kein Wert"],
  day: ["The day at this place: {sentence}", "Der Tag an dieser Stelle: {sentence}"],
  horizon: [
    "Sky at this place, with the sun's path on this day and at the solstices",
    "Himmel über dieser Stelle mit der Sonnenbahn des Tages und der Sonnenwenden",
  ],
  compass: ["N E S W", "N O S W"],

  // measuring and sight
  measure: ["Measure", "Messen"],
  firstPlace: ["Click the first place.", "Auf die erste Stelle klicken."],
  secondPlace: ["Click the second place.", "Auf die zweite Stelle klicken."],
  apart: ["{length} apart: {level} horizontally; {step}.", "{length} Abstand, waagerecht {level}; {step}."],
  higher: ["the second place is {height} higher", "die zweite Stelle liegt {height} höher"],
  lower: ["the second place is {height} lower", "die zweite Stelle liegt {height} tiefer"],
  sameHeight: ["both are at the same height", "beide liegen gleich hoch"],
  fromFirst: ["From the first place", "Von der ersten Stelle aus"],
  fromAbove: ["From {height} above the first place", "Aus {height} Höhe über der ersten Stelle"],
  inView: ["{from}, the second is in sight.", "{from} ist die zweite zu sehen."],
  hidden: ["{from}, the second is hidden.", "{from} ist die zweite verdeckt."],
  hiddenBy: ["{from}, the second is hidden by {blocker}.", "{from} ist die zweite durch {blocker} verdeckt."],
  eyeHeight: ["Eye height", "Augenhöhe"],
  lookFrom: ["Click the place to look from.", "Auf die Stelle klicken, von der aus geschaut wird."],
  inSight: ["seen from here", "von hier zu sehen"],
  outOfSight: ["hidden", "verdeckt"],

  // hours of sun on surfaces
  show: ["Show", "Anzeige"],
  light: ["Light and shadow", "Licht und Schatten"],
  seen: ["What is seen from here", "Sicht von hier"],
  sunDay: ["Sun hours: this day", "Sonnenstunden: dieser Tag"],
  sunYear: ["Sun hours: year", "Sonnenstunden: Jahr"],
  restart: ["Restart", "Neu starten"],
  dayScale: ["Sun hours on {date}", "Sonnenstunden am {date}"],
  yearScale: [
    "Sun hours per day, averaged over the 21st of each month of {year}",
    "Sonnenstunden je Tag, Mittel der 21. Tage aller Monate {year}",
  ],
  grid: ["Every {spacing} m, {state}", "Alle {spacing} m, {state}"],
  percent: ["{share} %", "{share} %"],
  done: ["finished", "fertig"],
  stopped: ["stopped", "angehalten"],
  here: ["Here: {hours}", "Hier: {hours}"],

  // before and after
  before: ["Before", "Vorher"],
  after: ["After", "Nachher"],
  divider: ["Divider between before and after", "Trennlinie zwischen vorher und nachher"],
  dividerAt: ["{before} % before, {after} % after", "{before} % vorher, {after} % nachher"],
  notBefore: ["This surface does not exist before the change.", "Vorher gibt es diese Fläche nicht."],
  notAfter: ["This surface does not exist after the change.", "Nachher gibt es diese Fläche nicht."],
  lost: [
    "{before} of sun before, {after} after: {change} less.",
    "Vorher {before} Sonne, nachher {after}: {change} weniger.",
  ],
  gained: [
    "{before} of sun before, {after} after: {change} more.",
    "Vorher {before} Sonne, nachher {after}: {change} mehr.",
  ],
  same: ["{after} of sun before and after.", "Vorher und nachher {after} Sonne."],
  sunStates: ["Before: {before} After: {after}", "Vorher: {before} Nachher: {after}"],

  // proof
  scene: ["{triangles} triangles", "{triangles} Dreiecke"],
  proofRunning: ["Checking this page", "Bits werden geprüft"],
  proved: [
    "Same bits as Antumbra {version}: {n} of {n} rays, scene unaltered",
    "Dieselben Bits wie Antumbra {version}: {n} von {n} Strahlen, Szene unverändert",
  ],
  provedRays: [
    "Same bits as Antumbra {version}: {n} of {n} rays; this browser cannot check the digest",
    "Dieselben Bits wie Antumbra {version}: {n} von {n} Strahlen; die Prüfsumme kann dieser Browser nicht prüfen",
  ],
  wrong: [
    "WARNING: {wrong} of {n} rays differ from Antumbra {version} on this device. Do not rely on this page.",
    "WARNUNG: {wrong} von {n} Strahlen weichen auf diesem Gerät von Antumbra {version} ab. Die Seite ist hier unzuverlässig.",
  ],
  altered: [
    "WARNING: the scene differs from the one that Antumbra {version} wrote into this page. Do not rely on this page.",
    "WARNUNG: Die Szene ist nicht die, die Antumbra {version} in diese Seite geschrieben hat. Die Seite ist unzuverlässig.",
  ],
};

/** @typedef {Record<keyof typeof TABLE, string>} Words */

/** The phrases of each language, by name. */
export const WORDS = /** @type {Record<string, Words>} */ (
  Object.fromEntries(
    LANGUAGES.map((language, column) => [
      language,
      Object.fromEntries(Object.entries(TABLE).map(([name, row]) => [name, row[column]])),
    ]),
  )
);

/**
 * A phrase with its gaps filled.
 * @param {string} phrase
 * @param {Record<string, string | number>} values
 */
export function fill(phrase, values) {
  return phrase.replace(/\{(\w+)\}/g, (_, name) => String(values[name]));
}
