"use strict";
// Draws what the link tells of a run, and asks for what the user's buttons stand for.
(function () {
  const { by, element } = page;
  const KINDS = { running: "good", done: "good", stopped: "bad", stopping: "bad",
    pausing: "wait", paused: "wait", repriming: "wait", "going on": "wait" };
  const WORDS = { done: "✓ Done", stopped: "✗ Stopped" };
  const HINTS = {
    running: "Pause stops the robot where it is; the extruder finishes what the board has taken.",
    paused: "Clear what is wrong, feed until it comes, wipe, and continue: the robot goes on within the bead. Heaters stay on.",
    preparing: "The program is brought to the controller.",
  };
  const BUTTONS = ["pause", "jam", "reprime", "continue", "stop"];
  let over = false;
  let shown = ""; // the newest entry of the log that is drawn
  let primed = false; // whether the fields have their first values

  const ask = (order) => page.ask(order, lost);

  function bar(id, share, text, small) {
    const row = by(id);
    row.querySelector("progress").value = share;
    row.querySelector(".figure").replaceChildren(text, element("small", { textContent: small ? "  " + small : "" }));
  }

  function part(id, told) {
    if (!told) { bar(id, 0, "–", ""); return; }
    const all = told.first === told.last ? "the only one" : "of " + told.first + " to " + told.last;
    bar(id, told.share, String(told.n), all);
  }

  function drawLines(state) {
    const kinds = { taken: "taken", "at the board": "board", "waits here": "", "to come": "later" };
    by("lines").replaceChildren(...state.lines.map((line) => element("tr", { className: kinds[line.what] },
      element("td", { className: "n", textContent: String(line.n) }),
      element("td", { textContent: line.text }), element("td", { textContent: line.what }))));
  }

  function drawLog(state) {
    const text = JSON.stringify(state.log);
    if (text === shown) return;
    shown = text;
    by("log").replaceChildren(...state.log.slice().reverse().map((note) => element("tr", {},
      element("td", { textContent: note.at }),
      element("td", { className: "short", textContent: note.what }),
      element("td", { textContent: (note.n ? "line " + note.n + (note.text ? ": " : "") : "") + note.text }))));
  }

  function drawControls(state) {
    for (const name of BUTTONS) by(name).disabled = !state.may.includes(name);
    for (const [id, limits] of [["mm", state.prime.mm_limits], ["mm_s", state.prime.mm_s_limits]]) {
      const field = by(id);
      [field.min, field.max] = limits;
      field.disabled = !state.may.includes("reprime");
      if (!primed) field.value = state.prime[id];
    }
    primed = true;
    by("hint").textContent = HINTS[state.state] || "";
  }

  function draw(state) {
    if (!state.state) return; // nothing was told yet
    over = state.state === "done" || state.state === "stopped";
    const percent = (100 * state.share).toFixed(1) + " %";
    document.title = (over ? WORDS[state.state] : percent) + " " + state.title;
    by("title").textContent = state.title;
    by("problem").textContent = state.problem;
    page.note("", false);
    by("state").className = "card " + (KINDS[state.state] || "");
    by("word").textContent = WORDS[state.state] || state.state[0].toUpperCase() + state.state.slice(1);
    by("reason").textContent = state.reason;
    bar("print", state.share, percent, state.left && !over ? state.left + " left" : "");
    part("layer", state.layer);
    part("bead", state.bead);
    bar("line", (state.line || 0) / state.of, String(state.line || 0), "of " + state.of);
    drawControls(state);
    drawLines(state);
    drawLog(state);
  }

  function lost() {
    for (const name of BUTTONS) by(name).disabled = true;
    page.note(over ? "The run is over; the link has ended." :
      "The page has lost the link. The run may go on: look at its terminal.", !over);
  }

  for (const name of ["pause", "jam", "continue"]) by(name).addEventListener("click", () => ask({ do: name }));
  by("stop").addEventListener("click", () => {
    if (confirm("Stop for good? The bead would have to be printed anew from its start.")) ask({ do: "stop" });
  });
  by("priming").addEventListener("submit", (event) => {
    event.preventDefault();
    ask({ do: "reprime", mm: Number(by("mm").value), mm_s: Number(by("mm_s").value) });
  });

  page.listen(draw, lost);
})();
