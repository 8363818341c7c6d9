"use strict";
(function () {
  const page = JSON.parse(document.getElementById("data").textContent);
  const types = { f4: Float32Array, f8: Float64Array, i4: Int32Array, u2: Uint16Array, u4: Uint32Array };
  // Nothing of a plan leaves the page: no button that uploads, and no address to upload to.
  const quiet = { responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: "", scrollZoom: false };
  const chartConfig = Object.assign({ displayModeBar: false }, quiet);
  const sceneConfig = Object.assign({ modeBarButtons: [["resetCameraDefault3d", "toImage"]] }, quiet);
  const by = (id) => document.getElementById(id);

  function array(spec) {
    const bytes = Uint8Array.from(atob(spec.bdata), (c) => c.charCodeAt(0));
    return new types[spec.dtype](bytes.buffer);
  }

  function drawScene(scene) {
    const div = by("view");
    const small = div.clientWidth < 560;
    if (small) {
      // Room for the names of the axes, and lines that dips do not hide.
      for (const k of "xyz") scene.layout.scene.aspectratio[k] *= 0.86;
      scene.dips.forEach((k) => { scene.traces[k].marker = Object.assign({}, scene.traces[k].marker, { size: 3 }); });
      if (scene.beads.length) scene.layout.scene.domain.y = [0.16, 1];
    }
    if (scene.beads.length) {
      scene.layout.coloraxis.colorbar.len = small ? 0.9 : 0.5;
      scene.channels.forEach((c) => { c.values = c.values.map(array); });
      scene.t = scene.t.map(array);
      scene.bead = scene.bead.map(array);
    }
    const cursor = scene.traces.length;
    scene.traces.push({ type: "scatter3d", mode: "markers", x: [null], y: [null], z: [null], showlegend: false,
                        hoverinfo: "skip", marker: { size: 18, symbol: "circle-open", color: "#d1495b", line: { width: 6 } } });
    const unit = (c) => (c.unit === "°" ? "°" : c.unit && " " + c.unit);
    const colouring = (c) => ({
      trace: { "line.color": c.values },
      layout: { "coloraxis.cmin": c.min, "coloraxis.cmax": c.max, "coloraxis.reversescale": Boolean(c.reverse),
                "coloraxis.colorbar.title.text": c.label + (c.unit ? ", " + c.unit : "") } });
    scene.beads.forEach((trace, g) => { scene.traces[trace].hoverinfo = "none"; });
    if (scene.beads.length) {
      const c = scene.channels[0];
      scene.beads.forEach((trace, g) => { scene.traces[trace].line.color = c.values[g]; });
      Object.assign(scene.layout.coloraxis, { cmin: c.min, cmax: c.max });
      scene.layout.coloraxis.colorbar.title.text = colouring(c).layout["coloraxis.colorbar.title.text"];
    }
    // The wheel should scroll the page until someone takes hold of the scene.
    const drawn = Plotly.newPlot(div, scene.traces, scene.layout, sceneConfig);
    div.addEventListener("pointerdown", () => {
      if (div._context && div._context._scrollZoom) div._context._scrollZoom.gl3d = 1;
    }, { once: true });
    if (!scene.beads.length) return null;

    by("colour").addEventListener("change", (e) => {
      const c = colouring(scene.channels[e.target.selectedIndex]);
      Plotly.update(div, c.trace, c.layout, scene.beads);
    });
    const layers = by("layers"), only = by("only"), dips = by("dips");
    function filter() {
      const last = Number(layers.value);
      by("layer-words").textContent = (only.checked ? "only " : (last ? "up to " : "")) + scene.groups[last];
      const shown = scene.groups.map((_, g) => (only.checked ? g === last : g <= last));
      const marks = scene.dips.map((_, g) => shown[g] && dips.checked);
      Plotly.restyle(div, { visible: shown.concat(marks) }, scene.beads.concat(scene.dips));
    }
    if (dips) dips.addEventListener("change", filter);
    const places = by("places");
    if (places) places.addEventListener("change", () => {
      Plotly.restyle(div, { visible: places.checked }, scene.places);
    });
    layers.addEventListener("input", filter);
    only.addEventListener("change", filter);
    const solid = scene.part.length ? scene.traces[0].opacity : 1;
    by("through").addEventListener("change", (e) => {
      if (scene.part.length) Plotly.restyle(div, { opacity: e.target.checked ? 0.25 : solid }, scene.part);
    });
    div.on("plotly_hover", (e) => {
      const p = e.points[0], g = scene.beads.indexOf(p.curveNumber);
      if (g < 0) return;
      const i = p.pointNumber;
      by("reading").textContent = "Bead " + scene.bead[g][i] + ", layer " + scene.groups[g] + ", " +
        scene.t[g][i].toFixed(2) + " s: " +
        scene.channels.map((c) => c.label + " " + c.values[g][i].toPrecision(4) + unit(c)).join("; ");
    });
    return { drawn, mark };

    function mark(t) {
      let best = null, gap = Infinity;
      scene.t.forEach((times, g) => {
        for (let i = 0; i < times.length; i++) {
          const d = Math.abs(times[i] - t);
          if (d < gap) { gap = d; best = [g, i]; }
        }
      });
      if (!best) return;
      const trace = div._fullData[scene.beads[best[0]]], i = best[1];
      Plotly.restyle(div, { x: [[trace.x[i]]], y: [[trace.y[i]]], z: [[trace.z[i]]] }, [cursor]);
      by("reading").textContent = "Ringed in the scene: the printed place nearest to " + t.toFixed(2) + " s.";
    }
  }

  function drawCharts(charts, scene) {
    const divs = charts.map((chart) => by("chart-" + chart.key));
    let busy = false;
    charts.forEach((chart, k) => {
      Plotly.newPlot(divs[k], chart.traces, chart.layout, chartConfig);
      divs[k].on("plotly_click", (e) => { if (scene) scene.mark(e.points[0].x); });
      // One zoom in time for all charts.
      divs[k].on("plotly_relayout", (e) => {
        const range = e["xaxis.range[0]"] !== undefined ? [e["xaxis.range[0]"], e["xaxis.range[1]"]] : null;
        if (busy || !(range || e["xaxis.autorange"])) return;
        busy = true;
        const change = range ? { "xaxis.range": range } : { "xaxis.autorange": true };
        Promise.all(divs.filter((d) => d !== divs[k]).map((d) => Plotly.relayout(d, change)))
          .finally(() => { busy = false; });
      });
    });
    const fit = by("fit");
    if (fit) fit.addEventListener("change", () => {
      charts.forEach((chart, k) => {
        if (chart.ranges) Plotly.relayout(divs[k], { "yaxis.range": chart.ranges[fit.checked ? "fit" : "limits"] });
      });
    });
  }

  // The bodies of the cell as they stand where two of them come nearest.
  function drawCell(cell) {
    const div = by("cell"), choice = by("approach"), near = by("near");
    const bodies = cell.bodies.map((b) => Object.assign({}, b, { points: array(b.points) }));
    const at = (T, v) => {
      const n = v.length / 3, out = [new Float32Array(n), new Float32Array(n), new Float32Array(n)];
      for (let i = 0; i < n; i++) for (let k = 0; k < 3; k++)
        out[k][i] = T[4 * k] * v[3 * i] + T[4 * k + 1] * v[3 * i + 1] + T[4 * k + 2] * v[3 * i + 2] + T[4 * k + 3];
      return out;
    };
    const poses = cell.poses.map(array);
    const pose = (which, carrier) => poses[which].subarray(16 * carrier, 16 * carrier + 16);
    function placed(which) {
      const each = bodies.map((b) => at(pose(which, b.carrier), b.points));
      return { x: each.map((e) => e[0]), y: each.map((e) => e[1]), z: each.map((e) => e[2]) };
    }
    const colours = (which) => bodies.map((b) => {
      const k = cell.pairs[which].indexOf(b.name);
      return k < 0 ? b.colour : cell.marked[k];
    });
    function axes(which) {
      const tip = cell.tips[which], out = {};
      "xyz".split("").forEach((k, i) => {
        out["scene." + k + "axis.range"] = near.checked ? [tip[i] - cell.close, tip[i] + cell.close] : cell.ranges[i];
        out["scene.aspectratio." + k] = near.checked ? 1 : cell.aspect[i];
      });
      return out;
    }
    const first = placed(0), paint = colours(0);
    const traces = bodies.map((b, i) => Object.assign({ name: b.name, hovertemplate: "%{fullData.name}<extra></extra>",
      x: first.x[i], y: first.y[i], z: first.z[i] },
      b.corners ? { type: "mesh3d", i: b.corners[0], j: b.corners[1], k: b.corners[2], color: paint[i], opacity: 1,
                    flatshading: true, lighting: { ambient: 0.65, diffuse: 0.6, specular: 0.05 } }
                : { type: "scatter3d", mode: "lines", line: { width: 2, color: b.colour }, showlegend: false }));
    Plotly.newPlot(div, traces, cell.layout, sceneConfig);
    div.addEventListener("pointerdown", () => {
      if (div._context && div._context._scrollZoom) div._context._scrollZoom.gl3d = 1;
    }, { once: true });
    choice.addEventListener("change", () => {
      const which = choice.selectedIndex, moved = placed(which), meshes = bodies.map((_, i) => i);
      const paint = colours(which);
      Plotly.update(div, Object.assign(moved, { color: paint }), axes(which), meshes);
    });
    near.addEventListener("change", () => Plotly.relayout(div, axes(choice.selectedIndex)));
  }

  if (page.cell) drawCell(page.cell);
  const scene = page.scene ? drawScene(page.scene) : null;
  drawCharts(page.charts, scene);
  document.documentElement.dataset.ready = "yes";
})();
