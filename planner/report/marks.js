// Marks in the scene: letters of places as buttons over the canvas, dips as white discs with a black rim on the part, hardly
// wider than a bead: the larger, the more time they cost.
const RIM = 14, DISC = [0.0022, 0.0052], LIFT = 0.0012;  // corners of a disc; its least and greatest radius, and its height, of the size of the print
const ROOM = 24;  // px between letters

function makeDips(stage, dips) {
  if (!dips) return null;
  const { THREE, size } = stage, count = dips.sample.length, corners = [], colours = [], faces = [];
  for (let k = 0; k < count; k++) {
    const p = new THREE.Vector3().fromArray(dips.point, 3 * k), n = new THREE.Vector3().fromArray(dips.normal, 3 * k);
    const a = new THREE.Vector3(Math.abs(n.x) < 0.9 ? 1 : 0, Math.abs(n.x) < 0.9 ? 0 : 1, 0).cross(n).normalize();
    const b = n.clone().cross(a), base = corners.length / 3;
    for (const [radius, lift, shade] of [[1, 1, 0], [0.6, 1.25, 255]]) {
      const c = p.clone().addScaledVector(n, LIFT * lift * size), from = corners.length / 3;
      corners.push(c.x, c.y, c.z);
      for (let i = 0; i < RIM; i++) {
        const angle = 2 * Math.PI * i / RIM, r = (DISC[0] + dips.cost[k] * (DISC[1] - DISC[0])) * radius * size;
        const v = c.clone().addScaledVector(a, r * Math.cos(angle)).addScaledVector(b, r * Math.sin(angle));
        corners.push(v.x, v.y, v.z);
        faces.push(from, from + 1 + i, from + 1 + (i + 1) % RIM);
      }
      for (let i = 0; i <= RIM; i++) colours.push(shade, shade, shade);
    }
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners), 3));
  geometry.setAttribute("color", new THREE.BufferAttribute(new Uint8Array(colours), 3, true));
  const mesh = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ vertexColors: true, side: THREE.DoubleSide }));
  stage.part.add(mesh);
  const perDip = 2 * RIM;
  return {
    mesh,
    dipOf: (face) => Math.floor(geometry.index.array[3 * face] / (2 * (RIM + 1))),
    // Those of which `shows(dip)` holds, which are in order of time, up to a sample.
    filter(shows) {
      const index = [], shown = [];
      for (let k = 0; k < count; k++) if (shows(k)) {
        shown.push(dips.sample[k]);
        for (let i = 0; i < 3 * perDip; i++) index.push(faces[3 * perDip * k + i]);
      }
      geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(index), 1));
      this.shown = shown;
    },
    upTo(sample) { geometry.setDrawRange(0, 3 * perDip * notAbove(this.shown, sample)); },
  };
}

// Letters over the canvas; several at one moment share a button. They follow the camera by `place()`.
function makeLetters(stage, places, chosen) {
  const layer = document.getElementById("letters");
  const groups = new Map();
  places.forEach((place, k) => {
    if (!place.letter) return;
    const key = place.point.join();
    groups.set(key, [...(groups.get(key) || []), k]);
  });
  const buttons = [...groups.values()].map((group) => {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "letter " + places[group[0]].kind;
    button.textContent = group.map((k) => places[k].letter).join(" ");
    button.setAttribute("aria-label", group.map((k) => places[k].what + ", " + places[k].value).join("; "));
    button.title = button.getAttribute("aria-label");
    button.tabIndex = -1;  // the list beside the scene is reached by the keyboard
    button.addEventListener("click", () => chosen(group[0]));
    layer.appendChild(button);
    return { button, group, point: places[group[0]].point, normal: places[group[0]].normal };
  });
  const { world } = stage;
  // A letter gives way to those before it in the list, which matter more, until the camera comes closer.
  function place() {
    const taken = [];
    const width = stage.div.clientWidth, height = stage.div.clientHeight;
    for (const { button, group, point, normal } of buttons) {
      const at = stage.inView(point), out = stage.along(normal), eye = world.camera.position.clone().sub(at);
      const on = at.project(world.camera), visible = on.z < 1 && Math.abs(on.x) < 1 && Math.abs(on.y) < 1;
      const left = (0.5 + 0.5 * on.x) * width, top = (0.5 - 0.5 * on.y) * height, own = group.includes(stage.chosen);
      button.hidden = !visible || (!own && taken.some(([x, y]) => Math.abs(x - left) < ROOM && Math.abs(y - top) < ROOM));
      button.classList.toggle("behind", eye.dot(out) < 0);
      if (button.hidden) continue;
      taken.push([left, top]);
      button.style.transform = `translate(${left}px, ${top}px)`;
    }
  }
  stage.viewer.on(stage.viewer.events.RENDERED, place);
  return { show: (yes) => { layer.hidden = !yes; } };
}
