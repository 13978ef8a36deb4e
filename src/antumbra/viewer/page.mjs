// What the viewer's page adds to viser's: a panel that starts folded where it would cover the scene, and taps that count.

/** The head of viser's mobile panel, until we have named it. */
const HEAD = '[style*="user-select: none"][style*="height: 3.5em"]:not([data-panel])';

/** Fold a panel that has just appeared. One tap, Enter or Space opens it. */
function fold() {
  const head = document.querySelector(HEAD);
  if (!head) return;
  Object.assign(head, { tabIndex: 0, role: "button", ariaLabel: "Controls" });
  head.dataset.panel = "";
  head.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === " ") head.click();
  });
  head.click();
}

/** Browsers capture touches for what they start on, which viser mistakes for the drag of a handle. */
function release(event) {
  if (event.pointerType === "touch" && event.target.tagName === "CANVAS") {
    event.target.releasePointerCapture(event.pointerId);
  }
}

new MutationObserver(fold).observe(document.documentElement, { childList: true, subtree: true });
window.addEventListener("pointerdown", release, true);
