// From where the scene is looked at: so that the print is seen, and the nozzle, and nothing large stands before them.
const AROUND = 14, UPS = [0.22, 0.5], SEEN = 10, STANDS_OFF = 1e-3;  // directions tried; points of the print; m
const SLANTS = [0.7, 0.95, 1.2], AROUND_IT = 8, ABOUT = 0.07;  // rad off the normal, of close views; points looked at around a place, and how far from it, of the size of the print
const SIDEWAYS = 5, NOZZLE = 10;  // what a view from the arm's side, and the nozzle, are worth in points of the print
const LEAST_SHARE = 0.42, ROOM_AROUND = 1.12;  // of the picture's height that a print takes at least; around print and wrist
const LOOKED_AT = [0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95];  // shares of the motion
const LEAST_HIGH = 0.15;  // m: what is seen of the scene at least, from top to bottom
const MOST_LARGER = 2.5;  // times the print's size, that what it goes through is, to be seen whole
const OFF_CENTRE = 0.16;  // of the picture, how far from its middle a print is, to make room for the arm
const BEHIND = 3;  // of the arm's last joints, which should be seen with the print

function viewOf(stage, scene, which) {
  const { THREE, bodies } = stage, whole = which === "cell" && scene.cell, ups = whole ? UPS : [0.32, 0.55, 0.8];
  const print = [...stage.still.map((s) => s.mesh), ...(stage.beads ? [stage.beads.mesh] : [])];
  if (whole || !print.length) print.push(...bodies.filter((b) => b.kind === "part").map((b) => b.mesh));
  const boxOf = (meshes) => meshes.reduce((box, mesh) => box.expandByObject(mesh), new THREE.Box3());
  const last = Math.max(0, ...bodies.filter((b) => b.kind === "arm").map((b) => b.joints[1]));
  const arm = bodies.filter((b) => b.kind === "head" || (b.kind === "arm" && (whole || b.joints[1] > last - BEHIND))).map((b) => b.mesh);
  const moments = momentsOf(stage, scene, () => boxOf(print));
  const printed = cornersOf(THREE, goneThrough(THREE, moments)), near = [...arm, ...(whole ? print : [])].flatMap((mesh) => cornersOf(THREE, boxOf([mesh])));
  const aspect = stage.div.clientWidth / Math.max(stage.div.clientHeight, 1), tan = Math.tan(stage.world.camera.fov * Math.PI / 360);
  const reach = scene.cell && stage.now ? reachOf(stage, scene) : null;
  let best = null, most = -Infinity;
  for (const up of ups) for (let k = 0; k < AROUND; k++) {
    const azimuth = 2 * Math.PI * k / AROUND + 0.2;
    const from = new THREE.Vector3(Math.cos(azimuth) * Math.cos(up), Math.sin(azimuth) * Math.cos(up), Math.sin(up));
    const right = new THREE.Vector3(-Math.sin(azimuth), Math.cos(azimuth), 0), over = from.clone().cross(right);
    const seen = (corners, way) => { const at = corners.map((c) => c.dot(way)); return [Math.min(...at), Math.max(...at)]; };
    const [own, all] = [printed, [...printed, ...near]].map((corners) => [seen(corners, right), seen(corners, over), seen(corners, from)]);
    const length = ([low, high]) => high - low;
    // As much of the arm as leaves the print large; what does not go in is cut off on the arm's side.
    const wanted = ROOM_AROUND * Math.max(length(all[1]), length(all[0]) / aspect);
    const largest = Math.max(length(own[1]) / LEAST_SHARE, ROOM_AROUND * length(own[0]) / aspect);
    const high = whole ? wanted : Math.max(Math.min(wanted, largest), LEAST_HIGH), wide = high * aspect;
    const middle = (at, room, frame) => {
      if (whole) return (room[0] + room[1]) / 2;
      const off = Math.max(OFF_CENTRE * frame - Math.max(length(at) - 0.6 * frame, 0), 0), own = (at[0] + at[1]) / 2;
      return Math.min(Math.max((room[0] + room[1]) / 2, own - off), own + off);
    };
    const target = right.clone().multiplyScalar(middle(own[0], all[0], wide))
      .addScaledVector(over, middle(own[1], all[1], high)).addScaledVector(from, (own[2][0] + own[2][1]) / 2);
    const eye = target.clone().addScaledVector(from, high / 2 / tan + (whole ? 0.45 * length(all[2]) : 0));
    let score = up === ups[0] ? 0.3 : 0;
    if (reach !== null) score += SIDEWAYS * Math.abs(Math.sin(azimuth - reach));  // an arm shows its posture from its side
    for (const { spots, clear } of moments) for (const spot of spots) {
      const facing = spot.out ? Math.max(from.dot(spot.out), 0) : 1;
      if (facing > 0 && clear(eye, spot.at, spot.own)) score += 2 * spot.weight * (0.15 + 0.85 * facing) / moments.length;
    }
    if (score > most) { most = score; best = [eye, target]; }
  }
  return best;
}

// What the print goes through while it is turned; where it is at the last moment, if that is much more.
function goneThrough(THREE, moments) {
  const size = (box) => box.getSize(new THREE.Vector3()).length(), now = moments[moments.length - 1].box;
  const all = moments.reduce((box, moment) => box.union(moment.box), new THREE.Box3());
  return size(all) > MOST_LARGER * size(now) ? now : all;
}

// What should be seen at some moments of the motion, and whether it is, by the boxes around bodies, which is quick; and the
// print's own box.
function momentsOf(stage, scene, boxOfPrint) {
  const { THREE } = stage, solid = stage.bodies.filter((b) => b.joints && b.mesh.visible), now = stage.t;
  const times = scene.motion && scene.lines ? [...LOOKED_AT.map((share) => share * scene.end), now] : [now];
  solid.forEach(({ mesh: { geometry } }) => { if (!geometry.boundingBox) geometry.computeBoundingBox(); });
  return times.map((t) => {
    stage.at(t);
    const spots = spotsOf(stage, scene), back = solid.map(({ mesh }) => mesh.matrixWorld.clone().invert());
    const start = new THREE.Vector3(), to = new THREE.Vector3(), ray = new THREE.Ray(), hit = new THREE.Vector3();
    const clear = (eye, at, own = []) => solid.every(({ mesh }, k) => {
      if (own.includes(mesh)) return true;
      start.copy(eye).applyMatrix4(back[k]); to.copy(at).applyMatrix4(back[k]);
      const length = to.distanceTo(start);
      ray.set(start, to.clone().sub(start).divideScalar(length));
      const box = mesh.geometry.boundingBox;
      return box.containsPoint(to) || !ray.intersectBox(box, hit) || hit.distanceTo(start) > length - STANDS_OFF;
    });
    return { spots, clear, box: boxOfPrint() };
  });
}

function cornersOf(THREE, { min, max }) {
  if (min.x > max.x) return [];  // of nothing
  return [0, 1, 2, 3, 4, 5, 6, 7].map((k) => new THREE.Vector3(k & 1 ? max.x : min.x, k & 2 ? max.y : min.y, k & 4 ? max.z : min.z));
}

// A close view of a place of the part frame: slantwise, from above if possible, past the nozzle.
function closeUp(stage, point, normal) {
  const { THREE } = stage, target = stage.inView(point), out = stage.along(normal), clear = sight(stage);
  const side = new THREE.Vector3(Math.abs(out.z) < 0.9 ? 0 : 1, 0, Math.abs(out.z) < 0.9 ? 1 : 0).cross(out).normalize();
  const up = out.clone().cross(side), ring = [], far = Math.max(1.2 * stage.size, 0.12);
  for (let k = 0; k < AROUND_IT; k++) {  // the nozzle stands on the place itself: what is around should be seen
    const angle = 2 * Math.PI * k / AROUND_IT, r = ABOUT * stage.size;
    ring.push(target.clone().addScaledVector(out, 5 * STANDS_OFF).addScaledVector(side, r * Math.cos(angle)).addScaledVector(up, r * Math.sin(angle)));
  }
  let best = null, most = -Infinity;
  for (const slant of SLANTS) for (let k = 0; k < AROUND; k++) {
    const angle = 2 * Math.PI * k / AROUND;
    const from = out.clone().multiplyScalar(Math.cos(slant)).addScaledVector(side, Math.sin(slant) * Math.cos(angle))
      .addScaledVector(up, Math.sin(slant) * Math.sin(angle));
    const eye = target.clone().addScaledVector(from, far);
    const score = ring.filter((spot) => clear(eye, spot)).length / 2 + from.dot(out) + 0.8 * Math.min(from.z, 0.5);
    if (score > most) { most = score; best = eye; }
  }
  return [best, target];
}

// Whether a point is seen from another one: no body stands between them but its own.
function sight(stage) {
  const ray = new stage.THREE.Raycaster(), solid = stage.bodies.filter((b) => b.mesh.visible).map((b) => b.mesh);
  return (eye, at, own = []) => {
    const way = at.clone().sub(eye), length = way.length();
    ray.set(eye, way.divideScalar(length));
    const [hit] = ray.intersectObjects(solid, false);
    return !hit || hit.distance > length - STANDS_OFF || own.includes(hit.object);
  };
}

// The direction from the arm's base to its nozzle, as an angle about the vertical of the view.
function reachOf(stage, scene) {
  const root = stage.part.parent.matrixWorld, { nozzle } = stage.now, [x, y, z] = scene.cell.screws;
  const base = new stage.THREE.Vector3(x, y, z).applyMatrix4(root), tip = new stage.THREE.Vector3(nozzle[3], nozzle[7], nozzle[11]).applyMatrix4(root);
  return Math.atan2(tip.y - base.y, tip.x - base.x);
}

// What should be seen: points of the print with the directions that they face, and where the nozzle is.
function spotsOf(stage, scene) {
  const out = [], { THREE } = stage, lines = scene.lines;
  if (stage.beads) for (let k = 0; k < SEEN; k++) {
    const i = Math.floor((k + 0.5) / SEEN * stage.beads.n), n = lines.normal;
    const normal = stage.along([n[3 * i], n[3 * i + 1], n[3 * i + 2]]);
    out.push({ at: stage.inView(stage.beads.point(i)).addScaledVector(normal, 5 * STANDS_OFF), out: normal, weight: 1 });
  }
  for (const place of scene.places.filter((p) => p.kind === "fail")) {
    const normal = stage.along(place.normal);
    out.push({ at: stage.inView(place.point).addScaledVector(normal, 5 * STANDS_OFF), out: normal, weight: SEEN });
  }
  const head = stage.bodies.filter((b) => b.kind === "head").map((b) => b.mesh);
  for (const mesh of head) {
    const at = new THREE.Box3().setFromObject(mesh).getCenter(new THREE.Vector3());
    out.push({ at, out: null, weight: NOZZLE / head.length, own: head });
  }
  return out;
}
