"use strict";

const PAGE = JSON.parse(document.getElementById("data").textContent);

// Numbers of a case: unpacking them, writing them, and colouring them. Nothing below knows the page's elements.

// Loading: a page opened from a disk may run a script and may not read a file, so data.js calls `mrmCase`.

const loaded = new Map();
const KEPT = 8;

function loadScript(address) {
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = address;
    script.receive = resolve;
    script.onerror = () => reject(new Error(`${decodeURI(address)} cannot be read`));
    script.onload = () => reject(new Error(`${decodeURI(address)} holds no case`)); // Too late where it did.
    document.head.append(script);
  });
}

function loadPixels(address) {
  if (!loaded.has(address)) {
    if (loaded.size >= KEPT) loaded.delete(loaded.keys().next().value);
    const promise = loadScript(address).then(unpack);
    loaded.set(address, promise);
    promise.catch(() => loaded.delete(address));
  }
  return loaded.get(address);
}

function mrmCase(payload) {
  const script = document.currentScript;
  script.receive(payload);
  script.remove();
}

// The reverse of `page_data` in pictures.py.
async function unpack(payload) {
  const zipped = Uint8Array.from(atob(payload.packed), (character) => character.charCodeAt(0));
  const stream = new Blob([zipped]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const { width, height, source } = payload;
  const pixels = { width, height, source };
  let start = 0;
  for (const [name, size, channels] of payload.parts) {
    const count = width * height * channels;
    pixels[name] = unshuffle(bytes.subarray(start, start + count * size), count, size);
    start += count * size;
  }
  const render = pixels.render;
  // A case without a baseline has a render only.
  const reference = pixels.reference?.map((bits, i) => bits ^ render[i]);
  pixels.render = new Float32Array(render.buffer);
  if (reference) pixels.reference = new Float32Array(reference.buffer);
  for (const name of ["used", "flip"]) {
    if (pixels[name]) pixels[name] = Float32Array.from(pixels[name], halfToNumber);
  }
  return pixels;
}

function unshuffle(bytes, count, size) {
  if (size === 1) return bytes;
  const words = size === 4 ? new Uint32Array(count) : new Uint16Array(count);
  for (let place = 0; place < size; place++) {
    const plane = place * count;
    for (let i = 0; i < count; i++) words[i] |= bytes[plane + i] << (8 * place);
  }
  return words;
}

const HALF_MOST = 65504; // What is finite and larger is kept at it.

function halfToNumber(bits) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024));
}

// What can be said of one pixel.

function probe(pixels, x, y) {
  const at = y * pixels.width + x;
  const render = [...pixels.render.subarray(3 * at, 3 * at + 3)];
  const reference = pixels.reference && [...pixels.reference.subarray(3 * at, 3 * at + 3)];
  return {
    x,
    y,
    inside: pixels.mask[at] > 0,
    render,
    reference,
    error: reference && render.map((value, i) => relativeError(value, reference[i])),
    used: pixels.used?.[at],
    flip: pixels.flip?.[at],
  };
}

function relativeError(value, reference) {
  return Math.abs(value - reference) / Math.max(Math.abs(reference), PAGE.floor);
}

// Words for numbers; `figure`, `share` and `seconds` as the terminal has them.

function figure(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "not finite";
  if (value === 0) return "0";
  const [mantissa, exponent] = value.toExponential(1).split("e");
  return `${mantissa}e${Number(exponent)}`;
}

const thousands = (count) => String(count).replace(/\B(?=(\d{3})+$)/g, " ");

// More than any number: the error is not finite, or its bound is 0.
function share(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "∞ ×";
  if (value >= 1e6) return `${figure(value)} ×`;
  if (value >= 10) return `${thousands(value.toFixed(0))} ×`;
  if (value >= 0.0095) return `${(100 * value).toFixed(0)} %`;
  return value === 0 ? "0 %" : `${Number((100 * value).toPrecision(1))} %`;
}

function seconds(value) {
  if (value >= 3600) return `${thousands(Math.floor(value / 3600))} h ${Math.floor(value / 60) % 60} min`;
  if (value >= 120) return `${Math.floor(value / 60)} min ${Math.floor(value) % 60} s`;
  return value >= 1 ? `${value.toFixed(1)} s` : `${(1000 * value).toFixed(0)} ms`;
}

// The shortest text that is this float32 and no other.
function float32Text(value) {
  if (!Number.isFinite(value)) return Number.isNaN(value) ? "NaN" : value > 0 ? "+∞" : "−∞";
  for (let digits = 1; digits < 9; digits++) {
    const short = Number(value.toPrecision(digits));
    if (Math.fround(short) === value) return String(short);
  }
  return String(Number(value.toPrecision(9)));
}

function stops(value) {
  const size = Number(Math.abs(value).toFixed(2));
  return `${value > 0 ? "+" : value < 0 ? "−" : ""}${size} ${size === 1 ? "stop" : "stops"}`;
}

const RAISED = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
const raised = (power) => [...String(power)].map((sign) => RAISED[sign]).join("");

// Colours. Each function gives an ImageData of the pixels' size.

const SRGB = Uint8ClampedArray.from({ length: 16385 }, (_, i) => {
  const linear = i / 16384;
  return 255 * (linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055);
});

// As in the PNG: what is not finite is white, NaN black.
const light = (value, gain) => (Number.isNaN(value) ? 0 : Math.min(Math.max(value * gain, 0), 1e6));
const shown = (linear) => SRGB[Math.round(16384 * Math.min(Math.max(linear, 0), 1))];

// Khronos' PBR Neutral, as in tonemap.py.
function pictureOf(values, pixels, exposure) {
  const gain = 2 ** exposure;
  const start = 0.8 - 0.04;
  const room = 1 - start;
  return paint(pixels, (at, out) => {
    const [r, g, b] = [light(values[3 * at], gain), light(values[3 * at + 1], gain), light(values[3 * at + 2], gain)];
    const least = Math.min(r, g, b);
    const offset = least < 0.08 ? least - 6.25 * least * least : 0.04;
    const peak = Math.max(r, g, b) - offset;
    const compressed = peak < start ? peak : 1 - (room * room) / (peak + room - start);
    const scale = peak < start ? 1 : compressed / peak;
    const white = peak < start ? 0 : 1 - 1 / (0.15 * (peak - compressed) + 1);
    out[0] = shown((r - offset) * scale * (1 - white) + compressed * white);
    out[1] = shown((g - offset) * scale * (1 - white) + compressed * white);
    out[2] = shown((b - offset) * scale * (1 - white) + compressed * white);
  });
}

const FALSE_STOPS = [-8, 2];

// Luminance in stops, in the heat map's colours, so that equal ratios are equal steps.
function falseColours(values, pixels, exposure) {
  const [low, high] = FALSE_STOPS;
  return paint(pixels, (at, out) => {
    const luminance = 0.2126 * values[3 * at] + 0.7152 * values[3 * at + 1] + 0.0722 * values[3 * at + 2];
    ramp(HEAT, (Math.log2(luminance) + exposure - low) / (high - low), out);
  });
}

function heatOf(pixels) {
  const values = pixels.used;
  return paint(pixels, (at, out) => {
    if (values[at] <= 1) ramp(HEAT, 1 + Math.log10(values[at]) / PAGE.heat.decades, out);
    else out.set(OVER);
  });
}

// A cloud's map, the angle upwards and alpha to the right; cells without a configuration stay transparent.
function cloudPicture(rows) {
  const picture = new ImageData(rows[0].length, rows.length);
  rows.forEach((row, up) => row.forEach((used, x) => {
    if (used === null) return;
    const at = 4 * ((rows.length - 1 - up) * row.length + x);
    if (used <= 1) ramp(HEAT, 1 + Math.log10(used) / PAGE.heat.decades, picture.data.subarray(at, at + 3));
    else picture.data.set(OVER, at);
    picture.data[at + 3] = 255;
  }));
  return picture;
}

function flipOf(pixels) {
  return paint(pixels, (at, out) => ramp(HEAT, pixels.flip[at], out));
}

// The worst channel's relative error, from 1e-8 to 1.
const ERROR_DECADES = 8;

function errorsOf(pixels) {
  return paint(pixels, (at, out) => {
    let worst = 0;
    for (let i = 3 * at; i < 3 * at + 3; i++) {
      const error = relativeError(pixels.render[i], pixels.reference[i]);
      worst = error > worst || Number.isNaN(error) ? error : worst;
    }
    if (worst <= 1) ramp(HEAT, 1 + Math.log10(worst) / ERROR_DECADES, out);
    else out.set(OVER);
  });
}

// Which way it errs: red is too bright, blue too dark; `limit` gets the full colour.
function signedOf(pixels, limit) {
  return paint(pixels, (at, out) => {
    const error = signedError(pixels, at) / limit;
    if (Number.isNaN(error)) out.set(OVER);
    else ramp(SIGNED, 0.5 + 0.5 * Math.sign(error) * Math.sqrt(Math.abs(error)), out);
  });
}

function signedLimit(pixels) {
  let limit = 0;
  for (let at = 0; at < pixels.mask.length; at++) {
    const error = Math.abs(signedError(pixels, at));
    if (error > limit && Number.isFinite(error)) limit = error;
  }
  return limit || 1e-8;
}

// Of the channel that is furthest off.
function signedError(pixels, at) {
  let worst = 0;
  for (let i = 3 * at; i < 3 * at + 3; i++) {
    const reference = pixels.reference[i];
    const error = (pixels.render[i] - reference) / Math.max(Math.abs(reference), PAGE.floor);
    if (!(Math.abs(error) <= Math.abs(worst))) worst = error;
  }
  return worst;
}

const rgbOf = (text) => [1, 3, 5].map((start) => parseInt(text.slice(start, start + 2), 16));
const HEAT = PAGE.heat.stops.map(rgbOf);
const OVER = rgbOf(PAGE.heat.over);
const SIGNED = ["#3f8cff", "#16181d", "#ff5a45"].map(rgbOf);

function ramp(colours, height, out) {
  const last = colours.length - 1;
  const at = Math.min(Math.max(height, 0), 1) * last || 0;
  const step = Math.min(Math.floor(at), last - 1);
  for (let channel = 0; channel < 3; channel++) {
    out[channel] = colours[step][channel] + (at - step) * (colours[step + 1][channel] - colours[step][channel]);
  }
}

// Pixels beside the mesh stay transparent: there the page shows.
function paint(pixels, colour) {
  const picture = new ImageData(pixels.width, pixels.height);
  for (let at = 0; at < pixels.mask.length; at++) {
    if (!pixels.mask[at]) continue;
    colour(at, picture.data.subarray(4 * at, 4 * at + 3));
    picture.data[4 * at + 3] = 255;
  }
  return picture;
}
