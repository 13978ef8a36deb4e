// @ts-check
/** The scale bar: a round length at the middle of the picture, in feet if the scene is in feet or inches, else in metres. */

const LONGEST = 130; // pixels
const FEET = ["ft", "us-ft", "in"];

/**
 * @param {HTMLElement} element
 * @param {import("./orbit.mjs").Orbit} camera
 * @param {number} height of the picture in pixels
 * @param {{unit: string, metres: number}} about the scene's unit, and its length in metres
 * @param {import("./words.mjs").Words} words
 */
export function scaleBar(element, camera, height, about, words) {
  const feet = FEET.includes(about.unit);
  const units = feet ? about.metres / (about.unit === "us-ft" ? 1200 / 3937 : 0.3048) : about.metres;
  const pixel = (2 * camera.tangent * camera.distance * units) / Math.max(1, height);
  const most = LONGEST * pixel;
  const power = 10 ** Math.floor(Math.log10(most));
  const length = [5, 2, 1].map((each) => each * power).find((each) => each <= most) ?? power;
  element.style.width = `${length / pixel}px`;
  const large = length >= 1000 && !feet;
  const digits = Math.max(0, -Math.floor(Math.log10(large ? length / 1000 : length)));
  element.textContent = large ? `${length / 1000} km` : `${length.toFixed(digits)} ${feet ? "ft" : "m"}`;
  element.setAttribute("aria-label", `${words.scale}: ${element.textContent}`);
}
