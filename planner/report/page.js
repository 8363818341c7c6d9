// The page: the scene first, for it is what is looked at; then the charts.
const by = (id) => document.getElementById(id);
const SHOWN_TIME = 400;  // ms in which another page shows the first picture, before the charts take the time

function sceneFails(why) {
  by("view").hidden = true;
  document.querySelectorAll("#stage .needs-scene").forEach((each) => { each.hidden = true; });
  by("no-scene").hidden = false;
  by("no-scene-why").textContent = why;
}

function drawScene(scene, told) {
  const motion = makeMotion(scene), stage = makeStage(by("view"), scene, window.k3d, motion);
  const dips = makeDips(stage, scene.dips), places = scene.places;
  let player = null, colours = null, letters = null;

  function card(lines, letter) {
    by("card").replaceChildren(...lines.filter(Boolean).map((text, k) => {
      const p = document.createElement(k ? "p" : "strong");
      p.textContent = (k || !letter ? "" : letter + "  ") + text;
      return p;
    }));
    by("card-box").hidden = false;
  }
  function mark(k) {
    stage.chosen = k;
    document.querySelectorAll("[data-place]").forEach((b) => b.setAttribute("aria-pressed", String(Number(b.dataset.place) === k)));
  }
  function go(k, atOnce) {
    const place = places[k];
    if (player) { player.play(false); player.seek(place.t); }
    stage.paintPair(place.pair);
    mark(k);
    card([place.what, place.value, place.where, ...(place.notes || []), place.help], place.letter);
    stage.fly(...closeUp(stage, place.point, place.normal), atOnce);
  }
  letters = makeLetters(stage, places, (k) => go(k));
  document.querySelectorAll("[data-place]").forEach((b) => b.addEventListener("click", () => {
    go(Number(b.dataset.place));
    if (b.closest("td, th") && matchMedia("(max-width: 900px)").matches) by("view").scrollIntoView({ behavior: calm() ? "auto" : "smooth", block: "center" });
  }));
  by("card-close").addEventListener("click", () => { by("card-box").hidden = true; mark(-1); stage.paintPair([]); stage.draw(); });
  document.querySelectorAll("[data-view]").forEach((b) => b.addEventListener("click", () => stage.fly(...viewOf(stage, scene, b.dataset.view))));

  const refresh = () => (player ? player.show() : (stage.at(0), stage.draw()));
  by("ride").addEventListener("change", () => {
    const { camera, controls } = stage.world;
    const turn = new stage.THREE.Matrix4().copy(stage.part.matrixWorld).invert();
    stage.riding = by("ride").value === "part";
    refresh();
    turn.premultiply(stage.part.matrixWorld);  // the camera keeps its place by the part
    stage.fly(camera.position.clone().applyMatrix4(turn), controls.target.clone().applyMatrix4(turn), true);
  });
  by("ride").disabled = !(motion && motion.turns);
  by("through").addEventListener("change", (e) => { stage.seeThrough(e.target.checked); stage.draw(); });
  by("robots").addEventListener("change", (e) => { stage.showRobots(e.target.checked); stage.draw(); });
  by("robots").disabled = !scene.cell;
  if (by("letters-shown")) by("letters-shown").addEventListener("change", (e) => letters.show(e.target.checked));

  if (stage.beads) {
    player = makePlayer(stage, scene, places, told);
    colours = makeColours(stage, scene, () => player.show());
    player.dips = colours.dips = dips;
    stage.viewer.on(stage.viewer.events.MOUSE_CLICK, (at) => {
      const ray = stage.world.raycaster;
      ray.setFromCamera(at, stage.world.camera);
      const bodies = stage.bodies.filter((b) => b.mesh.visible).map((b) => b.mesh);
      const [hit] = ray.intersectObjects([...(dips ? [dips.mesh] : []), stage.beads.mesh, ...bodies], false);
      if (!hit) return;
      if (bodies.includes(hit.object)) {
        card([stage.bodies.find((b) => b.mesh === hit.object).name], "");
      } else if (dips && hit.object === dips.mesh) {
        const k = dips.dipOf(hit.faceIndex);
        player.seek(scene.dips.sample[k] * scene.dt);
        card(["Dip in speed", ...scene.dips.words[k]], "");
      } else {
        const i = stage.beads.pointOf(hit.faceIndex);
        player.seek(scene.lines.sample[i] * scene.dt);
        card([by("clock").textContent, ...colours.words(i)], "");
      }
      mark(-1);
    });
    player.t = places.length ? places[0].t : scene.end;
    colours.start();
  } else {
    refresh();
  }
  if (places.length && places[0].kind === "fail") go(0, true);
  const failed = places.length > 0 && places[0].kind === "fail";
  if (!failed || !stage.beads) {
    const [eye, target] = viewOf(stage, scene, stage.beads ? "print" : "cell");
    stage.light(eye.clone().sub(target));
    stage.fly(eye, target, true);
  } else {
    stage.light(stage.world.camera.position.clone().sub(stage.world.controls.target));
  }
  // It opens with the print being laid, unless there is something else to see, or somebody wants no movement.
  const opens = () => {
    if (!player || failed || calm() || window.parent !== window) return;
    player.seek(0);
    player.play(true);
  };
  return { stage, motion, player, dips, lines: scene.lines, go, opens, seek: (t) => { player.play(false); player.seek(t); } };
}

// Rows of the list that hold a word; headings of groups without any go with them.
function filterRows() {
  const find = by("find");
  if (!find) return;
  find.addEventListener("input", () => {
    const word = find.value.trim().toLowerCase(), groups = find.closest("details").querySelectorAll(".judged tbody");
    let count = 0;
    for (const group of groups) {
      let any = false;
      for (const row of group.querySelectorAll("tr:not(.group)")) {
        row.hidden = !row.textContent.toLowerCase().includes(word);
        if (!row.hidden) { any = true; count++; }
      }
      group.hidden = !any;
    }
    by("found").textContent = word ? count + (count === 1 ? " row" : " rows") : "";
  });
}

async function start() {
  // On a phone what is folded begins so: the scene is not beside it.
  if (matchMedia("(max-width: 560px)").matches) document.querySelectorAll(".fold[open]").forEach((each) => { each.open = false; });
  filterRows();
  const root = document.documentElement;
  if (!window.DecompressionStream) {
    by("too-old").hidden = false;
    return;
  }
  const page = await figures("data");
  let scene = null, charts = null, map = null;
  const told = (t) => { if (charts) charts.at(t); if (map) map.at(t); };
  if (page.scene && !document.createElement("canvas").getContext("webgl2")) {
    sceneFails("this browser, or this computer, has no WebGL 2 to draw it.");
  } else if (page.scene) {
    window.define = (name, needs, make) => { window.k3d = make(); };  // the library asks for a loader of modules
    window.define.amd = true;
    await library("k3d-source");
    delete window.define;
    try {
      scene = drawScene(page.scene, told);
      const { viewer } = scene.stage;
      await new Promise((done) => viewer.on(viewer.events.RENDERED, done));
      performance.mark("first picture");
      root.dataset.scene = "yes";
    } catch (error) {
      console.error(error);
      sceneFails(String(error.message || error));
    }
  }
  talkToParent(scene);  // who waits for this report sees it as soon as there is a picture
  const shown = window.parent === window ? 0 : SHOWN_TIME;
  await new Promise((done) => requestAnimationFrame(() => setTimeout(done, shown)));  // the first picture before the charts
  if (page.charts.length) {
    await library("plotly-source");
    const clicked = (t) => scene && scene.player && scene.seek(t);
    charts = drawCharts(page.charts, makeLengths(page.scene), clicked);
    if (page.roll_map) map = drawRollMap(page.roll_map, clicked);
    if (scene && scene.player) told(scene.player.t);
  }
  window.report = { page, scene, charts };
  performance.mark("all drawn");
  if (scene) scene.opens();
  root.dataset.ready = "yes";
}
start();
