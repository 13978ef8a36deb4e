// On narrow screens, rows of tables that do not fit become cards, whose cells are named by the head of their column.
// Tables of many columns, mostly of numbers, scroll instead, and a shadow shows that they do.
const MOST = 5; // columns of a table that becomes cards

function shape(table) {
  const heads = [...table.querySelectorAll("thead th")].map((head) => head.textContent.trim());
  table.classList.remove("cards", "scrolls");
  if (!heads.length || table.scrollWidth <= table.clientWidth + 1) return;
  if (heads.length > MOST) return table.classList.add("scrolls");
  for (const row of table.tBodies[0].rows)
    [...row.cells].forEach((cell, k) => {
      cell.dataset.label = heads[k] ?? "";
    });
  table.classList.add("cards");
}

const narrow = matchMedia("(max-width: 46rem)");
const shapeAll = () => {
  for (const table of document.querySelectorAll("article table.docutils")) shape(table);
};
narrow.addEventListener("change", shapeAll);
addEventListener("toggle", shapeAll, true); // tables that were folded
addEventListener("DOMContentLoaded", shapeAll);
