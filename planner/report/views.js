// From where the scene is looked at: so that the print is seen, and the nozzle, and nothing large stands before them.
const AROUND = 14, UPS = [0.22, 0.5], SEEN = 10, STANDS_OFF = 1e-3;  // directions tried; points of the print; m
const SLANTS = [0.7, 0.95, 1.2], AROUND_IT = 8, ABOUT = 0.07;  // rad off the normal, of close views; points looked at around a place, and how far from it, of the size of the print
const SIDEWAYS = 5, NOZZLE = 10;  // what a view from the arm's side, and the nozzle, are worth in points of the print

function viewOf(stage, scene, which) {
  const { THREE, bodies } = stage, box = new THREE.Box3();
  const print = [...bodies.filter((b) => b.kind === "part").map((b) => b.mesh), ...stage.still.map((s) => s.mesh)];
  if (stage.beads) print.push(stage.beads.mesh);
  if (which === "cell" && scene.cell) {
    bodies.filter((b) => b.kind === "arm" || b.kind === "head").forEach((b) => box.expandByObject(b.mesh));
  }
  print.forEach((mesh) => box.expandByObject(mesh));
  const ball = box.getBoundingSphere(new THREE.Sphere());
  const aspect = stage.div.clientWidth / Math.max(stage.div.clientHeight, 1);
  const fov = stage.world.camera.fov * Math.PI / 360, narrow = Math.min(fov, Math.atan(Math.tan(fov) * aspect));
  const far = ball.radius / Math.sin(narrow) * (which === "cell" ? 0.82 : 1);

  const spots = spotsOf(stage, scene), clear = sight(stage);
  const reach = scene.cell && which === "cell" ? reachOf(stage, scene) : null;
  let best = null, most = -Infinity;
  for (const up of which === "cell" ? UPS : [0.5]) for (let k = 0; k < AROUND; k++) {
    const azimuth = 2 * Math.PI * k / AROUND + 0.2;
    const from = new THREE.Vector3(Math.cos(azimuth) * Math.cos(up), Math.sin(azimuth) * Math.cos(up), Math.sin(up));
    const eye = ball.center.clone().addScaledVector(from, far);
    let score = up === UPS[0] ? 0.3 : 0;
    if (reach !== null) score += SIDEWAYS * Math.abs(Math.sin(azimuth - reach));  // an arm shows its posture from its side
    for (const spot of spots) {
      const facing = spot.out ? Math.max(from.dot(spot.out), 0) : 1;
      if (facing > 0 && clear(eye, spot.at, spot.own)) score += spot.weight * (0.4 + 0.6 * facing);
    }
    if (score > most) { most = score; best = eye; }
  }
  return [best, ball.center];
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
