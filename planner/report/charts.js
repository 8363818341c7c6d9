// Charts along time: one zoom for all, and a cursor where the scene stands.
// Nothing of a plan leaves the page: no button that uploads, and no address to upload to.
const QUIET = { responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: "", scrollZoom: false, displayModeBar: false };

function drawCharts(charts, clicked) {
  const divs = charts.map((chart) => document.getElementById("chart-" + chart.key));
  const cursors = [];
  let busy = false, now = null;
  const place = ({ div, line }) => {
    const layout = div._fullLayout, axis = layout && layout.xaxis;
    if (!axis || now === null) return;
    const x = axis.l2p(now);
    line.hidden = !(x >= 0 && x <= axis._length);
    Object.assign(line.style, { left: axis._offset + x + "px", top: layout._size.t + "px", height: layout._size.h + "px" });
  };
  charts.forEach((chart, k) => {
    const div = divs[k];
    Plotly.newPlot(div, chart.traces, chart.layout, QUIET);
    if (!chart.time) return;
    const line = document.createElement("div"), cursor = { div, line, seen: true };
    line.className = "cursor";
    div.appendChild(line);
    cursors.push(cursor);
    new IntersectionObserver(([entry]) => { cursor.seen = entry.isIntersecting; place(cursor); }).observe(div);
    div.on("plotly_click", (e) => clicked(e.points[0].x));
    div.on("plotly_afterplot", () => place(cursor));
    div.on("plotly_relayout", (e) => {
      const range = e["xaxis.range[0]"] !== undefined ? [e["xaxis.range[0]"], e["xaxis.range[1]"]] : null;
      if (busy || !(range || e["xaxis.autorange"])) return;
      busy = true;
      const change = range ? { "xaxis.range": range } : { "xaxis.autorange": true };
      Promise.all(cursors.filter((c) => c !== cursor).map((c) => Plotly.relayout(c.div, change)))
        .finally(() => { busy = false; });
    });
  });
  const fit = document.getElementById("fit");
  if (fit) fit.addEventListener("change", () => {
    charts.forEach((chart, k) => {
      if (chart.ranges) Plotly.relayout(divs[k], { "yaxis.range": chart.ranges[fit.checked ? "fit" : "limits"] });
    });
  });
  return { at(t) { now = t; cursors.forEach((c) => c.seen && place(c)); } };
}
