// @ts-check
/** The elements of the page. */

/** @param {string} id */
export const part = (id) => /** @type {any} */ (document.getElementById(id));

/**
 * @param {string} id of an input
 * @param {string} text of its label
 */
export function label(id, text) {
  part(id).closest("label").querySelector("span").textContent = text;
}
