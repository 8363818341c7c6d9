// What the page carries is compressed; here it becomes figures and libraries again.
const KINDS = { f4: Float32Array, f8: Float64Array, i4: Int32Array, i1: Int8Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };
const NO_NUMBER = 65535;

async function inflated(id) {
  const element = document.getElementById(id);
  const text = atob(element.textContent), bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  element.remove();
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate")));
}

async function library(id) {
  const script = document.createElement("script");
  script.textContent = await (await inflated(id)).text();
  document.head.appendChild(script);
}

async function figures(id) {
  const buffer = await (await inflated(id)).arrayBuffer();
  const length = new DataView(buffer).getUint32(0, true);
  const text = new TextDecoder().decode(new Uint8Array(buffer, 4, length));
  return JSON.parse(text, (_, value) => {
    if (!value || !value.array) return value;
    const [kind, at, count] = value.array;
    return new KINDS[kind](buffer, 4 + length + at, count);
  });
}

// Values that are kept as steps.
function values(coarse) {
  const out = new Float32Array(coarse.steps.length);
  for (let i = 0; i < out.length; i++) out[i] = coarse.steps[i] === NO_NUMBER ? NaN : coarse.low + coarse.step * coarse.steps[i];
  return out;
}

// How many of the ascending numbers are not above x.
function notAbove(ascending, x) {
  let low = 0, high = ascending.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (ascending[middle] <= x) low = middle + 1; else high = middle;
  }
  return low;
}
