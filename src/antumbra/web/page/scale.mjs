// @ts-check
/** The scale bar: a round length at the middle of the picture. */

const LONGEST = 130; // pixels

/**
 * @param {HTMLElement} element
 * @param {import("./orbit.mjs").Orbit} camera
 * @param {number} height of the picture in pixels
 * @param {number} metres in a unit of the scene
 * @param {import("./words.mjs").Words} words
 */
export function scaleBar(element, camera, height, metres, words) {
  const pixel = (2 * camera.tangent * camera.distance * metres) / Math.max(1, height);
  const most = LONGEST * pixel;
  const power = 10 ** Math.floor(Math.log10(most));
  const length = [5, 2, 1].map((each) => each * power).find((each) => each <= most) ?? power;
  element.style.width = `${length / pixel}px`;
  const digits = Math.max(0, -Math.floor(Math.log10(length >= 1000 ? length / 1000 : length)));
  element.textContent = length >= 1000 ? `${(length / 1000).toFixed(digits)} km` : `${length.toFixed(digits)} m`;
  element.setAttribute("aria-label", `${words.scale}: ${element.textContent}`);
}
