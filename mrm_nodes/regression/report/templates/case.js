"use strict";

// The view of one case: panes that zoom and point together, and all that is known of the case below them.

const view = {
  dialog: byId("case"),
  each: null,
  pixels: null,
  mode: "side",
  wanted: null, // The mode that was chosen; a render alone is shown as it is.
  alone: false,
  map: null,
  colours: "picture",
  exposure: 0,
  zoom: { factor: 1, x: 0, y: 0 },
  spot: null,
  wipe: 0.5,
  flicker: null,
};
const ZOOMS = [1, 2, 4, 8, 16, 32];
const FLICKER_MS = 500; // Two pictures a second: below the three flashes that may harm.
const still = matchMedia("(prefers-reduced-motion: reduce)");

const MAPS = {
  used: { words: "share of bound", offered: (pixels) => pixels.used, paint: heatOf, ends: [`bound / 10${raised(PAGE.heat.decades)}`, "bound | over"], over: true },
  flip: { words: "FLIP", offered: (pixels) => pixels.flip, paint: flipOf, ends: ["0", "1"] },
  error: { words: "relative error", offered: (pixels) => pixels.reference, paint: errorsOf, ends: [`10${raised(-ERROR_DECADES)}`, "1 | over"], over: true },
  signed: { words: "signed error", offered: (pixels) => pixels.reference, paint: (pixels) => signedOf(pixels, signedLimit(pixels)), signed: true },
};

// Where there is no room for two pictures side by side, the slider has both in one.
const narrow = matchMedia("(max-width: 760px)");

function openCase(each) {
  stopFlicker();
  // The same case on another backend is looked at where this one was.
  const same = view.each && sameCase(view.each) === sameCase(each);
  view.each = each;
  view.pixels = null;
  view.exposure = each.files.exposure ?? 0;
  if (!same) {
    view.spot = null;
    view.map = null;
    resetZoom();
  }
  byId("case-name").replaceChildren(each.name, el("small", {}, [each.node, each.target, each.backend, `truth: ${each.truth}`].join(" · ")));
  byId("case-verdict").replaceChildren(pill(each.verdict));
  byId("case-message").hidden = !each.message;
  byId("case-message").className = `message ${each.verdict}`;
  byId("case-message").textContent = each.message;
  byId("previous").disabled = !neighbour(-1);
  byId("next").disabled = !neighbour(1);
  showBackends(each);
  const place = placeOf(each);
  byId("case-place").textContent = place < 0 ? "" : `${thousands(place + 1)} of ${thousands(wall.cases.length)}`;
  byId("facts").replaceChildren(...(isWhole(each) ? factsOf(each) : []));
  byId("source").hidden = true;
  showTrouble("");
  showImages(null);
  if (!view.dialog.open) view.dialog.showModal();
  if (!same) view.dialog.scrollTo(0, 0);
  byId("images").hidden = !each.files.render;
  if (!isWhole(each)) loadWhole(each);
  else if (each.files.data) loadInto(each);
}

function showBackends(each) {
  const results = everyResult.get(sameCase(each));
  byId("backends").hidden = results.length < 2;
  byId("backends").replaceChildren(...results.map((other) =>
    el("button", { "aria-pressed": String(other === each), onclick: () => { go({ case: keyOf(other) }); openCase(other); } },
      el("span", { class: other.verdict, "aria-hidden": "true" }, SIGNS[other.verdict]),
      ` ${other.backend}${compared(other) ? ` ${usedText(other)}` : ` ${other.verdict}`}`)));
}

async function loadWhole(each) {
  try {
    await loadRecord(CASES.indexOf(each));
    if (view.each === each) openCase(each);
  } catch (error) {
    byId("images").hidden = false;
    if (view.each === each) showTrouble(`${error.message}: this is what the wall shows.`);
  }
}

async function loadInto(each) {
  byId("images").hidden = false;
  try {
    const pixels = await loadPixels(address(each.files.data));
    if (view.each !== each) return;
    showImages(pixels);
    byId("source").hidden = !pixels.source;
    byId("source-text").textContent = pixels.source ?? "";
    const next = neighbour(1);
    if (next?.files.data) loadPixels(address(next.files.data)).catch(() => {}); // Told when it is looked at.
  } catch (error) {
    if (view.each === each) showTrouble(`${error.message}: these are the pictures only, without numbers.`);
  }
}

function showTrouble(text) {
  byId("trouble").hidden = !text;
  byId("trouble").textContent = text;
}

function neighbour(step) {
  return wall.cases[placeOf(view.each) + step] ?? null;
}

function stepCase(step) {
  const next = neighbour(step);
  if (!next) return;
  wall.current = placeOf(next);
  go({ case: keyOf(next) });
  openCase(next);
}

function closeCase() {
  stopFlicker();
  if (view.dialog.open) view.dialog.close();
}

// Pictures: from the numbers where they are there, the PNGs until then.

function showImages(pixels) {
  view.pixels = pixels;
  const { files } = view.each;
  view.alone = pixels ? !pixels.reference : !files.reference;
  for (const control of document.querySelectorAll("[data-pair]")) control.disabled = view.alone;
  byId("pane-map").hidden = pixels ? view.alone : !files.error;
  const side = pixels ? pixels.width / pixels.height : 1;
  byId("panes").style.setProperty("--aspect", side);
  for (const [id, name] of [["render", "render"], ["behind", "reference"], ["reference", "reference"], ["map", "error"]]) {
    byId(`layer-${id}`).replaceChildren(
      pixels
        ? el("canvas", { width: pixels.width, height: pixels.height, role: "img", "aria-label": name })
        : files[name] ? el("img", { src: address(files[name]), alt: name }) : "",
    );
  }
  for (const control of document.querySelectorAll("[data-numbers]")) control.disabled = !pixels;
  byId("map-kind").disabled = !pixels;
  byId("maps").hidden = view.alone;
  if (pixels && !view.alone) {
    const offered = Object.keys(MAPS).filter((name) => MAPS[name].offered(pixels));
    view.map = offered.includes(view.map) ? view.map : offered[0];
    byId("map-kind").replaceChildren(...offered.map((name) => el("option", { value: name }, MAPS[name].words)));
    byId("map-kind").value = view.map;
  }
  if (pixels) view.spot ??= worstPixel(pixels);
  paintAll();
  setMode(view.wanted ?? (narrow.matches ? "slider" : "side"));
  showSpot();
}

function worstPixel(pixels) {
  let worst = 0;
  let at = pixels.mask.findIndex((inside) => inside > 0);
  const values = pixels.used ?? pixels.flip;
  if (values) values.forEach((value, i) => { if (pixels.mask[i] && value > worst) [worst, at] = [value, i]; });
  return at < 0 ? null : { x: at % pixels.width, y: Math.floor(at / pixels.width) };
}

function paintAll() {
  const { pixels, exposure } = view;
  byId("exposure").textContent = stops(exposure);
  byId("false").setAttribute("aria-pressed", String(view.colours === "false"));
  for (const scale of document.querySelectorAll(".pictured")) scale.hidden = view.colours !== "false";
  for (const ends of document.querySelectorAll(".pictured .ends")) {
    ends.replaceChildren(...FALSE_STOPS.map((stop) => el("span", {}, `2${raised(stop - exposure)}`)));
  }
  if (!pixels) return;
  const colour = view.colours === "false" ? falseColours : pictureOf;
  const render = colour(pixels.render, pixels, exposure);
  const show = (id, picture) => byId(`layer-${id}`).firstChild.getContext("2d").putImageData(picture, 0, 0);
  show("render", render);
  if (view.alone) return;
  const reference = colour(pixels.reference, pixels, exposure);
  show("behind", reference);
  show("reference", reference);
  show("map", MAPS[view.map].paint(pixels));
  const map = MAPS[view.map];
  const limit = map.signed ? figure(signedLimit(pixels)) : "";
  byId("map-scale").replaceChildren(el("i", {}), ...(map.over ? [el("i", { class: "over" })] : []));
  byId("map-scale").firstChild.style.background = map.signed ? "var(--signed)" : "";
  byId("map-ends").replaceChildren(...(map.signed ? [`−${limit} too dark`, `too bright +${limit}`] : map.ends).map((end) => el("span", {}, end)));
}

function expose(change) {
  if (!view.pixels) return;
  view.exposure = change === 0 ? (view.each.files.exposure ?? 0) : view.exposure + change;
  paintAll();
}

function toggleColours() {
  if (!view.pixels) return;
  view.colours = view.colours === "false" ? "picture" : "false";
  paintAll();
}

function chooseMap(name) {
  if (!view.pixels || view.alone) return;
  const offered = [...byId("map-kind").options].map((option) => option.value);
  view.map = name ?? offered[(offered.indexOf(view.map) + 1) % offered.length];
  byId("map-kind").value = view.map;
  paintAll();
}

// Modes: three panes, or render and reference in one, wiped or in turn.

function chooseMode(wanted) {
  view.wanted = wanted;
  setMode(wanted);
}

function setMode(wanted) {
  stopFlicker();
  const mode = view.mode = view.alone ? "side" : wanted;
  for (const name of ["side", "slider", "flicker"]) {
    byId(`mode-${name}`).setAttribute("aria-pressed", String(name === mode));
  }
  const slider = mode === "slider";
  byId("pane-reference").hidden = mode !== "side" || view.alone;
  const shown = [...document.querySelectorAll(".pane")].filter((pane) => !pane.hidden).length;
  byId("panes").style.setProperty("--panes", shown);
  byId("layer-behind").hidden = !slider;
  byId("wipe").hidden = !slider;
  byId("edge").hidden = !slider;
  byId("tag-right").hidden = !slider;
  byId("layer-render").style.visibility = "";
  setWipe(view.wipe);
  tell(mode === "side" ? "" : "render", "reference");
  byId("pane-caption").textContent = { side: "render", slider: "render | reference", flicker: still.matches ? "in turn: press f" : "in turn" }[mode];
  if (mode === "flicker") {
    byId("layer-behind").hidden = false;
    turn(true);
    if (!still.matches) view.flicker = setInterval(() => turn(), FLICKER_MS);
  }
}

function tell(left, right) {
  byId("tag-left").hidden = !left;
  byId("tag-left").textContent = left;
  byId("tag-right").textContent = right;
}

function turn(toRender = byId("layer-render").style.visibility === "hidden") {
  byId("layer-render").style.visibility = toRender ? "" : "hidden";
  byId("layer-behind").style.visibility = toRender ? "hidden" : "";
  tell(toRender ? "render" : "reference", "");
}

function stopFlicker() {
  clearInterval(view.flicker);
  view.flicker = null;
  byId("layer-behind").style.visibility = "";
}

function setWipe(share) {
  view.wipe = Math.min(Math.max(share, 0), 1);
  byId("wipe").value = Math.round(100 * view.wipe);
  byId("edge").style.setProperty("--wipe", `${100 * view.wipe}%`);
  byId("layer-render").style.clipPath = view.mode === "slider" ? `inset(0 ${100 * (1 - view.wipe)}% 0 0)` : "";
}

// Zoom: x and y are the share of the picture that lies left of and above the frame.

function resetZoom() {
  setZoom(1, 0, 0);
}

function setZoom(factor, x, y) {
  const room = 1 - 1 / factor;
  view.zoom = { factor, x: Math.min(Math.max(x, 0), room), y: Math.min(Math.max(y, 0), room) };
  byId("panes").classList.toggle("zoomed", factor > 1);
  const style = byId("panes").style;
  style.setProperty("--zoom", factor);
  style.setProperty("--x", view.zoom.x);
  style.setProperty("--y", view.zoom.y);
  byId("zoom").textContent = `${factor} ×`;
  placeSpot();
}

// Keeps the point at (u, v), shares of the frame, where it is.
function zoomBy(steps, u = 0.5, v = 0.5) {
  const { factor, x, y } = view.zoom;
  const next = ZOOMS[Math.min(Math.max(ZOOMS.indexOf(factor) + steps, 0), ZOOMS.length - 1)];
  setZoom(next, x + u / factor - u / next, y + v / factor - v / next);
}

function zoomToSpot(steps) {
  const { pixels, spot, zoom } = view;
  if (!pixels || !spot) return zoomBy(steps);
  const u = ((spot.x + 0.5) / pixels.width - zoom.x) * zoom.factor;
  const v = ((spot.y + 0.5) / pixels.height - zoom.y) * zoom.factor;
  return zoomBy(steps, Math.min(Math.max(u, 0), 1), Math.min(Math.max(v, 0), 1));
}

// The probe: one pixel, marked in every pane.

function pointAt(event, frame) {
  const box = frame.getBoundingClientRect();
  const u = (event.clientX - box.left) / box.width;
  const v = (event.clientY - box.top) / box.height;
  return { u, v, x: view.zoom.x + u / view.zoom.factor, y: view.zoom.y + v / view.zoom.factor };
}

function setSpot(x, y) {
  if (!view.pixels) return;
  const { width, height } = view.pixels;
  view.spot = { x: Math.min(Math.max(x, 0), width - 1), y: Math.min(Math.max(y, 0), height - 1) };
  showSpot();
}

function showSpot() {
  placeSpot();
  const { pixels, spot } = view;
  byId("probe").hidden = !pixels || !spot;
  if (!pixels || !spot) return;
  const found = probe(pixels, spot.x, spot.y);
  const place = [el("b", {}, `x ${found.x}, y ${found.y}`)];
  if (!found.inside) place.push("beside the mesh");
  const most = found.used === HALF_MOST ? "at least " : "";
  if (found.inside && found.used !== undefined) place.push(`${most}${share(found.used)} of its bound`);
  if (found.inside && found.flip !== undefined) place.push(` · FLIP ${found.flip.toFixed(3)}`);
  byId("probe-place").replaceChildren(...place);
  for (const [row, values, write] of [["render", found.render, float32Text], ["reference", found.reference, float32Text], ["error", found.error, figure]]) {
    byId(`probe-${row}`).hidden = !values;
    if (values) byId(`probe-${row}`).replaceChildren(el("th", { scope: "row" }, row === "error" ? "relative error" : row), ...values.map((value) => el("td", {}, write(value))));
  }
}

function placeSpot() {
  const { pixels, spot, zoom } = view;
  for (const mark of document.querySelectorAll(".spot")) {
    mark.hidden = !pixels || !spot;
    if (mark.hidden) continue;
    mark.style.left = `${100 * ((spot.x + 0.5) / pixels.width - zoom.x) * zoom.factor}%`;
    mark.style.top = `${100 * ((spot.y + 0.5) / pixels.height - zoom.y) * zoom.factor}%`;
    mark.style.setProperty("--spot", `${(100 * zoom.factor) / pixels.width}%`);
  }
}

function listenToFrame(frame) {
  let grabbed = null;
  const follow = (event) => {
    if (!view.pixels) return;
    const { x, y } = pointAt(event, frame);
    setSpot(Math.floor(x * view.pixels.width), Math.floor(y * view.pixels.height));
  };
  frame.addEventListener("pointerdown", (event) => {
    frame.setPointerCapture(event.pointerId);
    grabbed = { from: pointAt(event, frame), wipes: view.mode === "slider" && frame.id === "frame-render" };
    if (grabbed.wipes) setWipe(grabbed.from.u);
    follow(event);
  });
  frame.addEventListener("pointermove", (event) => {
    if (grabbed?.wipes) setWipe(pointAt(event, frame).u);
    else if (grabbed && view.zoom.factor > 1) {
      const { x, y } = pointAt(event, frame);
      setZoom(view.zoom.factor, view.zoom.x + grabbed.from.x - x, view.zoom.y + grabbed.from.y - y);
    }
    follow(event);
  });
  for (const end of ["pointerup", "pointercancel"]) frame.addEventListener(end, () => { grabbed = null; });
  frame.addEventListener("dblclick", resetZoom);
  frame.addEventListener("wheel", (event) => {
    event.preventDefault();
    const { u, v } = pointAt(event, frame);
    zoomBy(event.deltaY < 0 ? 1 : -1, u, v);
  }, { passive: false });
  frame.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!step || !view.spot) return;
    const far = event.shiftKey ? 10 : 1;
    setSpot(view.spot.x + far * step[0], view.spot.y + far * step[1]);
    event.preventDefault();
    event.stopPropagation();
  });
}

// What is known of the case.

function factsOf(each) {
  const facts = [];
  if (each.details.decades) facts.push(cloudFacts(each));
  if (each.details.worst_configurations) facts.push(worstFacts(each.details.worst_configurations));
  else if (compared(each)) facts.push(figureFacts(each));
  if (each.details.image_light) facts.push(imageLightFacts(each.details.image_light));
  if (each.details.layering) facts.push(layeringFacts(each.details.layering));
  facts.push(el("section", { class: "set-up" }, el("h3", {}, "Set-up"), tree(each.setup)));
  const others = Object.fromEntries(Object.entries(each.details).filter(([name]) => !["decades", "maps", "worst", "worst_configurations", "image_light", "layering"].includes(name)));
  const files = ["render_data", "reference_data", "source"].filter((name) => each.files[name]);
  facts.push(
    el("section", {}, el("h3", {}, "Truth and files"),
      tree({ truth: { physics: "physics: the evaluator", baseline: "baseline: a stored image", mirror: "mirror: the other lobe in the map turned by half a turn" }[each.truth] ?? each.truth, kind: each.kind, ...others }),
      files.length
        ? el("p", { class: "number" }, files.flatMap((name, i) => [i ? " · " : "", el("a", { href: address(each.files[name]) }, each.files[name].split("/").pop())]))
        : null),
    timeFacts(each),
  );
  return facts;
}

const NAMES = { max_rel: "largest error", p999_rel: "99.9 % below", rmse: "RMSE", flip: "FLIP, mean", hdr_flip: "HDR-FLIP, mean", max_abs: "largest difference" };

const boundText = (each) => (usedText(each) === "not finite" ? "Its error is not finite" : `${usedText(each)} of its bound`);

function figureFacts(each) {
  const rows = Object.entries(NAMES)
    .filter(([name]) => name in each && !(each[name] === null && ["flip", "hdr_flip"].includes(name)))
    .map(([name, label]) =>
      el("tr", {}, el("th", { scope: "row" }, label), el("td", {}, figure(each[name])), el("td", { class: "quiet" }, name in each.tolerance ? figure(each.tolerance[name]) : "")),
    );
  return el(
    "section",
    {},
    el("h3", {}, boundText(each)),
    usedBar(each.used, each.verdict),
    el("table", { class: "figures" }, el("thead", {}, el("tr", {}, el("th"), el("th", { scope: "col" }, "measured"), el("th", { scope: "col" }, each.truth === "physics" ? "bound, up to" : "bound"))), el("tbody", {}, rows)),
    el("p", { class: "quiet" }, `${thousands(each.pixels)} pixels, ${thousands(each.lit)} lit${each.notices ? `; would notice ${share(each.notices)}` : ""}`),
  );
}

// How far the shader's sum over the map is from the integral: no part of the verdict.
function imageLightFacts({ samples, points, mean, mean_error, rms, rms_error }) {
  const percent = (value) => `${(100 * value).toFixed(2)} %`;
  const row = (label, value, error) => el("tr", {}, el("th", { scope: "row" }, label), el("td", {}, percent(value)), el("td", { class: "quiet" }, `± ${percent(error)}`));
  return el("section", {}, el("h3", {}, "Image light beside its integral"),
    mean === undefined ? null : el("table", { class: "figures" }, el("tbody", {}, row("mean", mean, mean_error), row("RMS", rms, rms_error))),
    el("p", { class: "quiet" }, `the sum over ${thousands(samples)} samples, at ${thousands(points)} points, with the integral's standard error; no part of the verdict`));
}

// What the host's rule of layering costs the material: no part of the verdict, which is by that rule.
function layeringFacts({ max_rel, mean_rel }) {
  const row = (label, value) => el("tr", {}, el("th", { scope: "row" }, label), el("td", {}, value === null ? "not finite" : `${Number((100 * value).toPrecision(2))} %`));
  return el("section", {}, el("h3", {}, "MaterialX's layering beside the exact rule"),
    el("table", { class: "figures" }, el("tbody", {}, row("at most", max_rel), row("mean", mean_rel))),
    el("p", { class: "quiet" }, `of the reference, relative to what it is where a base has what its top does not scatter, or to ${figure(PAGE.floor)} where that is less; no part of the verdict`));
}

function cloudFacts(each) {
  return el("section", { class: "wide" }, el("h3", {}, boundText(each)), usedBar(each.used, each.verdict),
    each.details.maps ? mapFacts(each.details.maps) : null,
    el("p", { class: "quiet" }, "Largest relative error, what 99.9 % stay below, and the shares of both bounds."),
    el("div", { class: "facts" }, PAGE.decades.map(([low, high]) => el("div", {}, el("b", { class: "number" }, `alpha ${low} … ${high}`), decadesOf(each, low)))));
}

// Small multiples: one scale for all, so that they can be compared.
function mapFacts(maps) {
  const alphas = [PAGE.decades[0][0], ...PAGE.decades.map((decade) => decade[1])];
  return [
    el("p", { class: "quiet" }, "The largest share of its bound in each cell of the smaller alpha and of an angle to the normal. A light below the horizon counts at 90°. The verdict asks for the second bound too, below."),
    el("div", { class: "maps" }, maps.map(({ angle, film, used }) => {
      const most = `at most ${share(worstOf([{ used }]))}`;
      const which = `${film ? "with" : "without"} a film`;
      return el("figure", { class: "multiple" },
        el("figcaption", {}, el("b", {}, `the ${angle}'s angle`), ` · ${which}`),
        el("div", { class: "grid" },
          el("div", { class: "axis up" }, ["90°", "60°", "30°", "0°"].map((text) => el("span", {}, text))),
          mapCanvas(used, `Share of the bound by alpha and the ${angle}'s angle, ${which}, ${most}`),
          el("div", { class: "axis along" }, alphas.map((alpha) => el("span", {}, alpha)))),
        el("div", { class: "quiet" }, `alpha · ${most}`));
    })),
    el("div", { class: "legend" }, el("div", { class: "scale" }, el("i", {}), el("i", { class: "over" })),
      el("div", { class: "ends" }, MAPS.used.ends.map((end) => el("span", {}, end)))),
  ];
}

// Each with all of its digits, so that it can be evaluated on its own.

const degreesOf = (direction) => (180 / Math.PI) * Math.acos(Math.min(Math.max(direction[2], -1), 1));
const listed = (value) => (Array.isArray(value) ? value : [value]).map((each) => (each === null ? "not finite" : float32Text(each))).join(", ");

function worstFacts(rows) {
  const inputs = Object.keys(rows[0].inputs);
  const heads = ["of its bound", "view °", "light °", ...inputs, "v", "l", "image", "reference"];
  const cells = rows.map((row) => [
    share(row.used), degreesOf(row.view).toFixed(1), degreesOf(row.light).toFixed(1), ...inputs.map((name) => listed(row.inputs[name])),
    listed(row.view), listed(row.light), listed(row.image), listed(row.reference),
  ]);
  const copy = el("button", {}, "Copy the table");
  copy.addEventListener("click", async () => {
    const text = [heads, ...cells].map((row) => row.join("\t")).join("\n");
    copy.textContent = (await copyText(text)) ? "Copied" : "Select it, and copy it by hand";
  });
  return el("section", { class: "wide" }, el("h3", {}, "Its worst configurations"),
    el("p", { class: "quiet" }, "Directions point away from the surface: normal +z, tangent +x. Numbers are float32 in full."),
    el("p", {}, copy),
    el("div", { class: "scroll", tabindex: "0" }, el("table", { class: "worst" },
      el("thead", {}, el("tr", {}, heads.map((head) => el("th", { scope: "col" }, head)))),
      el("tbody", {}, cells.map((row) => el("tr", {}, row.map((cell) => el("td", { class: "number" }, cell))))))));
}

// A page from a disk may have no clipboard; selected text can be copied there, too.
async function copyText(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const field = el("textarea", { readonly: true, "aria-label": "What is copied" }, text);
    view.dialog.append(field);
    field.select();
    const copied = document.execCommand("copy");
    field.remove();
    return copied;
  }
}

function timeFacts(each) {
  const times = Object.entries(each.seconds);
  const longest = Math.max(...times.map(([, time]) => time), 1e-9);
  return el("section", {}, el("h3", {}, `Time: ${seconds(totalSeconds(each))}`),
    el("div", { class: "times" }, times.map(([stage, time]) => [el("span", { class: "quiet" }, stage), usedBar(time / longest, "quiet"), el("span", { class: "number" }, seconds(time))])));
}

function tree(values) {
  return el("dl", {}, rowsOf(values));
}

// A group's name has a line of its own, and its members are rows like any other.
function rowsOf(values) {
  return Object.entries(values)
    .filter(([, value]) => value !== null && value !== "" && !(typeof value === "object" && !Object.keys(value).length))
    .map(([name, value]) => {
      if (typeof value === "object" && !Array.isArray(value)) {
        return [el("dt", { class: "group" }, name), rowsOf(value)];
      }
      const long = Array.isArray(value) && value.some((part) => typeof part === "string" && part.length > 12);
      return [el("dt", {}, name), long ? el("dd", {}, value.map((part) => el("div", { title: part }, brief(words(part))))) : el("dd", { title: words(value) }, brief(words(value)))];
    });
}

// Cameras and lights are written as Python has them: four digits are enough to read, and what is not set is not told.
function brief(text) {
  if (!/^\w+\(.*\)$/.test(text)) return text;
  return text.replace(/, \w+=None\b/g, "").replace(/\d+\.\d{4,}(e[+-]?\d+)?/g, (number) => String(Number(Number(number).toPrecision(4))));
}
