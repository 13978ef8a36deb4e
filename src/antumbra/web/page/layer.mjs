// @ts-check
/** Numbers on surfaces: a colour scale, as map sheets have it, its legend, and what a number is in words. */

/**
 * A scale: colours in sRGB at increasing values, straight lines between them; or, with `classes`, a colour for each value.
 * @typedef {{name: string, unit: string, classes: boolean, stops: {value: number, text: string,
 *   colour: [number, number, number]}[], ticks: {value: number, text: string}[]}} Scale
 */

/**
 * The index of the last stop that is not above a value, and the share of the way to the next one.
 * @param {Scale} scale
 * @param {number} value
 * @returns {[number, number]}
 */
function placeOf({ stops, classes }, value) {
  let k = 0;
  while (k + 1 < stops.length && value >= stops[k + 1].value) k++;
  if (classes || k + 1 === stops.length || value <= stops[k].value) return [k, 0];
  return [k, (value - stops[k].value) / (stops[k + 1].value - stops[k].value)];
}

/**
 * The colour of a value, sRGB from 0 to 255; those beyond the ends have the colours of the ends.
 * @param {Scale} scale
 * @param {number} value
 * @returns {[number, number, number]}
 */
export function colourOf(scale, value) {
  const [k, share] = placeOf(scale, value);
  const [from, to] = [scale.stops[k].colour, scale.stops[Math.min(k + 1, scale.stops.length - 1)].colour];
  const [r, g, b] = from.map((c, i) => Math.round(c + share * (to[i] - c)));
  return [r, g, b];
}

/**
 * A value in words: a class, or the number with its unit.
 * @param {Scale} scale
 * @param {number} value
 * @param {string} language
 */
export function textOf(scale, value, language) {
  if (scale.classes) return scale.stops[placeOf(scale, value)[0]].text;
  const number = value.toLocaleString(language, { maximumSignificantDigits: 6 });
  return scale.unit ? `${number} ${scale.unit}` : number;
}

/**
 * Draw the legend into an element: classes with their colours, or a bar above its numbers.
 * @param {HTMLElement} element
 * @param {Scale} scale
 */
export function drawLegend(element, scale) {
  if (scale.classes) {
    element.replaceChildren(
      ...scale.stops.map(({ text, colour }) => {
        const key = made("p", "key", text);
        const patch = made("i", "patch", "");
        patch.style.background = `rgb(${colour})`;
        key.prepend(patch);
        return key;
      }),
    );
    return;
  }
  const bar = /** @type {HTMLCanvasElement} */ (document.createElement("canvas"));
  Object.assign(bar, { width: 256, height: 1 });
  const context = /** @type {CanvasRenderingContext2D} */ (bar.getContext("2d"));
  const [low, high] = [scale.stops[0].value, scale.stops[scale.stops.length - 1].value];
  for (let x = 0; x < 256; x++) {
    context.fillStyle = `rgb(${colourOf(scale, low + ((high - low) * x) / 255)})`;
    context.fillRect(x, 0, 1, 1);
  }
  const numbers = made("div", "numbers", "");
  for (const { value, text } of scale.ticks) {
    const number = made("span", "", text);
    number.style.left = `${high > low ? (100 * (value - low)) / (high - low) : 0}%`;
    numbers.append(number);
  }
  element.replaceChildren(bar, numbers);
}

/**
 * @param {string} tag
 * @param {string} name of the class
 * @param {string} text
 */
function made(tag, name, text) {
  const element = document.createElement(tag);
  element.className = name;
  element.textContent = text;
  return element;
}
