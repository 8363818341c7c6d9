// Inside another page (the live view), the report says where its reader is, and follows when it is told.
const CONTROLS = ["colour", "layers", "only", "from", "to", "grow", "ride", "robots", "through", "letters-shown", "dips", "pace"];
const AT_MOST = 100, SETTLED = 800;  // ms between messages, and without a change until no more are told
const ALL = "max";  // of a slider at its end: the other plan may have more layers

function talkToParent(scene) {
  if (window.parent === window) return;
  document.documentElement.classList.add("embedded");
  const say = (message) => window.parent.postMessage(message, "*");  // a sandboxed page cannot name its parent
  const { stage, player, lines } = scene || {};
  let timer = 0, touched = 0, news = 0, before = "";

  function state() {
    const out = { beadwise: "state", scroll: window.scrollY, age: performance.now() - touched };
    if (!scene) return out;
    out.camera = [...stage.world.camera.position.toArray(), ...stage.world.controls.target.toArray(), 0, 0, 1];
    for (const control of CONTROLS.map(by)) if (control)
      out[control.id] = control.type === "checkbox" ? control.checked : control.value === control.max ? ALL : control.value;
    if (!player) return out;
    const laid = player.laying(player.t);  // nothing in travel
    return Object.assign(out, { t: player.t, playing: player.playing }, laid && { bead: lines.bead[laid.line], s_mm: player.along[laid.i] });
  }
  const keyOf = ({ t, bead, s_mm, age, ...rest }) => JSON.stringify(rest.playing ? rest : { t, ...rest });
  // What the reader does is told while it has effects: a flight of the camera goes on after its click.
  function tell() {
    const now = state(), key = keyOf(now);
    if (key !== before) {
      before = key;
      news = performance.now();
      say(now);
    } else if (performance.now() - news > SETTLED) {
      clearInterval(timer);
      timer = 0;
    }
  }
  function changed(event) {
    if (!event.isTrusted || (event.type === "pointermove" && !event.buttons)) return;  // what was told is not told back
    touched = news = performance.now();
    if (!timer) timer = setInterval(tell, AT_MOST);
  }
  for (const type of ["input", "change", "click", "keydown", "wheel", "pointermove"]) document.addEventListener(type, changed, { passive: true });

  function set(id, told) {
    const control = by(id);
    if (!control || control.disabled) return;
    const value = told === ALL && control.max ? control.max : told;
    if (control.type === "checkbox") {
      if (typeof value !== "boolean" || control.checked === value) return;
      control.checked = value;
    } else {
      const fits = control.options ? [...control.options].some((o) => o.value === value) : Number.isFinite(Number(value));
      if (typeof value !== "string" || !fits || control.value === value) return;
      control.value = value;
    }
    for (const type of ["input", "change"]) control.dispatchEvent(new Event(type));
  }
  function follow(told) {
    if (scene) for (const id of CONTROLS) if (id in told) set(id, told[id]);
    if (player) {
      const line = Number.isInteger(told.bead) ? lines.bead.indexOf(told.bead) : -1;
      if (line >= 0 && Number.isFinite(told.s_mm)) player.seek(player.timeAlong(line, told.s_mm));
      else if (Number.isFinite(told.t)) player.seek(told.t);
      if (typeof told.playing === "boolean") player.play(told.playing);
    }
    if (scene && Array.isArray(told.camera) && told.camera.length === 9 && told.camera.every(Number.isFinite)) {
      stage.viewer.setCamera(told.camera);
      stage.draw();
    }
    if (Number.isFinite(told.scroll)) window.scrollTo(0, told.scroll);
    before = keyOf(state());  // no echo
  }
  window.addEventListener("message", (event) => {
    if (event.source === window.parent && event.data && event.data.beadwise === "state") follow(event.data);
  });
  say({ beadwise: "ready", state: state() });
}
