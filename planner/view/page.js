"use strict";
// Draws what the server tells of the view.
(function () {
  const { by, element } = page;
  const READY_TIME = 6000; // ms that a loaded report has to say that it is drawn, before it is shown all the same
  const PAINT_TIME = 200; // ms from being drawn to being on the screen
  const SIGNS = { verified: "✓ verified", failed: "✗ not verified", refused: "✗ no plan" };
  const panes = [];
  let state = null;
  let touched = 0; // when the user last did something in a report
  let kept = null; // camera, time and choices, as the report told them last

  const ask = (order) => page.ask(order, lost);

  // --- panes ---------------------------------------------------------------------------------------------

  function newPane(index) {
    const pane = { index, shown: null, coming: null, since: 0, stage: "" };
    pane.choice = element("select", { "aria-label": "Strategy of pane " + (index + 1) });
    pane.choice.addEventListener("change", () => ask({ do: "choose", pane: pane.index, strategy: pane.choice.value }));
    pane.name = element("span", { hidden: true });
    pane.draft = element("span", { className: "draft", hidden: true });
    pane.verdict = element("span", { className: "verdict", role: "status" });
    pane.bar = element("progress", { max: 1, value: 0, "aria-label": "Progress of the solve" });
    pane.words = element("span", {});
    pane.progress = element("span", { className: "progress", hidden: true }, pane.bar, pane.words);
    pane.empty = element("p", { className: "empty" });
    pane.frames = element("div", { className: "frames" }, pane.empty);
    const head = element("h2", {}, pane.choice, pane.name, pane.draft, pane.verdict, pane.progress);
    pane.root = element("section", { className: "pane", "aria-label": "Pane " + (index + 1) }, head, pane.frames);
    return pane;
  }

  function drawPane(pane, told) {
    const options = state.strategies.includes(told.strategy) ? state.strategies : [told.strategy];
    if (pane.choice.length !== options.length) {
      pane.choice.replaceChildren(...options.map((name) => element("option", { value: name, textContent: name })));
    }
    pane.choice.value = told.strategy;
    pane.choice.hidden = !state.solving;
    pane.name.hidden = state.solving;
    pane.name.textContent = "strategy " + told.strategy;
    const result = told.result, running = told.running;
    pane.verdict.className = "verdict" + (result && result.kind !== "verified" ? " bad" : "");
    pane.frames.classList.toggle("past", Boolean(result && result.old));
    pane.verdict.replaceChildren(...(result ? verdictOf(result) : []));
    pane.verdict.title = result ? result.words : "";
    pane.draft.hidden = !(result && result.draft);
    pane.draft.textContent = result && result.draft ? "Draft: " + result.draft : "";
    drawProgress(pane, running, told.waiting);
    pane.empty.hidden = Boolean(result);
    pane.empty.textContent = running || told.waiting ? "The first solve is under way." :
      state.mistake || state.trouble ? "Nothing could be solved yet: see the message above." : "Waiting for the first result.";
    pane.kind = result ? result.kind : "";
    if (result) show(pane, result.key);
  }

  function verdictOf(result) {
    const [head, ...rest] = result.words.split(": ");
    const out = [element("b", { textContent: SIGNS[result.kind] || head }), " " + rest.join(": ")];
    if (result.old) out.push(element("span", { className: "old", textContent: " (of an earlier save)" }));
    return out;
  }

  function drawProgress(pane, running, waiting) {
    pane.progress.hidden = !(running || waiting);
    const what = running ? running.job + running.stage + running.draft : "";
    if (what !== pane.stage) { pane.stage = what; pane.since = Date.now(); }
    pane.running = running;
    if (running && running.done !== null) pane.bar.value = running.done; else pane.bar.removeAttribute("value");
    tick(pane);
  }

  function tick(pane) {
    if (pane.progress.hidden) return;
    const running = pane.running;
    pane.words.textContent = !running ? "waits for the other pane" :
      (running.draft ? "draft, " + running.draft + ": " : "") + running.stage + " " +
      ((Date.now() - pane.since) / 1000).toFixed(0) + " s";
  }

  // The report that is shown stays until the new one is drawn, and stands where the old one stood.
  function show(pane, key) {
    if ((pane.coming || pane.shown || {}).key === key) return;
    if (pane.coming) pane.coming.frame.remove();
    const frame = element("iframe", { title: "Report of pane " + (pane.index + 1), className: "coming", inert: true });
    frame.setAttribute("sandbox", "allow-scripts allow-downloads");
    frame.src = "report/" + key;
    const coming = { key, frame };
    pane.coming = coming;
    pane.frames.append(frame);
    frame.addEventListener("load", () => setTimeout(() => arrived(pane, coming), READY_TIME), { once: true });
  }

  function arrived(pane, coming) {
    if (pane.coming !== coming) return;
    const past = pane.shown;
    if (pane.kind !== "refused") tell(coming); // a refusal shows its own place
    pane.shown = coming;
    pane.coming = null;
    coming.frame.inert = false;
    setTimeout(() => {
      coming.frame.classList.remove("coming");
      if (past) past.frame.remove();
    }, PAINT_TIME);
  }

  function tell(report) {
    if (!kept) return;
    report.frame.contentWindow.postMessage(kept, "*"); // a sandboxed report has no origin that could be named
  }

  window.addEventListener("message", (event) => {
    const said = event.data;
    if (!said || typeof said !== "object") return;
    for (const pane of panes) {
      const from = (report) => Boolean(report) && event.source === report.frame.contentWindow;
      if (said.beadwise === "ready") {
        if (from(pane.coming)) arrived(pane, pane.coming);
        else if (from(pane.shown)) tell(pane.shown); // a slow one, which was shown before it could listen
        else continue;
        if (!kept && said.state && pane.kind !== "refused") kept = said.state; // the other pane begins as this one
      } else if (said.beadwise === "state" && from(pane.shown)) {
        const touch = Date.now() - (Number(said.age) || 0);
        if (touch < touched) return; // what still moves in one pane, while the user is in the other by now
        touched = touch;
        kept = said;
        panes.filter((other) => other !== pane && other.shown).forEach((other) => tell(other.shown));
      }
    }
  });

  // --- messages and tables -------------------------------------------------------------------------------

  function drawMessage() {
    const mistake = state.mistake || state.trouble, box = by("message");
    box.hidden = !mistake;
    if (!mistake) { box.replaceChildren(); return; }
    const name = mistake.file.split("/").pop() + (mistake.line ? ", line " + mistake.line : "");
    const head = element("p", {}, element("strong", { textContent: (mistake.file ? name + ": " : "") +
      (mistake.field ? mistake.field + ": " : "") }), mistake.text + (mistake.hint ? " (" + mistake.hint + ")" : ""));
    const parts = [head];
    if (mistake.excerpt) {
      parts.push(element("pre", {}, element("span", { className: "line", textContent: mistake.line + "  " }), mistake.excerpt));
    }
    parts.push(...mistake.more.map((text) => element("p", { textContent: text })));
    if (state.panes.some((pane) => pane.result)) {
      parts.push(element("p", { className: "soft", textContent: "Below is the last result; it stays until this is fixed." }));
    }
    const text = parts.map((part) => part.textContent).join("\n");
    if (box.textContent.length && box.dataset.text === text) return; // said once is enough for a screen reader
    box.dataset.text = text;
    box.replaceChildren(...parts);
  }

  function drawDifferences() {
    const rows = state.differences;
    by("differences").hidden = !rows.length;
    if (!rows.length) return;
    by("left").textContent = state.panes[0].strategy;
    by("right").textContent = state.panes[1].strategy;
    const cell = (text, better) => element("td", { className: "n" + (better ? " better" : "") }, (better ? "✓ " : "") + text);
    by("figures").replaceChildren(...rows.map((row) => element("tr", {},
      element("th", { scope: "row", textContent: row.label }),
      cell(row.left, row.better === "left"), cell(row.right, row.better === "right"),
      element("td", { className: "n", textContent: row.difference }))));
  }

  function drawHistory() {
    const history = state.history;
    const head = ["#", "what was changed", "strategy", "verdict"].map((text) => element("th", { scope: "col", textContent: text }));
    by("columns").replaceChildren(...head, ...history.columns.map((column) =>
      element("th", { scope: "col", className: "n", textContent: column.label })));
    by("rows").replaceChildren(...history.rows.map(historyRow));
    by("history").hidden = !history.rows.length;
    const count = history.rows.length ? history.rows[0].number : 0;
    by("summary").textContent = (state.differences.length ? "Differences and history" : "History") +
      " (" + count + (count === 1 ? " solve)" : " solves)");
    by("tables").hidden = !count;
  }

  function historyRow(row) {
    const changes = row.changes === null ? ["first"] : row.changes.length ? row.changes : ["nothing"];
    const cells = row.cells.map((cell) => {
      const sign = { better: "▲ better ", worse: "▼ worse " }[cell.verdict] || "";
      const small = cell.change ? [element("small", { className: cell.verdict, title: sign.trim() }, sign.slice(0, 2) + cell.change)] : [];
      return element("td", { className: "n" }, cell.text, ...small);
    });
    return element("tr", {},
      element("td", {}, String(row.number), element("small", { textContent: row.at })),
      element("td", { className: "changes" }, ...changes.map((text) => element("div", { textContent: text }))),
      element("td", { className: "short", textContent: row.strategy }),
      element("td", { className: "short", title: row.words, textContent: SIGNS[row.kind] || row.kind }), ...cells);
  }

  // --- all of it -----------------------------------------------------------------------------------------

  function draw() {
    document.title = state.title + ": live view";
    by("title").textContent = state.title;
    by("file").textContent = state.file;
    by("controls").hidden = !state.solving;
    by("beside").checked = state.panes.length > 1;
    by("drafts").checked = state.drafts;
    page.note(state.note, false);
    while (panes.length > state.panes.length) panes.pop().root.remove();
    while (panes.length < state.panes.length) {
      panes.push(newPane(panes.length));
      by("panes").append(panes[panes.length - 1].root);
    }
    panes.forEach((pane, i) => drawPane(pane, state.panes[i]));
    drawMessage();
    drawDifferences();
    drawHistory();
  }

  function lost() {
    page.note("The view has ended, or cannot be reached: start it again with python -m planner.view", true);
  }

  by("beside").addEventListener("change", (event) => {
    const taken = state.panes[0].strategy;
    const other = state.strategies.find((name) => name !== taken) || null;
    ask({ do: "beside", strategy: event.target.checked ? other : null });
  });
  by("drafts").addEventListener("change", (event) => ask({ do: "drafts", wanted: event.target.checked }));
  by("again").addEventListener("click", () => ask({ do: "again" }));
  setInterval(() => panes.forEach(tick), 1000);

  page.listen((told) => { state = told; draw(); }, lost);
})();
