// Where everything is at a time: joints between the postures that the page has, and the product of their exponentials.
// Poses are 4 by 4, row by row.
const STILL = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

function product(a, b) {
  const out = new Array(16);
  for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++)
    out[4 * i + j] = a[4 * i] * b[j] + a[4 * i + 1] * b[4 + j] + a[4 * i + 2] * b[8 + j] + a[4 * i + 3] * b[12 + j];
  return out;
}

function inverse(a) {
  const out = STILL.slice();
  for (let i = 0; i < 3; i++) {
    for (let j = 0; j < 3; j++) out[4 * i + j] = a[4 * j + i];
    out[4 * i + 3] = -(a[i] * a[3] + a[4 + i] * a[7] + a[8 + i] * a[11]);
  }
  return out;
}

function moved(a, p) {
  return [0, 4, 8].map((i) => a[i] * p[0] + a[i + 1] * p[1] + a[i + 2] * p[2] + a[i + 3]);
}

function turned(a, v) {
  return [0, 4, 8].map((i) => a[i] * v[0] + a[i + 1] * v[1] + a[i + 2] * v[2]);
}

// Turn by an angle about the axis through (o) along the unit vector (x, y, z): Rodrigues.
function exponential([ox, oy, oz, x, y, z], angle) {
  const c = Math.cos(angle), s = Math.sin(angle), u = 1 - c;
  const r = [u * x * x + c, u * x * y - s * z, u * x * z + s * y,
             u * x * y + s * z, u * y * y + c, u * y * z - s * x,
             u * x * z - s * y, u * y * z + s * x, u * z * z + c];
  const out = STILL.slice();
  for (let i = 0; i < 3; i++) {
    const [a, b, d] = r.slice(3 * i, 3 * i + 3);
    out[4 * i] = a; out[4 * i + 1] = b; out[4 * i + 2] = d;
    out[4 * i + 3] = [ox, oy, oz][i] - (a * ox + b * oy + d * oz);
  }
  return out;
}

// Slide by a way along the unit vector (x, y, z).
function slid([, , , x, y, z], way) {
  const out = STILL.slice();
  out[3] = way * x; out[7] = way * y; out[11] = way * z;
  return out;
}

function makeMotion(scene) {
  const { cell, motion, dt } = scene;
  if (!cell) return null;
  const joints = cell.screws.length / 6;
  const screws = Array.from({ length: joints }, (_, j) => Array.from(cell.screws.subarray(6 * j, 6 * j + 6)));
  const does = cell.slides.map((slides) => (slides ? slid : exponential));
  const part = Array.from(cell.part);
  const tools = cell.tools.length ? cell.tools : [{ since: 0, frame: cell.nozzle, absent: [] }];
  const frames = tools.map((tool) => Array.from(tool.frame)), begun = tools.map((tool) => tool.since);

  function posture(t) {
    if (!motion) return scene.home;
    const { sample, q } = motion, at = t / dt;
    const k = Math.min(Math.max(notAbove(sample, at) - 1, 0), sample.length - 2);
    if (k < 0) return Array.from(q.subarray(0, joints));
    const share = Math.min(Math.max((at - sample[k]) / (sample[k + 1] - sample[k]), 0), 1);
    return screws.map((_, j) => q[k * joints + j] + share * (q[(k + 1) * joints + j] - q[k * joints + j]));
  }

  // `carrier` gives the pose of what the joints from the first one to before the last move.
  function poses(t) {
    const q = posture(t), chain = (first, last) => {
      const out = [STILL];
      for (let j = first; j < last; j++) out.push(product(out[out.length - 1], does[j](screws[j], q[j])));
      return out;
    };
    const arm = chain(0, cell.arm), holder = chain(cell.arm, joints), k = Math.max(notAbove(begun, t) - 1, 0);
    return {
      q,
      carrier: ([first, last]) => (first === 0 ? arm[last] : holder[last - first]),
      nozzle: product(arm[arm.length - 1], frames[k]),
      absent: tools[k].absent,
      part: product(holder[holder.length - 1], part),
    };
  }

  function tip(t) {
    const now = poses(t);
    return moved(inverse(now.part), [now.nozzle[3], now.nozzle[7], now.nozzle[11]]);
  }
  return { poses, tip, turns: joints > cell.arm };
}
