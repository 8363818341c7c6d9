// The 3-D view: K3D's canvas and camera, with the cell, the part and the beads in it, and light of its own; metres.
const PAIR = [0xd55e00, 0x0072b2];  // told apart by all eyes
const PART = 0xe9e5da, GRID = 0xd8dfe6, GROUND = 0xf1f3f6, HERE = 0xd1495b;
const FLOOR_SIDE = 6, FLOOR_STEP = 0.25, FLOORS_APART = 1e-3;  // m
const NEAR = 0.01, FAR = 80;  // m
const FLIGHT = 600;  // ms
// Light of the sky and of the ground, of a lamp that throws shadows, and of one that goes with the camera.
const SKY = 0xffffff, FROM_BELOW = 0xb9bfc6, SKYLIGHT = 1.85, LAMP = 1.25, HEADLIGHT = 0.5;
const LAMP_ASIDE = 0.65, LAMP_UP = 0.95;  // rad: to the left of the camera, and above the horizon
const SHADOW_SIDE = 1024, SHADOW = 0.16, LAMP_AWAY = 4;  // pixels; how dark; m
const calm = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

function makeStage(div, scene, lib, motion) {
  const THREE = lib.ThreeJsProvider.THREE;
  const viewer = new lib.K3D(lib.ThreeJsProvider, div, {
    menuVisibility: false, cameraAutoFit: false, gridAutoFit: false, gridVisible: false, cameraMode: "orbit",
    cameraUpAxis: "z", cameraFov: 32, axesHelper: 0, clearColor: 0xffffff, lighting: 0, renderOnChange: false,
    logarithmicDepthBuffer: false,
  });
  const world = viewer.getWorld(), canvas = world.renderer.domElement;
  world.renderer.setPixelRatio(Math.min(devicePixelRatio || 1, 2));
  world.renderer.shadowMap.enabled = true;
  world.renderer.shadowMap.type = THREE.PCFShadowMap;
  world.renderer.shadowMap.autoUpdate = false;
  const colour = (hex) => new THREE.Color().setRGB((hex >> 16) / 255, ((hex >> 8) & 255) / 255, (hex & 255) / 255);
  const root = new THREE.Group(), part = new THREE.Group();
  for (const group of [root, part]) group.matrixAutoUpdate = false;
  world.K3DObjects.add(root);
  root.add(part);

  function surface(points, normals, corners, paint) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
    geometry.setAttribute("normal", new THREE.BufferAttribute(normals, 3, normals instanceof Int8Array));
    if (paint.length) geometry.setAttribute("color", new THREE.BufferAttribute(paint, 3, true));
    geometry.setIndex(new THREE.BufferAttribute(corners, 1));
    const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ vertexColors: paint.length > 0, side: THREE.DoubleSide }));
    mesh.castShadow = mesh.receiveShadow = true;
    return mesh;
  }
  const bodies = (scene.cell ? scene.cell.bodies : []).map((body) => {
    const axes = body.point.map(values), n = axes[0].length, points = new Float32Array(3 * n), paint = new Uint8Array(3 * n);
    const palette = body.palette.map((hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16)));
    for (let i = 0; i < n; i++) for (let c = 0; c < 3; c++) {
      points[3 * i + c] = axes[c][i];
      paint[3 * i + c] = palette[body.paint[i]][c];
    }
    const mesh = surface(points, body.normals, body.corners, paint);
    mesh.matrixAutoUpdate = false;
    root.add(mesh);
    return { mesh, own: mesh.material, name: body.name, kind: body.kind, bodies: body.bodies, joints: body.joints };
  });
  if (scene.part) {
    const mesh = surface(scene.part.points, scene.part.normals, scene.part.corners, []);
    mesh.material.color.copy(colour(PART));
    part.add(mesh);
    bodies.push({ mesh, own: mesh.material, name: "part", kind: "part", bodies: ["part"], joints: null });
  }
  const lines = scene.lines, all = [...(lines ? [lines] : []), ...scene.still];
  const size = Math.max(...all.map(sizeOf), 0.01);
  const still = scene.still.map((each) => {
    const beads = makeBeads(THREE, each), hex = parseInt(each.colour.slice(1), 16);
    beads.paint(() => [hex >> 16, (hex >> 8) & 255, hex & 255]);
    beads.filter(() => true);
    part.add(beads.mesh);
    return beads;
  });
  const beads = lines && lines.first.length ? makeBeads(THREE, lines) : null;
  if (beads) part.add(beads.mesh, beads.ghost);
  const here = new THREE.Mesh(new THREE.SphereGeometry(0.004 * size, 16, 12), new THREE.MeshBasicMaterial({ color: colour(HERE) }));
  part.add(here);
  const lamp = new THREE.DirectionalLight(0xffffff, LAMP), head = new THREE.DirectionalLight(0xffffff, HEADLIGHT);
  for (const light of [world.keyLight, world.headLight, world.fillLight, world.backLight]) if (light) light.intensity = 0;
  for (const light of world.scene.children) if (light.isAmbientLight) light.intensity = 0;
  const sky = new THREE.HemisphereLight(SKY, FROM_BELOW, SKYLIGHT);
  sky.position.set(0, 0, 1);
  root.add(sky, lamp, lamp.target);
  world.camera.add(head, head.target);
  head.target.position.set(0, 0, -1);
  if (scene.cell) {
    // What stands lowest stands on it.
    const low = Math.min(0, ...bodies.filter((b) => b.joints && b.joints[0] === b.joints[1])
      .map((b) => { b.mesh.geometry.computeBoundingBox(); return b.mesh.geometry.boundingBox.min.z; }));
    root.add(...floorOf(THREE, colour, low));
  }
  // The lamp stands to the left of where the scene is looked at from at first, and lights all that there is.
  function light(from) {
    const box = new THREE.Box3();
    bodies.forEach((b) => box.expandByObject(b.mesh));
    if (beads) box.expandByObject(beads.mesh);
    const ball = box.getBoundingSphere(new THREE.Sphere()), azimuth = Math.atan2(from.y, from.x) - LAMP_ASIDE;
    lamp.target.position.copy(ball.center);
    lamp.position.set(Math.cos(azimuth) * Math.cos(LAMP_UP), Math.sin(azimuth) * Math.cos(LAMP_UP), Math.sin(LAMP_UP))
      .multiplyScalar(LAMP_AWAY).add(ball.center);
    const eye = lamp.shadow.camera, reach = 1.15 * ball.radius;
    Object.assign(eye, { left: -reach, right: reach, top: reach, bottom: -reach, near: LAMP_AWAY - 2 * reach, far: LAMP_AWAY + 2 * reach });
    eye.updateProjectionMatrix();
    lamp.shadow.mapSize.set(SHADOW_SIDE, SHADOW_SIDE);
    lamp.shadow.normalBias = 3 * reach / SHADOW_SIDE;
    lamp.shadow.bias = -5e-4;
    lamp.shadow.intensity = 0.65;
    lamp.castShadow = true;
    world.renderer.shadowMap.needsUpdate = true;
  }

  const stage = { THREE, viewer, world, div, canvas, part, beads, still, bodies, size, light, riding: false, now: null, t: 0 };
  const put = (object, a) => { object.matrix.set(...a); object.matrixWorldNeedsUpdate = true; };
  let due = false, robots = true;
  const showBodies = () => bodies.forEach((b) => {
    const absent = b.bodies && stage.now && b.bodies.some((name) => stage.now.absent.includes(name));
    if (b.kind !== "part") b.mesh.visible = robots && !absent;
  });
  stage.draw = () => {
    if (due) return;
    due = true;
    requestAnimationFrame(() => { due = false; world.render(true); });
  };
  // Everything as it is at a time.
  stage.at = (t) => {
    let place = null;
    stage.t = t;
    if (motion) {
      const now = motion.poses(t);
      stage.now = now;
      for (const body of bodies) if (body.joints) put(body.mesh, now.carrier(body.joints));
      showBodies();
      put(part, now.part);
      put(root, stage.riding ? inverse(now.part) : STILL);
      place = moved(inverse(now.part), [now.nozzle[3], now.nozzle[7], now.nozzle[11]]);
    } else if (beads) {
      place = beads.point(Math.max(notAbove(lines.sample, t / scene.dt + 0.5) - 1, 0));
    }
    here.visible = Boolean(place && lines);
    if (place) here.position.set(...place);
    root.updateMatrixWorld(true);
    world.renderer.shadowMap.needsUpdate = true;
  };
  // Where a point and a direction of the part frame are in the view.
  stage.inView = (point) => new THREE.Vector3(...point).applyMatrix4(part.matrixWorld);
  stage.along = (direction) => new THREE.Vector3(...direction).transformDirection(part.matrixWorld);

  const pair = PAIR.map((hex) => new THREE.MeshLambertMaterial({ color: colour(hex), side: THREE.DoubleSide }));
  stage.paintPair = (names) => bodies.forEach((body) => {
    const k = names.findIndex((name) => body.bodies.includes(name));
    body.mesh.material = k < 0 ? body.own : pair[k];
  });
  stage.seeThrough = (yes) => bodies.filter((b) => b.kind === "part").forEach(({ own }) => {
    own.transparent = yes; own.opacity = yes ? 0.3 : 1; own.depthWrite = !yes;
    own.needsUpdate = true;
  });
  stage.showRobots = (yes) => {
    robots = yes;
    showBodies();
    world.renderer.shadowMap.needsUpdate = true;
  };

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

// The floor at a height: bright where the cell stands and fading away, a grid on it, and the shadows that fall on it.
function floorOf(THREE, colour, height) {
  const disc = new THREE.CircleGeometry(FLOOR_SIDE / 2, 64), paint = new Float32Array(3 * disc.attributes.position.count).fill(1);
  colour(GROUND).toArray(paint);
  disc.setAttribute("color", new THREE.BufferAttribute(paint, 3));
  const ground = new THREE.Mesh(disc, new THREE.MeshBasicMaterial({ vertexColors: true }));
  const grid = new THREE.GridHelper(FLOOR_SIDE, FLOOR_SIDE / FLOOR_STEP, GRID, GRID);
  grid.material.color = colour(GRID); grid.material.vertexColors = false;
  grid.rotation.x = Math.PI / 2;
  const shade = new THREE.Mesh(disc, new THREE.ShadowMaterial({ opacity: SHADOW }));
  shade.receiveShadow = true;
  [ground, grid, shade].forEach((each, k) => { each.position.z = height + (k - 2) * FLOORS_APART; });
  return [ground, grid, shade];
}
