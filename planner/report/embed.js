// Inside another page (the live view), the report says where its reader is, and follows when it is told.
const CONTROLS = ["colour", "layers", "only", "from", "to", "grow", "ride", "robots", "through", "letters-shown", "dips", "pace"];
const AT_MOST = 100, SETTLED = 800;  // ms between messages, and until a flight of the camera has ended

function talkToParent(scene) {
  if (window.parent === window) return;
  const say = (message) => window.parent.postMessage(message, "*");  // a sandboxed page cannot name its parent
  const { stage, player, lines } = scene || {};
  let timer = 0, later = 0, before = 0;

  function state() {
    const out = { beadwise: "state", scroll: window.scrollY };
    if (!scene) return out;
    out.camera = [...stage.world.camera.position.toArray(), ...stage.world.controls.target.toArray(), 0, 0, 1];
    for (const id of CONTROLS) if (by(id)) out[id] = by(id).type === "checkbox" ? by(id).checked : by(id).value;
    if (!player) return out;
    const i = Math.max(player.pointAt(player.t), 0), at = player.lineOf(i);
    return Object.assign(out, { t: player.t, bead: lines.bead[at], s_mm: player.along[i], playing: player.playing });
  }
  function send() { timer = 0; before = performance.now(); say(state()); }
  function changed(event) {
    if (!event.isTrusted || (event.type === "pointermove" && !event.buttons)) return;  // what was told is not told back
    if (!timer) timer = setTimeout(send, Math.max(AT_MOST - (performance.now() - before), 0));
    clearTimeout(later);
    later = setTimeout(send, SETTLED);
  }
  for (const type of ["input", "change", "click", "keydown", "wheel", "pointermove"]) document.addEventListener(type, changed, { passive: true });

  function set(id, value) {
    const control = by(id);
    if (!control || control.disabled) return;
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
  }
  window.addEventListener("message", (event) => {
    if (event.source === window.parent && event.data && event.data.beadwise === "state") follow(event.data);
  });
  say({ beadwise: "ready" });
}
