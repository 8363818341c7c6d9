// What beads are coloured by, which of them are shown, and the legend that says so.
// A colour map: 256 colours from the stops of the page.
function colourMap(stops) {
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
  const out = new Uint8Array(3 * 256);
  for (let i = 0; i < 256; i++) {
    const x = i / 255, k = Math.max(stops.findIndex((s) => s[0] >= x), 1);
    const [a, b] = [stops[k - 1], stops[k]], share = (x - a[0]) / (b[0] - a[0]), from = rgb(a[1]), to = rgb(b[1]);
    for (let c = 0; c < 3; c++) out[3 * i + c] = Math.round(from[c] + share * (to[c] - from[c]));
  }
  return out;
}

function makeColours(stage, scene, changed) {
  const by = (id) => document.getElementById(id), lines = scene.lines, beads = stage.beads;
  const map = colourMap(scene.colours), channels = lines.channels.map((c) => Object.assign({}, c, { values: values(c.values) }));
  const owner = new Int32Array(beads.n);
  for (let k = 0; k < lines.first.length; k++) owner.fill(k, lines.first[k], k + 1 < lines.first.length ? lines.first[k + 1] : beads.n);
  const layers = [...new Set(lines.layer)].sort((a, b) => a - b);
  const colour = by("colour"), upTo = by("layers"), only = by("only"), from = by("from"), to = by("to");
  const unit = (c) => (c.unit === "°" ? "°" : c.unit && " " + c.unit);
  let channel = channels.find((c) => c.first) || channels[0];
  const colours = { channels, words: (i) => channels.map((c) => `${c.label} ${Number.isNaN(c.values[i]) ? "–" : c.values[i].toFixed(c.digits)}${unit(c)}`) };

  function paint() {
    channel = channels[colour.selectedIndex];
    const { edges, bad, digits } = channel, at = channel.values, count = edges.length - 1, inner = edges.slice(1, -1);
    const shade = (k) => { const x = count > 1 ? (bad === "high" ? count - 1 - k : k) / (count - 1) : 1, i = 3 * Math.round(255 * x); return [map[i], map[i + 1], map[i + 2]]; };
    const shades = Array.from({ length: count }, (_, k) => shade(k));
    beads.paint((i) => (Number.isNaN(at[i]) ? NOTHING : shades[notAbove(inner, at[i])]));
    by("scale").replaceChildren(...shades.map((rgb, k) => {
      const item = document.createElement("li"), chip = document.createElement("i");
      chip.style.background = `rgb(${rgb.join()})`;
      const [low, high] = [edges[k].toFixed(digits), edges[k + 1].toFixed(digits)];
      item.append(chip, channel.key === "layer" && count === layers.length ? String(Math.round(edges[k + 1])) : low === high ? low : `${low} – ${high}`);
      item.title = `${(100 * channel.shares[k]).toFixed(channel.shares[k] < 0.1 ? 1 : 0)} % of what is laid`;
      return item;
    }));
    by("scale-name").textContent = channel.label + (channel.unit ? ", " + channel.unit : "");
    by("scale-words").textContent = channel.words;
    from.value = 0; to.value = 1000;
    filter();
  }
  function filter() {
    const last = layers[Number(upTo.value)], one = only.checked;
    if (Number(from.value) > Number(to.value)) to.value = from.value;
    const at = (slider) => channel.min + Number(slider.value) / 1000 * (channel.max - channel.min);
    const low = Number(from.value) ? at(from) : -Infinity, high = Number(to.value) < 1000 ? at(to) : Infinity;
    const whole = low === -Infinity && high === Infinity, inside = (v) => v >= low && v <= high;
    const layerShown = (layer) => (one ? layer === last : layer <= last);
    beads.filter((i) => layerShown(lines.layer[owner[i]]) && (whole || inside(channel.values[i]) || inside(channel.values[i + 1])));
    by("layer-words").textContent = (one ? "only " : last === layers[layers.length - 1] ? "all " : "up to ") +
      (one || last !== layers[layers.length - 1] ? last + 1 : layers.length);
    by("range-words").textContent = whole ? "all" : `${at(from).toFixed(channel.digits)} to ${at(to).toFixed(channel.digits)}${unit(channel)}`;
    if (colours.dips) colours.dips.filter((k) => by("dips").checked && layerShown(scene.dips.layer[k]));
    changed();
  }
  colours.filter = filter;
  channels.forEach((c) => colour.add(new Option(c.label + (c.unit ? ", " + c.unit : ""), c.key, c.first, c.first)));
  upTo.max = layers.length - 1;
  upTo.value = layers.length - 1;
  colour.addEventListener("change", paint);
  for (const each of [upTo, only, from, to, by("dips")]) if (each) each.addEventListener("input", filter);
  colours.start = paint;
  return colours;
}
