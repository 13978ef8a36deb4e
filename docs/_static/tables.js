// On narrow screens, rows that do not fit, or are high, become cards, whose cells are named by the head of their column.
// Tables of many columns, mostly of numbers, scroll instead, and a shadow shows that they do.
const MOST = 5; // columns of a table that becomes cards
const HIGH = 80; // pixels: three lines

const narrow = matchMedia("(max-width: 46rem)");

function shape(table) {
  const heads = [...table.querySelectorAll("thead th")].map((head) => head.textContent.trim());
  table.classList.remove("cards", "scrolls");
  const isWide = table.scrollWidth > table.clientWidth + 1;
  if (heads.length > MOST) return isWide && table.classList.add("scrolls");
  const isHigh = narrow.matches && heads.length > 2 && [...table.tBodies[0].rows].some((row) => row.offsetHeight > HIGH);
  if (!heads.length || !(isWide || isHigh)) return;
  for (const row of table.tBodies[0].rows)
    [...row.cells].forEach((cell, k) => {
      cell.dataset.label = heads[k] ?? "";
    });
  table.classList.add("cards");
}

const shapeAll = () => {
  for (const table of document.querySelectorAll("article table.docutils")) shape(table);
};
narrow.addEventListener("change", shapeAll);
addEventListener("toggle", shapeAll, true); // tables that were folded
addEventListener("DOMContentLoaded", shapeAll);
