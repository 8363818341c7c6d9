// Beads as tubes as wide and high as they are, the nozzle's tip on their upper side: a few corners across for each point, in
// order of time. Struts are round. What is not shown is a ghost: the same corners, only the upper side, pale and seen through.
const NOTHING = [0xb9, 0xc4, 0xcf], GHOST = 0x8fa0b3, GHOSTLY = 0.16;
const UPRIGHT = 0.05;  // sine of the angle between a strut and its normal below which it stands upright
const MITRE = 0.6;  // least cosine of half an angle at which a corner is as wide as it should be
// Across a bead: how far to the side and up, of half its width and its height, and the normal there.
const SECTION = [[-1, -1, -1, 0], [-0.72, 0, -0.55, 0.84], [0.72, 0, 0.55, 0.84], [1, -1, 1, 0]];
const TOP = 1;  // of its sides: the upper one
const RING = [0, 1, 2, 3, 4, 5].map((k) => [Math.cos(k * Math.PI / 3), Math.sin(k * Math.PI / 3)]).map(([c, s]) => [c, 0.5 * s - 0.5, c, s]);

function sizeOf(lines) {
  const ends = lines.point.map((p) => p.step * 65534);
  return Math.hypot(...ends);
}

function makeBeads(THREE, lines) {
  const [x, y, z] = lines.point.map(values), wide = values(lines.wide), high = values(lines.high), n = x.length, first = lines.first;
  const section = lines.round ? RING : SECTION, across = section.length, sides = lines.round ? across : across - 1;
  const corners = new Float32Array(3 * across * n), normals = new Int8Array(3 * across * n), last = new Uint8Array(n);
  for (let k = 0; k < first.length; k++) last[(k + 1 < first.length ? first[k + 1] : n) - 1] = 1;
  const thick = lines.thick || 1;
  for (let i = 0, start = true, at = 0; i < n; i++) {
    const a = start ? i : i - 1, b = last[i] ? i : i + 1;
    // directions before and behind the point, their sum, and how much wider a corner is between them
    let px = x[i] - x[a], py = y[i] - y[a], pz = z[i] - z[a], qx = x[b] - x[i], qy = y[b] - y[i], qz = z[b] - z[i];
    const p = Math.hypot(px, py, pz) || 1, q = Math.hypot(qx, qy, qz) || 1;
    px /= p; py /= p; pz /= p; qx /= q; qy /= q; qz /= q;
    let dx = px + qx, dy = py + qy, dz = pz + qz, d = Math.hypot(dx, dy, dz);
    const mitre = start || last[i] ? 1 : 1 / Math.max(d / 2, MITRE);
    if (d < 1e-3) { dx = px || qx; dy = py || qy; dz = pz || qz; d = Math.hypot(dx, dy, dz) || 1; }
    let ux = lines.normal[3 * i], uy = lines.normal[3 * i + 1], uz = lines.normal[3 * i + 2];
    const u = Math.hypot(ux, uy, uz) || 1;
    ux /= u; uy /= u; uz /= u;
    let sx = dy * uz - dz * uy, sy = dz * ux - dx * uz, sz = dx * uy - dy * ux, s = Math.hypot(sx, sy, sz);
    if (lines.round && s < UPRIGHT * d) {  // along its normal: any side will do
      [sx, sy, sz] = Math.abs(dx) < 0.5 * d ? [0, dz, -dy] : [-dz, 0, dx];
      s = Math.hypot(sx, sy, sz);
    }
    s = s || 1;
    sx /= s; sy /= s; sz /= s;
    let vx = ux, vy = uy, vz = uz;
    if (lines.round) { vx = (sy * dz - sz * dy) / d; vy = (sz * dx - sx * dz) / d; vz = (sx * dy - sy * dx) / d; }
    const half = 0.5 * thick * wide[i], tall = thick * high[i], sunk = lines.round ? 0.5 * high[i] : 0;
    for (const [side, up, ns, nu] of section) {
      const along = side * half * (lines.round ? 1 : mitre), rise = lines.round ? (up + 0.5) * tall : up * tall;
      corners[at] = x[i] - sunk * ux + along * sx + rise * vx;
      corners[at + 1] = y[i] - sunk * uy + along * sy + rise * vy;
      corners[at + 2] = z[i] - sunk * uz + along * sz + rise * vz;
      normals[at] = 127 * (ns * sx + nu * vx);
      normals[at + 1] = 127 * (ns * sy + nu * vy);
      normals[at + 2] = 127 * (ns * sz + nu * vz);
      at += 3;
    }
    start = Boolean(last[i]);
  }
  const colours = new Uint8Array(3 * across * n).fill(200);
  const shared = {
    position: new THREE.BufferAttribute(corners, 3),
    normal: new THREE.BufferAttribute(normals, 3, true),
    color: new THREE.BufferAttribute(colours, 3, true),
  };
  const shape = (names) => {
    const geometry = new THREE.BufferGeometry();
    for (const name of names) geometry.setAttribute(name, shared[name]);
    return geometry;
  };
  const geometry = shape(["position", "normal", "color"]);
  const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide }));
  mesh.receiveShadow = true;
  const ghost = new THREE.Mesh(shape(["position"]), new THREE.MeshBasicMaterial({
    transparent: true, opacity: GHOSTLY, depthWrite: false, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 8,
  }));
  ghost.material.color.setRGB((GHOST >> 16) / 255, ((GHOST >> 8) & 255) / 255, (GHOST & 255) / 255);
  ghost.visible = false;
  let until = null, upTo = null, whole = 0, all = 0;  // samples at which pieces are there, and the corners drawn by then

  const beads = { mesh, ghost, n, point: (i) => [x[i], y[i], z[i]], pointOf: (face) => Math.floor(geometry.index.array[3 * face] / across) };

  beads.paint = (colour) => {
    for (let i = 0, at = 0; i < n; i++) {
      const [r, g, b] = colour(i);
      for (let j = 0; j < across; j++) { colours[at++] = r; colours[at++] = g; colours[at++] = b; }
    }
    shared.color.needsUpdate = true;
  };
  // Draw the pieces between points i and i + 1 for which `shows(i)` holds.
  beads.filter = (shows) => {
    const index = new Uint32Array(6 * sides * n + 12 * first.length), ends = new Int32Array(n), drawn = new Uint32Array(n);
    let k = 0, at = 0;
    const quad = (a, b, c, d) => { index[at++] = a; index[at++] = b; index[at++] = c; index[at++] = b; index[at++] = d; index[at++] = c; };
    all = 0;
    for (let i = 0, open = false; i + 1 < n; i++) {
      if (last[i]) { open = false; continue; }
      all++;
      if (!shows(i)) { open = false; continue; }
      const c = across * i;
      if (!open && !lines.round) quad(c, c + 1, c + 3, c + 2);
      open = true;
      for (let j = 0; j < sides; j++) quad(c + j, c + (j + 1) % across, c + across + j, c + across + (j + 1) % across);
      if (last[i + 1] && !lines.round) quad(c + across, c + across + 1, c + across + 3, c + across + 2);
      ends[k] = lines.sample ? lines.sample[i + 1] : 0;
      drawn[k++] = at;
    }
    geometry.setIndex(new THREE.BufferAttribute(index.slice(0, at), 1));
    until = ends.slice(0, k); upTo = drawn.slice(0, k); whole = k;
  };
  beads.upTo = (sample) => {
    const pieces = notAbove(until, sample);
    geometry.setDrawRange(0, pieces ? upTo[pieces - 1] : 0);
    ghost.visible = pieces < all;
    if (ghost.visible && !ghost.geometry.index) ghostly();
    return pieces;
  };
  function ghostly() {
    const index = new Uint32Array(6 * n), [a, b] = lines.round ? [0, 3] : [TOP, TOP + 1];
    let at = 0;
    for (let i = 0; i + 1 < n; i++) if (!last[i]) {
      const c = across * i;
      for (const each of [c + a, c + b, c + across + a, c + b, c + across + b, c + across + a]) index[at++] = each;
    }
    ghost.geometry.setIndex(new THREE.BufferAttribute(index.slice(0, at), 1));
  }
  return beads;
}
