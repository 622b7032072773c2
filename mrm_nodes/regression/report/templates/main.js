"use strict";

// The page comes alive: the address, the keyboard, the window.

function follow() {
  readAddress();
  showWall();
  const each = state.case === null ? null : findCase(state.case);
  if (each) {
    wall.current = Math.max(0, placeOf(each));
    openCase(each);
  } else closeCase();
  byId("unknown").hidden = !(state.case && !each);
  byId("unknown").textContent = state.case && !each ? `There is no case ${state.case} in this report.` : "";
}

makeFilters();
makeTables();
follow();
addEventListener("hashchange", follow);
addEventListener("popstate", follow);
addEventListener("resize", layWall);
let waiting = false;
addEventListener("scroll", () => {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    fillWall();
  });
}, { passive: true });

wall.element.addEventListener("focusin", (event) => {
  const link = event.target.closest("[data-index]");
  if (link) wall.current = Number(link.dataset.index);
});

view.dialog.addEventListener("close", () => {
  stopFlicker();
  if (state.case !== null) go({ case: null });
  moveTo(wall.current);
});
byId("close").addEventListener("click", closeCase);
byId("previous").addEventListener("click", () => stepCase(-1));
byId("next").addEventListener("click", () => stepCase(1));
for (const mode of ["side", "slider", "flicker"]) byId(`mode-${mode}`).addEventListener("click", () => chooseMode(mode));
byId("darker").addEventListener("click", () => expose(-1));
byId("brighter").addEventListener("click", () => expose(1));
byId("false").addEventListener("click", toggleColours);
byId("nearer").addEventListener("click", () => zoomToSpot(1));
byId("farther").addEventListener("click", () => zoomToSpot(-1));
byId("map-kind").addEventListener("change", (event) => chooseMap(event.target.value));
byId("wipe").addEventListener("input", (event) => setWipe(event.target.value / 100));
document.querySelectorAll(".frame").forEach(listenToFrame);
byId("help-open").addEventListener("click", () => byId("help").showModal());
byId("help-close").addEventListener("click", () => byId("help").close());

// Keys, as the help has them.

const IN_CASE = {
  ArrowLeft: () => stepCase(-1),
  ArrowRight: () => stepCase(1),
  b: () => chooseMode("side"),
  s: () => chooseMode(view.mode === "slider" ? "side" : "slider"),
  f: () => (view.mode === "flicker" && still.matches ? turn() : chooseMode(view.mode === "flicker" ? "side" : "flicker")),
  e: () => chooseMap(),
  c: toggleColours,
  "+": () => expose(1),
  "=": () => expose(1),
  "-": () => expose(-1),
  z: () => zoomToSpot(1),
  Z: () => zoomToSpot(-1),
  0: () => (resetZoom(), expose(0)),
};
const ON_WALL = {
  ArrowLeft: () => moveTo(wall.current - 1),
  ArrowRight: () => moveTo(wall.current + 1),
  ArrowUp: () => moveTo(wall.current - wall.columns),
  ArrowDown: () => moveTo(wall.current + wall.columns),
  Home: () => moveTo(0),
  End: () => moveTo(wall.cases.length - 1),
};

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || byId("help").open) return;
  const field = event.target.matches("input, select");
  if (event.key === "Escape" && event.target === byId("search")) {
    change({ q: "" });
    moveTo(0);
  } else if (field && !(event.target === byId("search") && ["ArrowDown", "Enter"].includes(event.key))) return;
  else if (event.key === "?") byId("help").showModal();
  else if (view.dialog.open) {
    if (!(event.key in IN_CASE)) return;
    IN_CASE[event.key]();
  } else if (event.key === "/") byId("search").select();
  else if (field) moveTo(wall.current);
  else if (event.key in ON_WALL && !event.target.closest(".scroll, .scenes, .tile")) ON_WALL[event.key]();
  else return;
  event.preventDefault();
});

document.documentElement.dataset.ready = "";
