// The roll × path map: what is free in colour, what is not pale and lettered, the chosen roll as a line.
const PALE = ["#ffffff", "#f4f6f9", "#e3e8ee", "#ccd5de", "#f0d9d2"];  // by the number of the reason

function drawRollMap(page, clicked) {
  const div = by("roll-map"), which = by("roll-map-which"), measure = by("roll-map-measure");

  function line(map) {
    const x = [], y = [];
    map.chosen.forEach((roll, i) => {
      if (i && (map.bead[i] !== map.bead[i - 1] || Math.abs(roll - map.chosen[i - 1]) > 180)) { x.push(null); y.push(null); }
      x.push(map.along[i]); y.push(Number.isNaN(roll) ? null : roll);
    });
    return { x, y };
  }

  function draw() {
    const map = page.maps[which.selectedIndex], shown = page.measures[measure.selectedIndex];
    const bytes = map.values[measure.selectedIndex], columns = map.along.length;
    const free = [], not = [], words = [];
    for (let j = 0; j < map.roll.length; j++) {
      const row = Array.from(bytes.subarray(j * columns, (j + 1) * columns));
      free.push(row.map((b) => (b < page.code ? b * shown.step : null)));
      not.push(row.map((b) => (b < page.code ? null : b - page.code)));
      words.push(row.map((b, i) => `bead ${map.bead[i]}, ${map.s[i].toFixed(1)} mm along it, roll ${map.roll[j].toFixed(0)}°: ` +
        (b < page.code ? `${shown.label} ${(b * shown.step).toFixed(shown.digits)}${shown.unit}` : page.reasons[b - page.code])));
    }
    const grid = { x: map.along, y: map.roll, type: "heatmap", text: words, hovertemplate: "%{text}<extra></extra>", zsmooth: false };
    const top = page.measures[measure.selectedIndex].step * (page.code - 1);
    const pale = PALE.flatMap((c, k) => [[k / PALE.length, c], [(k + 1) / PALE.length, c]]);
    const chosen = line(map), small = div.clientWidth < 560;
    const path = (color, width) => Object.assign({ type: "scatter", mode: "lines", hoverinfo: "skip", line: { color, width } }, chosen);
    const traces = [
      Object.assign({}, grid, { z: not, zmin: -0.5, zmax: PALE.length - 0.5, colorscale: pale, showscale: false, hoverongaps: false }),
      Object.assign({}, grid, { z: free, zmin: 0, zmax: top, colorscale: page.colours, hoverongaps: false,
        colorbar: { title: { text: shown.label + (shown.unit ? ", " + shown.unit : ""), side: small ? "top" : "right" }, thickness: 12,
                    ...(small ? { orientation: "h", y: -0.32, yanchor: "top" } : {}) } }),
      Object.assign({ type: "scatter", mode: "text", hoverinfo: "skip", textfont: { size: 12, color: "#1b2733" } }, map.letters),
      path("#1b2733", 5), path("#ffffff", 2.5),
    ];
    const layout = Object.assign({}, page.layout, small ? { height: page.layout.height + 90 } : {});
    layout.xaxis = Object.assign({}, layout.xaxis, { range: [map.along[0], map.along[columns - 1]] });
    return Plotly.react(div, traces, layout, QUIET);
  }

  function told(e) {
    const map = page.maps[which.selectedIndex], x = e.points[0].x;
    clicked(map.t[Math.max(0, notAbove(map.along, x + 1e-3) - 1)]);
  }
  let cursor = null, now = null;
  // The place of a time: on the last column that is laid by then, if the map has it.
  function at(t) {
    now = t;
    if (!cursor) return;
    const map = page.maps[which.selectedIndex], k = notAbove(map.t, t);
    cursor.place(k > 0 && t <= map.t[map.t.length - 1] + 1e-9 ? map.along[k - 1] : null);
  }
  whenOpen(div, () => {
    draw();
    cursor = makeCursor(div);
    div.on("plotly_click", told);
    div.on("plotly_afterplot", () => { if (now !== null) at(now); });
  });
  which.addEventListener("change", draw);
  measure.addEventListener("change", draw);
  return { at };
}
