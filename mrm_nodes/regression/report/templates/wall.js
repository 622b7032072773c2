"use strict";

// The page: the head, the filters, the wall of cases, and the tables below it.

// Elements are made of text, never of markup: nothing that a report quotes can become part of the page.
function el(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name.startsWith("--")) element.style.setProperty(name, value);
    else if (name === "class") element.className = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined));
  return element;
}

const byId = (id) => document.getElementById(id);
const SIGNS = { pass: "✓", fail: "✕", error: "!", undecided: "?", skipped: "–" };
const COUNTS = { fail: "failed", error: "errors", undecided: "undecided", pass: "passed", skipped: "skipped" };
const address = (path) => path.split("/").map(encodeURIComponent).join("/");

function pill(verdict, words = verdict) {
  return el("span", { class: `pill ${verdict}`, title: words === verdict ? null : `${words}: ${verdict}` }, el("span", { "aria-hidden": "true" }, SIGNS[verdict]), words);
}

function usedBar(share, verdict) {
  const part = Number.isFinite(share) ? Math.min(100 * share, 100) : 100;
  return el("span", { class: `bar ${verdict}` }, el("i", { "--share": `${part}%` }));
}

// Cases: a name is enough to link to one, unless several have it.

const CASES = PAGE.report.cases;
const sharing = new Map();
for (const each of CASES) sharing.set(each.name, (sharing.get(each.name) ?? 0) + 1);
const keyOf = (each) => (sharing.get(each.name) > 1 ? `${each.name}@${each.backend}` : each.name);
const findCase = (key) =>
  CASES.find((each) => keyOf(each) === key) ?? CASES.find((each) => each.name === key) ?? null;
// The results of one case on several backends share a card.
const sameCase = (each) => JSON.stringify([each.name, each.kind, each.node, each.target]);
const together = (cases) => {
  const groups = new Map();
  for (const each of cases) groups.set(sameCase(each), [...(groups.get(sameCase(each)) ?? []), each]);
  return groups;
};
const everyResult = together(CASES);
const compared = (each) => each.used !== undefined;
const usedText = (each) => (each.used === null && each.max_rel === null ? "not finite" : share(each.used));
const totalSeconds = (each) => Object.values(each.seconds).reduce((sum, part) => sum + part, 0);

// Of a large report the page holds what the wall shows; a case's record comes with its piece, when it is looked at.

const pieces = new Map();
const isWhole = (each) => each.setup !== undefined;

function loadRecord(index) {
  const number = Math.floor(index / PAGE.pieces.size);
  if (!pieces.has(number)) {
    const start = number * PAGE.pieces.size;
    const piece = loadScript(`${PAGE.pieces.folder}/${number}.js`).then((records) => {
      records.forEach((record, i) => {
        const each = CASES[start + i];
        if (each.name !== record.name || each.backend !== record.backend) throw new Error("The records are of another run");
        Object.assign(each, record);
        texts.delete(each);
      });
    });
    pieces.set(number, piece);
    piece.catch(() => pieces.delete(number));
  }
  return pieces.get(number);
}

// A search looks through the set-ups too.
async function loadEveryRecord() {
  for (let index = 0; index < CASES.length; index += PAGE.pieces.size) await loadRecord(index);
}

// The state is in the address, so that a link shows what its sender saw.

const FILTERS = ["verdict", "node", "target", "backend", "truth", "kind"];
const state = { q: "", sort: "worst", case: null, ...Object.fromEntries(FILTERS.map((name) => [name, ""])) };

function readAddress() {
  const given = new URLSearchParams(location.hash.slice(1));
  for (const name of ["q", ...FILTERS]) state[name] = given.get(name) ?? "";
  state.sort = given.get("sort") ?? "worst";
  state.case = given.get("case");
}

function addressOf(changes = {}) {
  const wanted = { ...state, ...changes };
  if (wanted.sort === "worst") wanted.sort = "";
  const query = new URLSearchParams(Object.entries(wanted).filter(([, value]) => value));
  return `#${query}`;
}

function go(changes, leaveTrace = false) {
  const target = addressOf(changes);
  Object.assign(state, changes);
  history[leaveTrace ? "pushState" : "replaceState"](null, "", target);
}

// Which cases are wanted, in which order.

const texts = new Map();
function textOf(each) {
  if (!texts.has(each)) {
    const { name, node, target, backend, truth, verdict, message, setup } = each;
    texts.set(each, [name, node, target, backend, truth, verdict, message, JSON.stringify(setup)].join("\n").toLowerCase());
  }
  return texts.get(each);
}

const ORDERS = {
  worst: ["Worst first", null],
  name: ["By name", (a, b) => (a.name < b.name ? -1 : a.name > b.name ? 1 : 0)],
  error: ["Largest error first", (a, b) => rank(b.max_rel, b) - rank(a.max_rel, a)],
  slowest: ["Slowest first", (a, b) => totalSeconds(b) - totalSeconds(a)],
};
// What layering costs is there where the run was asked for it.
const layeringOf = (each) => (each.details.layering ? (each.details.layering.max_rel ?? Infinity) : -1);
if (CASES.some((each) => each.details.layering)) ORDERS.layering = ["Largest cost of layering first", (a, b) => (layeringOf(b) > layeringOf(a)) - (layeringOf(a) > layeringOf(b))];
const rank = (value, each) => (value ?? (compared(each) ? Number.MAX_VALUE : -1));
const LAST = { skipped: 1 };

function chosen(ignoring = null) {
  const words = state.q.toLowerCase().split(/\s+/).filter(Boolean);
  const wanted = CASES.filter(
    (each) =>
      FILTERS.every((name) => name === ignoring || !state[name] || each[name] === state[name]) &&
      words.every((word) => textOf(each).includes(word)),
  );
  const order = (ORDERS[state.sort] ?? ORDERS.worst)[1];
  // The report has them worst first; what was skipped has nothing to show.
  return wanted.sort(order ?? ((a, b) => (LAST[a.verdict] ?? 0) - (LAST[b.verdict] ?? 0)));
}

// The wall: cards of one size in rows, of which only those near the window are in the document.

const wall = { element: byId("wall"), cases: [], groups: [], places: new Map(), columns: 1, current: 0, cards: new Map() };
const placeOf = (each) => wall.places.get(each) ?? -1;
const CARD = { width: 276, height: 240, gap: 14 };
const rowHeight = CARD.height + CARD.gap;

function layWall() {
  const width = wall.element.clientWidth;
  wall.columns = Math.max(1, Math.floor((width + CARD.gap) / (CARD.width + CARD.gap)));
  wall.cardWidth = (width - (wall.columns - 1) * CARD.gap) / wall.columns;
  wall.element.style.height = `${Math.max(0, Math.ceil(wall.cases.length / wall.columns) * rowHeight - CARD.gap)}px`;
  fillWall();
}

function fillWall() {
  const top = -wall.element.getBoundingClientRect().top;
  const first = Math.max(0, Math.floor(top / rowHeight) - 2) * wall.columns;
  const last = Math.min(wall.cases.length, (Math.ceil((top + innerHeight) / rowHeight) + 2) * wall.columns);
  const wanted = new Set();
  for (let index = first; index < last; index++) wanted.add(index);
  const focused = [...wall.cards].find(([, card]) => card.contains(document.activeElement))?.[0];
  if (focused !== undefined) wanted.add(focused);
  for (const [index, card] of wall.cards) {
    if (!wanted.has(index)) {
      card.remove();
      wall.cards.delete(index);
    }
  }
  const after = [...wall.cards.keys()].sort((a, b) => a - b);
  for (const index of [...wanted].sort((a, b) => a - b)) {
    let card = wall.cards.get(index);
    if (!card) {
      card = makeCard(wall.groups[index], index);
      const next = after.find((other) => other > index);
      wall.element.insertBefore(card, next === undefined ? null : wall.cards.get(next));
      wall.cards.set(index, card);
    }
    const column = index % wall.columns;
    card.style.width = `${wall.cardWidth}px`;
    card.style.transform = `translate(${column * (wall.cardWidth + CARD.gap)}px, ${Math.floor(index / wall.columns) * rowHeight}px)`;
    card.firstChild.tabIndex = index === wall.current ? 0 : -1;
  }
}

function makeCard(group, index) {
  const each = group[0];
  // A backend that drew nothing borrows the other's picture, and says why below it.
  const pictured = group.find((other) => other.files.render) ?? each;
  const pictures = ["render", "error"].filter((name) => pictured.files[name]);
  const alt = { render: `Render of ${each.name}`, error: `Error of ${each.name}` };
  const told = each.verdict === "pass" ? "" : each.message;
  let thumbs = el("p", { class: `words ${each.verdict}` }, el("span", {}, each.message || decadesInWords(each) || WORDLESS[each.verdict]));
  if (each.details.maps) thumbs = cardMaps(each.details.maps);
  else if (pictures.length) {
    thumbs = pictures.map((name) => el("img", { loading: "lazy", decoding: "async", src: address(pictured.files[name]), alt: alt[name] }));
  }
  const why = told && (each.details.maps || pictures.length) ? el("p", { class: `why ${each.verdict}`, title: told }, el("span", {}, told)) : null;
  const agree = group.every((other) => other.verdict === each.verdict);
  const pills = agree ? [pill(each.verdict)] : group.map((other) => pill(other.verdict, other.backend));
  const backends = group.map((other) => other.backend).join(", ");
  return el(
    "article",
    { class: "card", role: "listitem", "aria-posinset": index + 1, "aria-setsize": wall.cases.length },
    el(
      "a",
      { href: addressOf({ case: keyOf(each) }), "data-index": index },
      el("div", { class: "thumbs" }, thumbs, why),
      el(
        "div",
        { class: "about" },
        el("b", { title: each.name }, each.name),
        el("small", {}, [each.node, each.target, backends, each.truth === "physics" ? null : each.truth].filter(Boolean).join(" · ")),
        el("div", { class: "foot" }, pills, ...(compared(each) ? [usedBar(each.used, each.verdict), el("span", { class: "number" }, usedText(each))] : [])),
      ),
    ),
  );
}

const WORDLESS = { pass: "No pictures.", fail: "No pictures.", error: "It ended without a word; the terminal may have more.", undecided: "No pictures.", skipped: "It was not run." };

// Clouds: the largest share of the bound by alpha and by angle, small multiples without and with a thin film.

const MOST_USED = 1e9; // A map's cell has no more: as in cloud.py.
function worstOf(maps) {
  const most = maps.flatMap((map) => map.used.flat()).reduce((most, used) => Math.max(most, used ?? 0), 0);
  return most < MOST_USED ? most : Infinity;
}

// Over all films: what a card has room for.
function overFilms(maps, angle) {
  const [first, ...others] = maps.filter((map) => map.angle === angle).map((map) => map.used);
  const larger = (a, b) => (a === null ? b : b === null ? a : Math.max(a, b));
  return others.reduce((sum, rows) => sum.map((row, y) => row.map((used, x) => larger(used, rows[y][x]))), first);
}

function mapCanvas(rows, words) {
  const canvas = el("canvas", { width: rows[0].length, height: rows.length, role: "img", "aria-label": words });
  canvas.getContext("2d").putImageData(cloudPicture(rows), 0, 0);
  return canvas;
}

function cardMaps(maps) {
  return ["view", "light"].map((angle) =>
    el("div", { class: "map" }, mapCanvas(overFilms(maps, angle), `Share of the bound by alpha and the ${angle}'s angle, at most ${share(worstOf(maps))}`),
      el("span", { class: "tag left" }, `${angle} 90°`), el("span", { class: "tag foot-left" }, "0°"), el("span", { class: "tag foot-right" }, "alpha →")));
}

function decadesInWords(each) {
  if (!each.details.decades) return "";
  const parts = each.details.decades.map(
    ({ alpha, film, max_used, p999_used }) =>
      `alpha ${alpha[0]}–${alpha[1]}${film ? ", film" : ""}: ${share(Math.max(max_used ?? Infinity, p999_used ?? Infinity))}`,
  );
  return `${thousands(each.setup.configurations)} configurations. ${parts.join("; ")}.`;
}

function showWall() {
  const results = chosen();
  wall.groups = [...together(results).values()];
  wall.cases = wall.groups.map((group) => group[0]);
  wall.places = new Map(wall.groups.flatMap((group, index) => group.map((each) => [each, index])));
  wall.current = Math.max(0, Math.min(wall.current, wall.cases.length - 1));
  wall.element.replaceChildren();
  wall.cards.clear();
  layWall();
  byId("none").hidden = wall.cases.length > 0;
  byId("none-why").textContent = CASES.length ? "No case matches these filters." : "The run has no cases.";
  byId("clear").hidden = !CASES.length;
  const shared = results.length > wall.cases.length ? ` on ${thousands(wall.cases.length)} cards` : "";
  byId("shown").textContent = `${thousands(results.length)} of ${thousands(CASES.length)}${shared}`;
  showFilters();
  if (state.q && !CASES.every(isWhole)) searchSetups();
}

async function searchSetups() {
  const words = state.q;
  byId("shown").textContent += " …";
  try {
    await loadEveryRecord();
    if (state.q === words) showWall();
  } catch (error) {
    if (state.q === words) byId("shown").textContent = byId("shown").textContent.replace("…", `without their set-ups: ${error.message}`);
  }
}

function moveTo(index) {
  if (!wall.cases.length) return;
  wall.current = Math.max(0, Math.min(index, wall.cases.length - 1));
  const top = wall.element.getBoundingClientRect().top + scrollY + Math.floor(wall.current / wall.columns) * rowHeight;
  const bar = byId("filters");
  const covered = getComputedStyle(bar).position === "sticky" ? bar.offsetHeight + 8 : 8;
  if (top < scrollY + covered) scrollTo({ top: top - covered });
  else if (top + CARD.height > scrollY + innerHeight) scrollTo({ top: top + CARD.height - innerHeight + 12 });
  fillWall();
  wall.cards.get(wall.current).firstChild.focus({ preventScroll: true });
}

// The filters; a choice that would change nothing is not offered.

function makeFilters() {
  for (const name of FILTERS.slice(1)) {
    const values = [...new Set(CASES.map((each) => each[name]))].sort();
    const select = byId(`filter-${name}`);
    select.replaceChildren(el("option", { value: "" }, `Every ${name}`), ...values.map((value) => el("option", { value }, value)));
    select.hidden = values.length < 2;
    select.addEventListener("change", () => change({ [name]: select.value }));
  }
  const sort = byId("sort");
  sort.replaceChildren(...Object.entries(ORDERS).map(([value, [words]]) => el("option", { value }, words)));
  sort.addEventListener("change", () => change({ sort: sort.value }));
  byId("search").addEventListener("input", (event) => change({ q: event.target.value }));
  byId("clear").addEventListener("click", () => change({ q: "", ...Object.fromEntries(FILTERS.map((name) => [name, ""])) }));
  const counts = new Map();
  for (const each of CASES) counts.set(each.verdict, (counts.get(each.verdict) ?? 0) + 1);
  for (const [verdict, words] of Object.entries(COUNTS)) {
    const count = counts.get(verdict) ?? 0;
    if (!count && !["pass", "fail"].includes(verdict)) continue;
    byId("verdicts").append(
      el(
        "button",
        { class: `tile ${count ? verdict : ""}`, "data-verdict": verdict, "aria-pressed": "false", disabled: !count,
          onclick: () => change({ verdict: state.verdict === verdict ? "" : verdict }) },
        el("b", {}, thousands(count)),
        el("span", {}, `${SIGNS[verdict]} ${words}`),
      ),
    );
    if (count) byId("spread").append(el("i", { class: verdict, "--count": count }));
  }
  const worst = CASES.filter(compared).reduce((most, each) => (most && (most.used ?? Infinity) >= (each.used ?? Infinity) ? most : each), null);
  const facts = [[seconds(PAGE.report.summary.seconds), "in all"]];
  if (worst) facts.unshift([usedText(worst), usedText(worst) === "not finite" ? "at worst" : "of its bound, at worst"]);
  byId("verdicts").append(...facts.map(([value, words]) => el("div", { class: "tile" }, el("b", {}, value), el("span", {}, words))));
}

function showFilters() {
  for (const name of FILTERS.slice(1)) byId(`filter-${name}`).value = state[name];
  byId("sort").value = state.sort in ORDERS ? state.sort : "worst";
  if (byId("search").value !== state.q) byId("search").value = state.q;
  for (const tile of document.querySelectorAll("[data-verdict]")) {
    tile.setAttribute("aria-pressed", String(tile.dataset.verdict === state.verdict));
  }
}

function change(changes) {
  go(changes);
  wall.current = 0;
  showWall();
}

// Below the wall.

function makeTables() {
  const { environment } = PAGE.report;
  const partial = environment.partial;
  if (partial) {
    byId("partial").hidden = false;
    const why = typeof partial === "string" ? partial : Object.entries(partial).map(([name, value]) => `${name}: ${value}`).join(", ");
    byId("partial").append(el("b", {}, "This run did not finish. "), why);
  }
  const skipped = new Map();
  for (const each of CASES) {
    if (each.verdict !== "skipped") continue;
    const key = `${each.backend}: ${each.message}`;
    skipped.set(key, (skipped.get(key) ?? 0) + 1);
  }
  byId("skips").hidden = !skipped.size;
  for (const [key, count] of skipped) byId("skips").append(el("div", {}, `${thousands(count)} skipped on ${key}`));

  byId("power").hidden = !CASES.some(isNoticing);
  byId("noticed").append(...powerRows().flat());

  const clouds = [...together(CASES.filter((each) => each.details.decades)).values()];
  byId("clouds").hidden = !clouds.length;
  byId("cloud-maps").append(...clouds.map(([each]) => cloudFigure(each)));

  const rows = [["time by stage", Object.entries(PAGE.seconds).map(([stage, time]) => `${stage} ${seconds(time)}`).join(", ")], ...flatten(environment, ["gallery", "partial"])];
  byId("environment").append(...rows.map(([name, value]) => el("tr", {}, el("th", { scope: "row" }, name), el("td", { class: "number" }, value))));

  const gallery = environment.gallery ?? [];
  const strip = gallery.length ? gallery.map(sceneFigure) : pairFigures();
  byId("gallery").hidden = !strip.length;
  byId("scenes").append(...strip);
}

function sceneFigure({ title, caption, image }) {
  return el("figure", {}, el("a", { href: address(image) }, el("img", { src: address(image), alt: title })),
    el("figcaption", { title: caption ?? null }, el("b", {}, title), caption ? ` ${caption}` : ""));
}

// Without scenes: of each node a render at weight 0 beside the one at weight 1, where the suite has such a pair.
const PAIR = "-retro0";
function pairFigures() {
  const drawn = new Map(CASES.filter((each) => each.files.render).map((each) => [`${each.name}\n${each.node}`, each]));
  const pairs = new Map();
  for (const one of drawn.values()) {
    const other = one.name.endsWith(PAIR) && drawn.get(`${one.name.slice(0, -1)}1\n${one.node}`);
    if (other && (!pairs.has(one.node) || one.name.includes("a0.25"))) pairs.set(one.node, [one, other]);
  }
  return [...pairs].map(([node, pair]) =>
    el("figure", {},
      pair.map((each) => el("a", { href: addressOf({ case: keyOf(each) }) }, el("img", { src: address(each.files.render), alt: `Render of ${each.name}` }))),
      el("figcaption", {}, el("b", {}, node), " retroreflectivity 0 and 1, each at its own exposure")));
}

// A fault that each case would have noticed, by its decade; a case that notices none of 10 % is in the last row.
const FAULTS = [1e-5, 1e-4, 1e-3, 1e-2, 1e-1, Infinity];
// What is compared with a stored image has a threshold of its suite's instead.
const isNoticing = (each) => each.notices !== undefined && (each.notices !== null || each.verdict === "undecided");
function powerRows() {
  const judged = CASES.filter(isNoticing);
  const counts = FAULTS.map((limit, i) => judged.filter(({ notices }) => (notices ?? Infinity) <= limit && (i === 0 || (notices ?? Infinity) > FAULTS[i - 1])).length);
  const words = (i) => (i === 0 ? `up to ${share(FAULTS[0])}` : i === FAULTS.length - 1 ? `more than ${share(FAULTS[i - 1])}` : `${share(FAULTS[i - 1])} to ${share(FAULTS[i])}`);
  return counts.map((count, i) => [
    el("span", { class: "quiet" }, words(i)),
    usedBar(count / Math.max(...counts, 1), i < FAULTS.length - 1 ? "pass" : "undecided"),
    el("span", { class: "number" }, thousands(count)),
  ]);
}

function cloudFigure(each) {
  const { distribution, masking, configurations } = each.setup;
  return el("figure", {},
    el("a", { href: addressOf({ case: keyOf(each) }) }, each.details.maps ? cardMaps(each.details.maps) : decadesInWords(each)),
    el("figcaption", {}, el("b", {}, each.node), el("br"), `${distribution}, ${masking} · ${thousands(configurations)} · ${usedText(each)}`));
}

function decadesOf(each, low) {
  return each.details.decades
    .filter(({ alpha }) => alpha[0] === low)
    .map(({ max_rel, p999_rel, max_used, p999_used, film }) => {
      const used = Math.max(max_used ?? Infinity, p999_used ?? Infinity);
      return [
        el("div", { class: "decade number" }, el("span", {}, figure(max_rel)), el("span", {}, figure(p999_rel)),
          el("span", { class: "quiet" }, share(used)), el("span", { class: "quiet" }, film ? "film" : "")),
        usedBar(used, used <= 1 ? "pass" : "fail"),
      ];
    });
}

function flatten(tree, without = []) {
  return Object.entries(tree)
    .filter(([name]) => !without.includes(name))
    .flatMap(([name, value]) => (value !== null && typeof value === "object" && !Array.isArray(value) ? flatten(value) : [[name, words(value)]]));
}

function words(value) {
  if (Array.isArray(value)) return value.map(words).join(", ");
  if (typeof value === "number") return numberText(value);
  return value !== null && typeof value === "object" ? JSON.stringify(value) : String(value);
}

// Counts in groups of three; what is a float32 with the digits that it has.
function numberText(value) {
  if (Number.isInteger(value)) return Math.abs(value) >= 10000 ? thousands(value) : String(value);
  return Math.fround(value) === value ? float32Text(value) : String(value);
}
