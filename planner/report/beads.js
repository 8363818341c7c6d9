// Beads as ribbons as wide as they are, lying on the surface: two corners for each point, in order of time. Struts, which are
// round, are two ribbons across each other along their middle.
const NOTHING = [0xb9, 0xc4, 0xcf];
const UPRIGHT = 0.05;  // sine of the angle between a strut and its normal below which it stands upright
const LEAST_WIDTH = 0.0045;  // of the size of the print: narrower lines would vanish when all of it is seen

// A colour map: 256 colours from the stops of the page.
function colourMap(stops) {
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
  const out = new Uint8Array(3 * 256);
  for (let i = 0; i < 256; i++) {
    const x = i / 255, k = Math.max(stops.findIndex((s) => s[0] >= x), 1);
    const [a, b] = [stops[k - 1], stops[k]], share = (x - a[0]) / (b[0] - a[0]), from = rgb(a[1]), to = rgb(b[1]);
    for (let c = 0; c < 3; c++) out[3 * i + c] = Math.round(from[c] + share * (to[c] - from[c]));
  }
  return out;
}

function sizeOf(lines) {
  const ends = lines.point.map((p) => p.step * 65534);
  return Math.hypot(...ends);
}

function makeBeads(THREE, lines, size) {
  const [x, y, z] = lines.point.map(values), n = x.length, first = lines.first;
  const half = 0.5 * (lines.thick || 1) * Math.max(lines.width, LEAST_WIDTH * size);
  const ribbons = lines.round ? 2 : 1, sunk = lines.round ? 0.5 * lines.width : 0;
  const corners = new Float32Array(6 * n * ribbons), last = new Uint8Array(n);
  for (let k = 0; k < first.length; k++) last[(k + 1 < first.length ? first[k + 1] : n) - 1] = 1;
  const across = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  for (let i = 0, start = true; i < n; i++) {
    const a = start ? i : i - 1, b = last[i] ? i : i + 1;
    const d = [x[b] - x[a], y[b] - y[a], z[b] - z[a]];
    const u = [lines.normal[3 * i], lines.normal[3 * i + 1], lines.normal[3 * i + 2]], long = Math.hypot(...u) || 1;
    let s = across(d, u);
    if (lines.round && Math.hypot(...s) < UPRIGHT * Math.hypot(...d) * long) {  // along its normal: any side will do
      s = across(d, Math.abs(d[0]) < 0.5 * Math.hypot(...d) ? [1, 0, 0] : [0, 1, 0]);
    }
    const p = [x[i], y[i], z[i]].map((value, c) => value - sunk * u[c] / long);
    for (let r = 0; r < ribbons; r++) {
      const side = r ? across(d, s) : s, scale = half / (Math.hypot(...side) || 1), at = 6 * (r * n + i);
      for (let c = 0; c < 3; c++) {
        corners[at + c] = p[c] - scale * side[c];
        corners[at + 3 + c] = p[c] + scale * side[c];
      }
    }
    start = Boolean(last[i]);
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
  const colours = new Uint8Array(6 * n * ribbons);
  geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3, true));
  const material = new THREE.MeshBasicMaterial({ vertexColors: true, side: THREE.DoubleSide });
  const mesh = new THREE.Mesh(geometry, material);
  let until = null;  // the sample at which each drawn piece is there

  const beads = { mesh, n, point: (i) => [x[i], y[i], z[i]], pointOf: (face) => (geometry.index.array[3 * face] >> 1) % n };

  beads.paint = (colour) => {
    for (let i = 0; i < n; i++) {
      const rgb = colour(i);
      for (let at = 6 * i; at < colours.length; at += 6 * n) {
        for (let c = 0; c < 3; c++) colours[at + c] = colours[at + 3 + c] = rgb[c];
      }
    }
    geometry.attributes.color.needsUpdate = true;
  };
  // Draw the pieces between points i and i + 1 for which `shows(i)` holds.
  beads.filter = (shows) => {
    const index = new Uint32Array(6 * n * ribbons), ends = new Int32Array(n);
    let k = 0;
    for (let i = 0; i + 1 < n; i++) {
      if (last[i] || !shows(i)) continue;
      for (let r = 0; r < ribbons; r++) {
        const c = 2 * (r * n + i);
        index.set([c, c + 1, c + 2, c + 1, c + 3, c + 2], 6 * (ribbons * k + r));
      }
      ends[k++] = lines.sample ? lines.sample[i + 1] : 0;
    }
    geometry.setIndex(new THREE.BufferAttribute(index.slice(0, 6 * ribbons * k), 1));
    until = ends.slice(0, k);
  };
  beads.upTo = (sample) => geometry.setDrawRange(0, 6 * ribbons * notAbove(until, sample));
  return beads;
}
