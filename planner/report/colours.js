// What beads are coloured by, which of them are shown, and the legend that says so.
function makeColours(stage, scene, changed) {
  const by = (id) => document.getElementById(id), lines = scene.lines, beads = stage.beads;
  const map = colourMap(scene.colours), channels = lines.channels.map((c) => Object.assign({}, c, { values: values(c.values) }));
  const owner = new Int32Array(beads.n);
  for (let k = 0; k < lines.first.length; k++) owner.fill(k, lines.first[k], k + 1 < lines.first.length ? lines.first[k + 1] : beads.n);
  const layers = [...new Set(lines.layer)].sort((a, b) => a - b);
  const colour = by("colour"), upTo = by("layers"), only = by("only"), from = by("from"), to = by("to");
  const unit = (c) => (c.unit === "°" ? "°" : c.unit && " " + c.unit);
  let channel = channels[0];
  const colours = { channels, words: (i) => channels.map((c) => `${c.label} ${Number.isNaN(c.values[i]) ? "–" : c.values[i].toFixed(c.digits)}${unit(c)}`) };

  function paint() {
    channel = channels[colour.selectedIndex];
    const { min, max, bad } = channel, scale = 255 / (max - min), at = channel.values;
    beads.paint((i) => {
      if (Number.isNaN(at[i])) return NOTHING;
      const x = Math.round(Math.min(Math.max((at[i] - min) * scale, 0), 255)), k = 3 * (bad === "high" ? 255 - x : x);
      return [map[k], map[k + 1], map[k + 2]];
    });
    const stops = scene.colours.map(([x, hex]) => [bad === "high" ? 1 - x : x, hex]).sort((a, b) => a[0] - b[0]);
    by("scale").style.background = `linear-gradient(to right, ${stops.map(([x, hex]) => `${hex} ${100 * x}%`).join(", ")})`;
    by("scale-name").textContent = channel.label + (channel.unit ? ", " + channel.unit : "");
    by("scale-min").textContent = min.toFixed(channel.digits);
    by("scale-max").textContent = max.toFixed(channel.digits);
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
  channels.forEach((c) => colour.add(new Option(c.label + (c.unit ? ", " + c.unit : ""), c.key)));
  upTo.max = layers.length - 1;
  upTo.value = layers.length - 1;
  colour.addEventListener("change", paint);
  for (const each of [upTo, only, from, to, by("dips")]) if (each) each.addEventListener("input", filter);
  colours.start = paint;
  return colours;
}
