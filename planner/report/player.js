// Time: the player below the scene, what it shows, and who wants to know.
const LETTER_ROOM = 0.018;  // of the slider, for a letter
const LONGEST_FRAME = 0.5;  // s that pass between two pictures at most: a page that nobody sees is not drawn, and stands still
const WATCHED = 45;  // s that a print takes at most when it is played, if there is such a pace

function makePlayer(stage, scene, places, told) {
  const by = (id) => document.getElementById(id), slider = by("time"), play = by("play"), speed = by("pace");
  const grow = by("grow"), end = scene.end, lines = scene.lines;
  const starts = lines ? Array.from(lines.first, (i) => lines.sample[i]) : [];
  const channel = lines && lines.channels.find((c) => c.key === "speed"), pace = channel && values(channel.values);
  const along = lines && values(lines.along);
  const player = { t: 0, playing: false, along };
  let before = 0;

  // The point that is laid at a time, or the last one before; -1 if there is none.
  player.pointAt = (t) => notAbove(lines.sample, t / scene.dt + 0.5) - 1;
  const lastOf = (line) => (line + 1 < lines.first.length ? lines.first[line + 1] : lines.sample.length) - 1;
  // When a place along a line is laid.
  player.timeAlong = (line, mm) => {
    const first = lines.first[line], last = lastOf(line);
    return scene.dt * lines.sample[Math.min(first + notAbove(along.subarray(first, last + 1), mm), last)];
  };
  // The line and the point that are being laid at a time; null in travel.
  player.laying = (t) => {
    const line = notAbove(starts, t / scene.dt + 0.5) - 1;
    return line < 0 || lines.sample[lastOf(line)] + 0.5 < t / scene.dt ? null : { line, i: player.pointAt(t) };
  };
  function words(t) {
    const laid = player.laying(t), event = scene.events.find(([start, long]) => start <= t && t < start + long);
    const clock = t.toFixed(2) + " s of " + end.toFixed(1) + " s";
    if (event) return clock + ", " + event[2];
    if (!laid) return clock + ", travel";
    const { line, i } = laid;
    return clock + ", layer " + (lines.layer[line] + 1) + ", bead " + lines.bead[line] + ", " + along[i].toFixed(1) +
      " mm along it, " + (pace ? pace[i].toFixed(1) + " mm/s" : "");
  }
  // Show the scene at a time, and tell the rest of the page.
  player.show = () => {
    const t = player.t;
    stage.at(t);
    const sample = grow.checked ? t / scene.dt + 0.5 : Infinity;
    if (stage.beads) stage.beads.upTo(sample);
    if (player.dips) player.dips.upTo(sample);
    slider.value = t;
    const text = words(t);
    by("clock").textContent = text;
    slider.setAttribute("aria-valuetext", text);
    stage.draw();
    told(t);
  };
  player.seek = (t) => {
    player.t = Math.min(Math.max(t, 0), end);
    player.show();
  };
  player.play = (yes) => {
    if (yes === player.playing) return;
    player.playing = yes;
    play.textContent = yes ? "❚❚" : "▶";
    play.setAttribute("aria-label", yes ? "Pause" : "Play");
    if (!yes) return;
    grow.checked = true;
    if (player.t >= end - 1e-9) player.t = 0;
    before = performance.now();
    requestAnimationFrame(step);
  };
  function step(now) {
    if (!player.playing) return;
    player.seek(player.t + Math.min(Math.max(now - before, 0) / 1000, LONGEST_FRAME) * Number(speed.value));
    before = now;
    if (player.t >= end) player.play(false); else requestAnimationFrame(step);
  }
  const usual = [...speed.options].find((option) => end / Number(option.value) <= WATCHED) || speed.options[speed.options.length - 1];
  speed.value = usual.value;
  slider.max = end;
  slider.step = scene.dt || 1;
  slider.addEventListener("input", () => { grow.checked = true; player.seek(Number(slider.value)); });
  play.addEventListener("click", () => player.play(!player.playing));
  grow.addEventListener("change", player.show);
  by("stage").addEventListener("keydown", (e) => {
    const other = e.target.matches("select, input, button, a, summary") && e.target !== slider;
    if (other || e.ctrlKey || e.metaKey || e.altKey) return;
    const jump = e.shiftKey ? 10 : 1, go = { ArrowLeft: -jump, ArrowRight: jump }[e.key];
    if (e.key === " ") player.play(!player.playing);
    else if (go) { grow.checked = true; player.seek(player.t + go); }
    else if (e.key === "Home" || e.key === "End") player.seek(e.key === "Home" ? 0 : end);
    else return;
    e.preventDefault();
  });
  // Marks over the slider: where it is slow, and letters of the places.
  const track = by("track"), share = (t) => 100 * t / (end || 1) + "%";
  const tick = (t, kind, text) => {
    const mark = document.createElement("i");
    mark.className = kind;
    mark.style.left = share(t);
    mark.textContent = text;
    track.appendChild(mark);
  };
  if (scene.dips) [...new Set(Array.from(scene.dips.sample, (s) => Math.round(s * scene.dt / end * 600)))]
    .forEach((at) => tick(at / 600 * end, "dip", ""));
  let free = -1;  // up to here letters stand already
  places.filter((place) => place.letter).sort((a, b) => a.t - b.t).forEach((place) => {
    tick(place.t, place.kind, place.t >= free ? place.letter : "");
    if (place.t >= free) free = place.t + LETTER_ROOM * end;
  });
  return player;
}
