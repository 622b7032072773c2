// Compares a conductor in JavaScript with the test vectors: node check.js vectors.json
// Says what is wrong, and ends in status 1 where something is. In a browser, call `check` with the file's content.
'use strict';

const square = (x) => x * x;

// Reflectance of the index n + ik at the cosine between v and the half vector.
function fresnel(c, n, k) {
  const s = 1 - c * c, t = n * n - k * k - s, m = Math.hypot(t, 2 * n * k), a = Math.sqrt((m + t) / 2);
  const rs = (m + c * c - 2 * a * c) / (m + c * c + 2 * a * c);
  return rs * (1 + (c * c * m + s * s - 2 * a * c * s) / (c * c * m + s * s + 2 * a * c * s)) / 2;
}

// cos(theta) (1 + Lambda) of GGX (Heitz 2014, eq. 86).
function projectedArea(w, alpha) {
  return (w[2] + Math.sqrt(square(w[2]) + square(alpha[0] * w[0]) + square(alpha[1] * w[1]))) / 2;
}

// A renderer's own microfacet lobe: GGX, height-correlated Smith, v and l above the surface.
function forward({ ior, extinction, alpha }, v, l) {
  const h = v.map((x, i) => x + l[i]), c = Math.sqrt(h.reduce((sum, x) => sum + x * x, 0)) / 2;
  const [x, y, z] = h.map((each) => each / (2 * c));
  const d = 1 / (Math.PI * alpha[0] * alpha[1] * square(square(x / alpha[0]) + square(y / alpha[1]) + z * z));
  const areaV = projectedArea(v, alpha), areaL = projectedArea(l, alpha);
  const lobe = d / (4 * (areaV * l[2] + areaL * v[2] - v[2] * l[2])); // D G2 / (4 n.v n.l)
  return { f: ior.map((n, i) => lobe * fresnel(c, n, extinction[i])), pdf: d / (4 * areaV) }; // D G1 / (4 n.v)
}

// The rule: the same lobe seen from v' = 2 (n.v) n - v, blended by the weight.
function mrm(parameters, v, l) {
  const turned = [-v[0], -v[1], v[2]], r = parameters.retroreflectivity;
  const one = forward(parameters, v, l), other = forward(parameters, turned, l);
  return { f: one.f.map((x, i) => (1 - r) * x + r * other.f[i]), pdf: (1 - r) * one.pdf + r * other.pdf };
}

function check(file) {
  const near = (found, expected) => Math.abs(found - expected) <= 1e-12 * Math.max(expected, 1e-4);
  const lines = [];
  let points = 0;
  for (const { name, lobe, parameters: p, points: all } of file.cases) {
    if (lobe !== 'Conductor' || p.distribution !== 'ggx' || p.masking !== 'smith' || p.energy_compensation) continue;
    for (const q of all) {
      const { f, pdf } = mrm(p, q.v, q.l);
      points += 1;
      if (q.eval.every((x, i) => near(f[i], x)) && near(pdf, q.pdf)) continue;
      lines.push(`${name}: eval ${f} is not ${q.eval}, or pdf ${pdf} is not ${q.pdf}`);
    }
  }
  return { good: points > 0 && !lines.length, text: [...lines, `${points - lines.length} of ${points} points agree`].join('\n') };
}

if (typeof process !== 'undefined') {
  const { good, text } = check(JSON.parse(require('fs').readFileSync(process.argv[2])));
  console.log(text);
  process.exitCode = good ? 0 : 1;
}
