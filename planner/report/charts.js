// Charts along time, or along the length laid: one zoom for all, and a cursor where the scene stands. What is folded is drawn
// when it is opened.
// Nothing of a plan leaves the page: no button that uploads, and no address to upload to.
const QUIET = { responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: "", scrollZoom: false, displayModeBar: false };
const OVER = { time: "time, s", length: "length laid, m" };

// Length laid by a time, and the time at which so much is laid; null without beads.
function makeLengths(scene) {
  const lines = scene && scene.lines;
  if (!lines || !lines.sample.length) return null;
  const along = values(lines.along), n = along.length, t = new Float64Array(n), laid = new Float64Array(n);
  for (let line = 0, before = 0; line < lines.first.length; line++) {
    const first = lines.first[line], end = line + 1 < lines.first.length ? lines.first[line + 1] : n;
    for (let i = first; i < end; i++) { t[i] = lines.sample[i] * scene.dt; laid[i] = (before + along[i] - along[first]) / 1000; }
    before += along[end - 1] - along[first];
  }
  const between = (x, y) => (at) => {
    const k = notAbove(x, at);
    if (k === 0) return y[0];
    if (k === n) return y[n - 1];
    return y[k - 1] + (y[k] - y[k - 1]) * (x[k] > x[k - 1] ? (at - x[k - 1]) / (x[k] - x[k - 1]) : 0);
  };
  return { of: between(t, laid), at: between(laid, t) };
}

// A line over a chart where the scene stands; `place(x)` puts it at a value of the chart's x, or hides it for null.
function makeCursor(div) {
  const line = document.createElement("div"), cursor = { div, x: null, seen: true };
  line.className = "cursor";
  line.hidden = true;
  div.appendChild(line);
  cursor.place = (x) => {
    if (x !== undefined) cursor.x = x;
    const layout = div._fullLayout, axis = layout && layout.xaxis;
    if (!cursor.seen || !axis || cursor.x === null) { line.hidden = true; return; }
    const at = axis.l2p(cursor.x);
    line.hidden = !(at >= 0 && at <= axis._length);
    Object.assign(line.style, { left: axis._offset + at + "px", top: layout._size.t + "px", height: layout._size.h + "px" });
  };
  new IntersectionObserver(([entry]) => { cursor.seen = entry.isIntersecting; cursor.place(); }).observe(div);
  return cursor;
}

function drawCharts(charts, lengths, clicked) {
  const over = by("over"), fit = by("fit"), drawn = [];
  let busy = false, now = null;
  const byLength = () => Boolean(over && lengths && over.value === "length");
  const shown = (t) => (byLength() ? lengths.of(t) : t);
  const xOf = (chart) => (byLength() ? chart.traces.map((trace) => Array.from(trace.x, (t) => (Number.isNaN(t) ? null : lengths.of(t)))) : chart.traces.map((trace) => trace.x));
  const rangeOf = (chart) => (chart.ranges ? chart.ranges[fit && fit.checked ? "fit" : "limits"] : undefined);
  const shapesOf = (chart) => (chart.layout.shapes || []).map((shape) => (shape.xref === "paper" ? shape : Object.assign({}, shape, { x0: shown(shape.x0), x1: shown(shape.x1) })));
  const layoutOf = (chart) => {
    const { xaxis, yaxis } = chart.layout, range = rangeOf(chart);
    return Object.assign({}, chart.layout, {
      shapes: shapesOf(chart), uirevision: over ? over.value : "time",
      xaxis: Object.assign({}, xaxis, { title: Object.assign({}, xaxis.title, { text: byLength() ? OVER.length : OVER.time }) }),
      yaxis: Object.assign({}, yaxis, range ? { range } : {}),
    });
  };
  const tracesOf = (chart) => { const x = xOf(chart); return chart.traces.map((trace, k) => Object.assign({}, trace, { x: x[k] })); };

  function draw(chart, div) {
    Plotly.newPlot(div, tracesOf(chart), layoutOf(chart), QUIET);
    const cursor = makeCursor(div);
    drawn.push({ chart, div, cursor });
    div.on("plotly_click", (e) => clicked(byLength() ? lengths.at(e.points[0].x) : e.points[0].x));
    div.on("plotly_afterplot", () => cursor.place());
    div.on("plotly_relayout", (e) => {
      const range = e["xaxis.range[0]"] !== undefined ? [e["xaxis.range[0]"], e["xaxis.range[1]"]] : null;
      if (busy || !(range || e["xaxis.autorange"])) return;
      busy = true;
      const change = range ? { "xaxis.range": range } : { "xaxis.autorange": true };
      Promise.all(drawn.filter((each) => each.div !== div).map((each) => Plotly.relayout(each.div, change)))
        .finally(() => { busy = false; });
    });
    if (now !== null) cursor.place(shown(now));
  }
  charts.forEach((chart) => whenOpen(by("chart-" + chart.key), (div) => draw(chart, div)));
  const again = () => drawn.forEach(({ chart, div, cursor }) => {
    Plotly.react(div, tracesOf(chart), layoutOf(chart), QUIET);
    if (now !== null) cursor.place(shown(now));
  });
  if (over) { over.disabled = !lengths; over.addEventListener("change", again); }
  if (fit) fit.addEventListener("change", () => drawn.forEach(({ chart, div }) => { if (chart.ranges) Plotly.relayout(div, { "yaxis.range": rangeOf(chart) }); }));
  return { at(t) { now = t; drawn.forEach(({ cursor }) => cursor.place(shown(t))); } };
}

// Draw in an element at once, or when what it is folded in is opened.
function whenOpen(div, draw) {
  const fold = div.closest("details:not([open])");
  if (!fold) return draw(div);
  return fold.addEventListener("toggle", () => draw(div), { once: true });
}
