// @ts-check
/** The buttons of the page, and what they do: the first view, a link to the view, and a picture to download. */

import { part } from "./parts.mjs";
import { offer, snapshot } from "./snapshot.mjs";
import { fill } from "./words.mjs";

/**
 * The numbers of the camera, what the sun is set to, and where the divider is.
 * @typedef {{camera: number[], sun: Record<string, string | number>, divider?: number}} View
 */

/**
 * A button: its name, and what it does. What `press` returns is said to the user.
 * @typedef {{id: string, name: string, press: () => Promise<string> | string}} Tool
 */

const DIGITS = 9; // of the camera's numbers in links
const SAID = 6000; // milliseconds that a line stays

export class Toolbar {
  /**
   * @param {HTMLElement} element
   * @param {HTMLElement} line
   */
  constructor(element, line) {
    this.element = element;
    this.line = line;
    this.later = 0;
  }

  /**
   * Add a button.
   * @param {Tool} tool
   * @param {(error: any) => void} failed
   */
  add({ id, name, press }, failed) {
    const button = document.createElement("button");
    Object.assign(button, { id, type: "button", textContent: name });
    button.addEventListener("click", async () => {
      try {
        this.say(await press());
      } catch (error) {
        failed(error);
      }
    });
    this.element.append(button);
    return button;
  }

  /** @param {string} text */
  say(text) {
    this.line.textContent = text;
    clearTimeout(this.later);
    this.later = setTimeout(() => {
      this.line.textContent = "";
    }, SAID);
  }
}

/**
 * What the buttons need of a page.
 * @typedef {object} Shown
 * @property {import("./orbit.mjs").Orbit} camera
 * @property {import("./sun_panel.mjs").SunPanel} sun
 * @property {import("./before_after.mjs").Divider | null} divider
 * @property {import("./words.mjs").Words} words
 * @property {import("./walk.mjs").Walk} walk
 * @property {boolean} proved
 * @property {() => void} changed
 */

/**
 * The buttons, from left to right.
 * @param {Shown} page
 * @returns {Tool[]}
 */
export function toolsOf(page) {
  const { words } = page;
  const first = viewOfPage(page);
  return [
    { id: "walk", name: words.walk, press: () => page.walk.toggle() },
    { id: "reset", name: words.reset, press: () => reset(page, first) },
    { id: "link", name: words.link, press: () => link(page) },
    { id: "save", name: words.save, press: () => save(page) },
  ];
}

/**
 * Show the view of the address, if it has one. What it returns is said to the user.
 * @param {Shown} page
 */
export function restore(page) {
  const text = location.hash.slice(1);
  if (!text) return "";
  const view = viewOf(text, viewOfPage(page));
  if (!view) return page.words.linkWrong;
  show(page, view);
  page.sun.setting = view.sun;
  return "";
}

/**
 * @param {Shown} page
 * @returns {View}
 */
function viewOfPage({ camera, sun, divider }) {
  return { camera: camera.view, sun: sun.setting, divider: divider?.share };
}

/**
 * @param {Shown} page
 * @param {View} view
 */
function show(page, { camera, divider }) {
  if (page.camera.walking) page.walk.stop();
  page.camera.view = camera;
  if (divider !== undefined) page.divider?.move(divider);
}

/**
 * @param {Shown} page
 * @param {View} first
 */
function reset(page, first) {
  show(page, first);
  page.changed();
  return page.words.resetDone;
}

/** @param {Shown} page */
async function link(page) {
  history.replaceState(null, "", `#${textOf(viewOfPage(page))}`);
  try {
    await navigator.clipboard.writeText(location.href);
    return page.words.linkCopied;
  } catch {
    return page.words.linkShown; // the browser keeps the clipboard to itself
  }
}

/** @param {Shown} page */
async function save({ sun, words, proved }) {
  const when = [sun.place ? sun.date : "", part("when").textContent].filter(Boolean).join(" · ");
  const [credits, about, proof] = ["credits", "about", "proof"].map((id) => part(id).textContent);
  const title = document.title;
  const blob = await snapshot(part("main"), { title, when, credits, about, proof, proved });
  const moment = sun.place ? [sun.date, part("when").textContent.slice(0, 5)] : Object.values(sun.setting);
  const name = `${[title, ...moment].join(" ").replace(/[\\/:*?"<>|]+/g, "-")}.png`;
  offer(blob, name);
  return fill(words.saved, { name });
}

/**
 * @param {View} view
 */
export function textOf({ camera, sun, divider }) {
  const parts = { camera: camera.map((x) => Number(x.toPrecision(DIGITS))).join(), ...sun };
  const all = divider === undefined ? parts : { ...parts, divider };
  return Object.entries(all)
    .map(([name, value]) => `${name}=${encodeURIComponent(value).replaceAll("%2C", ",")}`)
    .join("&");
}

/**
 * The view of an address, with the sun and the divider of a page where it has none; null if it is not one.
 * @param {string} text behind #
 * @param {View} own the page's own view
 * @returns {View | null}
 */
export function viewOf(text, own) {
  const given = new URLSearchParams(text);
  const camera = (given.get("camera") ?? "").split(",").map(numberOf);
  if (camera.length !== own.camera.length || !camera.every(Number.isFinite)) return null;
  /** @type {Record<string, string | number>} */
  const sun = {};
  for (const [name, value] of Object.entries(own.sun)) {
    const text = given.get(name) ?? String(value);
    sun[name] = typeof value === "number" ? numberOf(text) : text;
    if (typeof value === "number" ? !Number.isFinite(sun[name]) : !/^\d{4}-\d\d-\d\d$/.test(text)) return null;
  }
  const divider = own.divider === undefined ? undefined : numberOf(given.get("divider") ?? String(own.divider));
  return Number.isNaN(divider) ? null : { camera, sun, divider };
}

/** @param {string} text */
function numberOf(text) {
  return text.trim() === "" ? Number.NaN : Number(text);
}
