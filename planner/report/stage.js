// The 3-D view: K3D's canvas, camera and lights, with the cell, the part and the beads in it; metres.
const BODY = { arm: 0xc3d2e0, head: 0x7f95ab, holder: 0xdcc79c, carried: 0xc9b587, fixture: 0xe9ecef };
const PAIR = [0xd55e00, 0x0072b2];  // told apart by all eyes
const PART = 0xe6e3da, FLOOR = 0xd5dce4, HERE = 0xd1495b;
const FLOOR_SIDE = 6, FLOOR_STEP = 0.25;  // m
const NEAR = 0.002, FAR = 80;  // m
const FLIGHT = 600;  // ms
const calm = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

function makeStage(div, scene, lib, motion) {
  const THREE = lib.ThreeJsProvider.THREE;
  const viewer = new lib.K3D(lib.ThreeJsProvider, div, {
    menuVisibility: false, cameraAutoFit: false, gridAutoFit: false, gridVisible: false, cameraMode: "orbit",
    cameraUpAxis: "z", cameraFov: 32, axesHelper: 0, clearColor: 0xffffff, lighting: 1.55, renderOnChange: false,
  });
  const world = viewer.getWorld(), canvas = world.renderer.domElement;
  world.renderer.setPixelRatio(Math.min(devicePixelRatio || 1, 2));
  const colour = (hex) => new THREE.Color().setRGB((hex >> 16) / 255, ((hex >> 8) & 255) / 255, (hex & 255) / 255);
  const root = new THREE.Group(), part = new THREE.Group();
  for (const group of [root, part]) group.matrixAutoUpdate = false;
  world.K3DObjects.add(root);
  root.add(part);

  function surface(points, corners, hex, normals) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
    if (normals) geometry.setAttribute("normal", new THREE.BufferAttribute(normals, 3));
    geometry.setIndex(new THREE.BufferAttribute(corners, 1));
    const material = new THREE.MeshLambertMaterial({ color: colour(hex), flatShading: !normals, side: THREE.DoubleSide });
    return new THREE.Mesh(geometry, material);
  }
  const bodies = (scene.cell ? scene.cell.bodies : []).map((body) => {
    const mesh = surface(body.points, body.corners, BODY[body.kind]);
    mesh.matrixAutoUpdate = false;
    root.add(mesh);
    return Object.assign({ mesh, hex: BODY[body.kind] }, body);
  });
  if (scene.part) {
    const mesh = surface(scene.part.points, scene.part.corners, PART, scene.part.normals);
    part.add(mesh);
    bodies.push({ mesh, name: "part", kind: "part", hex: PART, joints: null });
  }
  const lines = scene.lines, all = [...(lines ? [lines] : []), ...scene.still];
  const size = Math.max(...all.map(sizeOf), 0.01);
  const still = scene.still.map((each) => {
    const beads = makeBeads(THREE, each, size), hex = parseInt(each.colour.slice(1), 16);
    beads.paint(() => [hex >> 16, (hex >> 8) & 255, hex & 255]);
    beads.filter(() => true);
    part.add(beads.mesh);
    return beads;
  });
  const beads = lines && lines.first.length ? makeBeads(THREE, lines, size) : null;
  if (beads) part.add(beads.mesh);
  const here = new THREE.Mesh(new THREE.SphereGeometry(0.006 * size, 16, 12), new THREE.MeshBasicMaterial({ color: colour(HERE) }));
  part.add(here);
  if (scene.cell) {
    const floor = new THREE.GridHelper(FLOOR_SIDE, FLOOR_SIDE / FLOOR_STEP, FLOOR, FLOOR);
    floor.material.color = colour(FLOOR); floor.material.vertexColors = false;
    floor.rotation.x = Math.PI / 2;
    // What stands lowest stands on it.
    floor.position.z = Math.min(0, ...bodies.filter((b) => b.joints && b.joints[0] === b.joints[1])
      .map((b) => { b.mesh.geometry.computeBoundingBox(); return b.mesh.geometry.boundingBox.min.z; }));
    root.add(floor);
  }

  const stage = { THREE, viewer, world, div, canvas, part, beads, still, bodies, size, riding: false, now: null };
  const put = (object, a) => { object.matrix.set(...a); object.matrixWorldNeedsUpdate = true; };
  let due = false;
  stage.draw = () => {
    if (due) return;
    due = true;
    requestAnimationFrame(() => { due = false; world.render(true); });
  };
  // Everything as it is at a time.
  stage.at = (t) => {
    let place = null;
    if (motion) {
      const now = motion.poses(t);
      stage.now = now;
      for (const body of bodies) if (body.joints) put(body.mesh, now.carrier(body.joints));
      put(part, now.part);
      put(root, stage.riding ? inverse(now.part) : STILL);
      place = moved(inverse(now.part), [now.nozzle[3], now.nozzle[7], now.nozzle[11]]);
    } else if (beads) {
      place = beads.point(Math.max(notAbove(lines.sample, t / scene.dt + 0.5) - 1, 0));
    }
    here.visible = Boolean(place && lines);
    if (place) here.position.set(...place);
    root.updateMatrixWorld(true);
  };
  // Where a point and a direction of the part frame are in the view.
  stage.inView = (point) => new THREE.Vector3(...point).applyMatrix4(part.matrixWorld);
  stage.along = (direction) => new THREE.Vector3(...direction).transformDirection(part.matrixWorld);

  stage.paintPair = (names) => bodies.forEach((body) => {
    const k = names.indexOf(body.name);
    body.mesh.material.color.copy(colour(k < 0 ? body.hex : PAIR[k]));
  });
  stage.seeThrough = (yes) => bodies.filter((b) => b.kind === "part").forEach(({ mesh }) => {
    mesh.material.transparent = yes; mesh.material.opacity = yes ? 0.3 : 1; mesh.material.depthWrite = !yes;
    mesh.material.needsUpdate = true;
  });
  stage.showRobots = (yes) => bodies.forEach((b) => { if (b.kind !== "part") b.mesh.visible = yes; });

  let flight = 0;
  function look(eye, target) { viewer.setCamera([...eye, ...target, 0, 0, 1]); stage.draw(); }
  // Move the camera: eye and target are vectors of the view.
  stage.fly = (eye, target, atOnce) => {
    const camera = world.camera.position.toArray(), aim = world.controls.target.toArray(), mine = ++flight;
    if (atOnce || calm()) return look(eye.toArray(), target.toArray());
    const begin = performance.now();
    const step = (now) => {
      if (mine !== flight) return;
      const x = Math.min(Math.max((now - begin) / FLIGHT, 0), 1), share = x * x * (3 - 2 * x);
      look(camera.map((v, i) => v + share * (eye.getComponent(i) - v)), aim.map((v, i) => v + share * (target.getComponent(i) - v)));
      if (x < 1) requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  };
  canvas.addEventListener("pointerdown", () => { flight++; });
  // The wheel should scroll the page until someone takes hold of the scene.
  world.controls.enableZoom = false;
  canvas.addEventListener("pointerdown", () => { world.controls.enableZoom = true; }, { once: true });
  viewer.on(viewer.events.BEFORE_RENDER, () => {
    if (world.camera.near === NEAR) return;
    Object.assign(world.camera, { near: NEAR, far: FAR });
    world.camera.updateProjectionMatrix();
  });
  world.controls.addEventListener("change", stage.draw);
  return stage;
}
