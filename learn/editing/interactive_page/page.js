"use strict";
(async () => {
const $ = id => document.getElementById(id);
const H = JSON.parse($("header").textContent);
const {width: W, height: HT} = H;
const status = text => { $("status").textContent = text; };

// ---- data -------------------------------------------------------------------------------------
const raw = atob($("data").textContent);
$("data").remove();
const bytes = new Uint8Array(raw.length);
for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
async function chunk([start, length]) {
  const stream = new Blob([bytes.subarray(start, start + length)]).stream();
  return new Uint8Array(await new Response(stream.pipeThrough(new DecompressionStream("deflate"))).arrayBuffer());
}
function words(data, offset, count) {  // differences: low bytes, then high bytes
  const out = new Int16Array(count), half = data.length / 2;
  for (let i = 0; i < count; i++) {
    const z = data[offset + i] | data[half + offset + i] << 8;
    out[i] = (z >>> 1) ^ -(z & 1);
  }
  return out;
}
function summed(d, height, width, channels, rows) {  // differences → values, in place
  const line = width * channels;
  for (let y = 0; y < height; y++) for (let i = channels; i < line; i++) d[y * line + i] += d[y * line + i - channels];
  if (rows) for (let i = line; i < height * line; i++) d[i] += d[i - line];
  return d;
}
const data = await chunk(H.pictureData);
const planes = [];
let at = 0;
for (const channels of H.planes) {
  planes.push(summed(data.subarray(at, at += W * HT * channels), HT, W, channels, false));
}
const [photo, behind, coverage, region, residual, opacity, share = coverage] = planes;  // share: of a pixel's colour
for (let i = 0; i < photo.length; i++) behind[i] += photo[i];

// points of the disk at each pixel: normals, interpolated between the network's pixels
const geometry = new Float32Array(W * HT * 4);
{
  const N = H.normalsSize, codes = words(await chunk(H.normalsData), 0, N * N * 3);
  const n = summed(codes, N, N, 3, true), [top, left, side] = H.box;
  const near = x => { const t = Math.min(Math.max(x, 0), N - 1), i = Math.min(Math.floor(t), N - 2); return [i, t - i]; };
  for (let y = 0; y < HT; y++) {
    const [r, v] = near((y + 0.5 - top) / side * N - 0.5);
    for (let x = 0; x < W; x++) {
      const i = y * W + x;
      geometry[4 * i + 2] = coverage[i] / 255;
      if (!coverage[i]) continue;  // region 0: background
      geometry[4 * i + 3] = region[i];
      const [c, u] = near((x + 0.5 - left) / side * N - 0.5), a = [0, 0, 0];
      for (let k = 0; k < 3; k++) {
        const j = (r * N + c) * 3 + k;
        a[k] = (1 - v) * ((1 - u) * n[j] + u * n[j + 3]) + v * ((1 - u) * n[j + 3 * N] + u * n[j + 3 * N + 3]);
      }
      const length = Math.hypot(...a) || 1, stretch = length * Math.sqrt(1 + Math.max(a[2] / length, 0));
      geometry[4 * i] = a[0] / stretch;
      geometry[4 * i + 1] = a[1] / stretch;
    }
  }
}

// ---- reflectance maps -------------------------------------------------------------------------
const lights = H.lights.map(() => null);
async function loadLight(l) {
  if (!lights[l]) {
    const packed = await chunk(H.lights[l].data), offsets = [];
    let total = 0;
    for (const side of H.lights[l].sides) { offsets.push(total); total += 3 * (side + 5) ** 2; }
    lights[l] = {packed, offsets, coarse: new Map(), fine: new Map()};
  }
  return lights[l];
}
function values(l, m) {  // linear, as stored
  const {packed, offsets, coarse} = lights[l];
  if (!coarse.has(m)) {
    // those of large maps have some megabytes each
    const large = [...coarse.keys()].filter(k => H.lights[l].sides[k] > 128);
    if (large.length > 15) coarse.delete(large[0]);
    const size = H.lights[l].sides[m] + 5;
    const codes = summed(words(packed, offsets[m], 3 * size * size), size, size, 3, true);
    coarse.set(m, Float32Array.from(codes, c => Math.expm1(Math.max(c, 0) * Math.log1p(H.bend) / H.steps) / H.bend));
  }
  return coarse.get(m);
}
// Catmull–Rom interpolation to a map fine enough for bilinear look-up, across the disk alone
function upsampled(l, m) {
  const cache = lights[l].fine;
  if (cache.has(m)) return cache.get(m);
  const side = H.lights[l].sides[m], size = side + 5, factor = side < 32 ? 8 : side < 256 ? 4 : side < 1024 ? 2 : 1, M = side * factor + 1;
  const source = values(l, m), wide = new Float32Array(size * M * 3), out = new Float32Array(M * M * 3);
  const weights = [];
  for (let f = 0; f < factor; f++) {
    const t = f / factor;
    weights.push([((2 - t) * t - 1) * t / 2, ((3 * t - 5) * t * t + 2) / 2, ((4 - 3 * t) * t + 1) * t / 2, (t - 1) * t * t / 2]);
  }
  for (let y = 0; y < size; y++) for (let x = 0; x < M; x++) {
    const w = weights[x % factor], j = (y * size + Math.floor(x / factor) + 1) * 3, o = (y * M + x) * 3;
    for (let k = 0; k < 3; k++) wide[o + k] = w[0] * source[j + k] + w[1] * source[j + 3 + k] + w[2] * source[j + 6 + k] + w[3] * source[j + 9 + k];
  }
  for (let y = 0; y < M; y++) {
    const w = weights[y % factor], j = (Math.floor(y / factor) + 1) * M * 3, s = M * 3, o = y * s;
    for (let i = 0; i < s; i++) out[o + i] = Math.max(0, w[0] * wide[j + i] + w[1] * wide[j + s + i] + w[2] * wide[j + 2 * s + i] + w[3] * wide[j + 3 * s + i]);
  }
  const result = {M, out};
  if (cache.size > 11) cache.delete(cache.keys().next().value);
  cache.set(m, result);
  return result;
}
const srgb = x => x <= 0.0031308 ? 12.92 * Math.max(x, 0) : 1.055 * Math.min(x, 1) ** (1 / 2.4) - 0.055;
const linear = Float32Array.from({length: 256}, (_, i) => i <= 10 ? i / 255 / 12.92 : ((i / 255 + 0.055) / 1.055) ** 2.4);
const curve = Uint8ClampedArray.from({length: 4097}, (_, i) => Math.round(255 * srgb((i / 4096) ** 2)));
const encoded = x => curve[Math.round(4096 * Math.sqrt(Math.min(Math.max(x, 0), 1)))];

// spheres of the gallery: nearest places in the stored map, averaged over 2 × 2 points
const S = 56, spots = [];
for (let y = 0; y < 2 * S; y++) for (let x = 0; x < 2 * S; x++) {
  const a = ((x + 0.5) / S - 1) * 1.03, b = (1 - (y + 0.5) / S) * 1.03, r = a * a + b * b;
  if (r < 1) { const s = Math.sqrt(1 + Math.sqrt(1 - r)); spots.push([(y >> 1) * S + (x >> 1), a / s, b / s]); }
}
function sphere(canvas, l, m, m2 = -1, share = 0) {
  const sum = new Float32Array(S * S * 4), maps = [[m, 1 - share]];
  if (m2 >= 0 && share > 0) maps.push([m2, share]);
  for (const [which, weight] of maps) {
    const v = values(l, which), side = H.lights[l].sides[which], size = side + 5;
    for (const [pixel, px, py] of spots) {
      const gx = (px + 1) / 2 * side + 2, gy = (py + 1) / 2 * side + 2, i = Math.floor(gx), j = Math.floor(gy);
      const u = gx - i, w = gy - j, o = (j * size + i) * 3;
      for (let k = 0; k < 3; k++) sum[4 * pixel + k] += weight * Math.min(2, (1 - w) * ((1 - u) * v[o + k] + u * v[o + 3 + k]) + w * ((1 - u) * v[o + 3 * size + k] + u * v[o + 3 * size + 3 + k]));
      sum[4 * pixel + 3] += weight;
    }
  }
  const image = new ImageData(S, S);
  for (let i = 0; i < S * S; i++) {
    const count = sum[4 * i + 3];
    if (!count) continue;
    for (let k = 0; k < 3; k++) image.data[4 * i + k] = encoded(sum[4 * i + k] / count);
    image.data[4 * i + 3] = 255 * count / 4;
  }
  canvas.width = canvas.height = S;
  canvas.getContext("2d").putImageData(image, 0, 0);
}

// ---- what is chosen ---------------------------------------------------------------------------
const state = {
  light: 0, split: 1, detail: H.detail, ground: false, stops: H.stops, region: 0, slot: 0,
  regions: Array.from({length: H.regions}, (_, r) => ({materials: [H.chosen[r], -2], blend: 0.5})),
};
const GROUND = [0.42, 0.43, 0.45];
const contrast = Math.log(H.largestDetail);
const shownDetail = () => state.light === 0 ? state.detail : 0;  // it belongs to the photograph's light
function mixture(r) {  // [first, second, share of the second]; −1: as photographed
  const {materials: [a, b], blend} = state.regions[r];
  return b < 0 || a < 0 ? [a, a, 0] : [a, b, blend];
}

// ---- drawing: WebGL 2, or the same in JavaScript ----------------------------------------------
const canvas = $("picture");
canvas.width = W;
canvas.height = HT;
canvas.style.width = `min(100%, ${66 * W / HT}vh)`;
function webgl() {
  if (/[?#&]canvas\b/.test(location.href)) return null;
  const gl = canvas.getContext("webgl2", {premultipliedAlpha: false, preserveDrawingBuffer: true, antialias: false});
  if (!gl || gl.getParameter(gl.MAX_TEXTURE_SIZE) < Math.max(W, HT)) return null;
  const program = gl.createProgram();
  const vertex = "#version 300 es\nvoid main(){vec2 p=vec2(gl_VertexID==1?3.:-1.,gl_VertexID==2?3.:-1.);gl_Position=vec4(p,0.,1.);}";
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, $("shader").textContent]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source.trim());
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return null;
  gl.useProgram(program);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  const uniform = name => gl.getUniformLocation(program, name);
  const where = Object.fromEntries(["region", "unchanged", "ground", "blend", "detail", "split", "contrast", "gain", "groundColor"].map(n => [n, uniform(n)]));
  const names = ["photo", "behind", "geometry", "residual", "first", "second"], textures = {};
  names.forEach((name, unit) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, textures[name] = gl.createTexture());
    const filter = unit < 4 ? gl.NEAREST : gl.LINEAR;
    for (const p of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, p, filter);
    for (const p of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, p, gl.CLAMP_TO_EDGE);
    gl.uniform1i(uniform(name), unit);
  });
  const upload = (unit, internal, w, h, format, type, pixels) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, w, h, 0, format, type, pixels);
  };
  const rgba = new Uint8Array(W * HT * 4);
  for (let i = 0; i < W * HT; i++) {
    rgba.set(photo.subarray(3 * i, 3 * i + 3), 4 * i);
    rgba[4 * i + 3] = opacity ? opacity[i] : 255;
  }
  upload(0, gl.RGBA8, W, HT, gl.RGBA, gl.UNSIGNED_BYTE, rgba);
  for (let i = 0; i < W * HT; i++) {
    rgba.set(behind.subarray(3 * i, 3 * i + 3), 4 * i);
    rgba[4 * i + 3] = share[i];
  }
  upload(1, gl.RGBA8, W, HT, gl.RGBA, gl.UNSIGNED_BYTE, rgba);
  upload(2, gl.RGBA32F, W, HT, gl.RGBA, gl.FLOAT, geometry);
  upload(3, gl.RGB8, W, HT, gl.RGB, gl.UNSIGNED_BYTE, residual);
  // a region's maps stay on the GPU until another material or light is chosen
  const held = new Map();
  const mapTexture = (unit, r, m) => {
    const key = `${r} ${unit}`, label = `${state.light} ${m}`;
    let entry = held.get(key);
    gl.activeTexture(gl.TEXTURE0 + unit);
    if (!entry) {
      entry = {texture: gl.createTexture(), label: ""};
      held.set(key, entry);
      gl.bindTexture(gl.TEXTURE_2D, entry.texture);
      for (const p of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, p, gl.LINEAR);
      for (const p of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, p, gl.CLAMP_TO_EDGE);
    }
    gl.bindTexture(gl.TEXTURE_2D, entry.texture);
    if (entry.label !== label) {
      const {M, out} = upsampled(state.light, m);
      upload(unit, gl.RGB16F, M, M, gl.RGB, gl.FLOAT, out);
      entry.label = label;
    }
  };
  gl.viewport(0, 0, W, HT);
  gl.enable(gl.SCISSOR_TEST);
  // rectangles of the regions: left, bottom, width, height; the background is drawn when it changes
  const boxes = Array.from({length: H.regions + 1}, () => [W, HT, 0, 0]);
  for (let i = 0; i < W * HT; i++) {
    const box = boxes[geometry[4 * i + 3]], x = i % W, y = HT - 1 - Math.floor(i / W);
    box[0] = Math.min(box[0], x);
    box[1] = Math.min(box[1], y);
    box[2] = Math.max(box[2], x);
    box[3] = Math.max(box[3], y);
  }
  for (const box of boxes) { box[2] += 1 - box[0]; box[3] += 1 - box[1]; }
  let background = "";
  return () => {
    const wanted = `${state.split} ${state.ground}`;
    gl.uniform1f(where.detail, shownDetail());
    gl.uniform1f(where.split, state.split);
    gl.uniform1f(where.contrast, contrast);
    gl.uniform1f(where.gain, 2 ** state.stops);
    gl.uniform1i(where.ground, state.ground ? 1 : 0);
    gl.uniform3fv(where.groundColor, GROUND);
    for (let r = background === wanted ? 1 : 0; r <= H.regions; r++) {
      if (boxes[r][2] <= 0) continue;
      gl.scissor(...boxes[r]);
      const [a, b, share] = r ? mixture(r - 1) : [-1, -1, 0];
      gl.uniform1i(where.region, r);
      gl.uniform1i(where.unchanged, a < 0 ? 1 : 0);
      gl.uniform1f(where.blend, share);
      if (a >= 0) { mapTexture(4, r, a); mapTexture(5, r, b); }
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
    background = wanted;
  };
}
function plain() {
  const context = canvas.getContext("2d"), image = new ImageData(W, HT), out = image.data;
  const look = ({M, out: map}, px, py, k) => {
    const gx = Math.min(Math.max((px * 0.5 + 0.5) * (M - 1), 0), M - 1.001), gy = Math.min(Math.max((py * 0.5 + 0.5) * (M - 1), 0), M - 1.001);
    const i = gx | 0, j = gy | 0, u = gx - i, v = gy - j, o = (j * M + i) * 3 + k;
    return (1 - v) * ((1 - u) * map[o] + u * map[o + 3]) + v * ((1 - u) * map[o + 3 * M] + u * map[o + 3 * M + 3]);
  };
  return () => {
    const mixed = state.regions.map((_, r) => mixture(r));
    const maps = mixed.map(([a, b]) => a < 0 ? [] : [upsampled(state.light, a), upsampled(state.light, b)]);
    const detail = shownDetail(), gain = 2 ** state.stops, border = state.split * W;
    for (let i = 0; i < W * HT; i++) {
      const r = region[i] - 1, before = (i % W) + 0.5 > border;
      const unchanged = r < 0 || mixed[r][0] < 0;
      out[4 * i + 3] = opacity && !(state.ground && !before) ? opacity[i] : 255;
      let c = coverage[i] / 255;
      if (before || (unchanged && !state.ground)) c = 0;
      for (let k = 0; k < 3; k++) {
        const j = 3 * i + k;
        if (before) { out[4 * i + k] = photo[j]; continue; }
        const back = state.ground ? Math.round(255 * GROUND[k]) : c > 0 ? behind[j] : photo[j];
        if (!(c > 0)) { out[4 * i + k] = back; continue; }
        let object = linear[photo[j]];
        if (!unchanged) {
          const px = geometry[4 * i], py = geometry[4 * i + 1], blend = mixed[r][2];
          object = look(maps[r][0], px, py, k);
          if (blend) object += blend * (look(maps[r][1], px, py, k) - object);
          if (detail) object *= Math.exp((residual[j] / 127.5 - 1) * contrast * detail);
          object *= gain;
        }
        const covered = state.ground ? c : share[i] / 255;
        out[4 * i + k] = encoded(linear[back] + covered * (object - linear[back]));
      }
    }
    context.putImageData(image, 0, 0);
  };
}
await loadLight(0);
const accelerated = webgl();
const draw = accelerated || plain();
let queued = false;
function redraw() {
  if (queued) return;
  queued = true;
  requestAnimationFrame(() => { queued = false; draw(); });
}

// ---- controls ---------------------------------------------------------------------------------
const spoken = name => name.replace(/[-_]+/g, " ");
const tiles = [], stale = new Set();
function paintTile(m) {
  if (!stale.delete(m)) return;
  sphere(tiles[m].querySelector("canvas"), state.light, m);
}
const watcher = new IntersectionObserver(entries => {
  for (const entry of entries) {
    entry.target.seen = entry.isIntersecting;
    if (entry.isIntersecting) paintTile(entry.target.material);
  }
}, {rootMargin: "150px"});
const families = [...new Set(H.materials.map(m => m.family))];
for (const family of families) {
  const group = document.createElement("section"), title = document.createElement("h2"), grid = document.createElement("div");
  title.textContent = family;
  grid.className = "tiles";
  group.append(title, grid);
  if (family === "this photograph") grid.append(tile(-1, "unchanged", "photograph keep original"));
  H.materials.forEach((m, i) => { if (m.family === family) grid.append(tiles[i] = tile(i, m.name, `${m.family} ${m.words}`)); });
  $("gallery").append(group);
}
function tile(m, name, words) {
  const button = document.createElement("button"), picture = document.createElement("canvas");
  button.type = "button";
  button.title = name;
  button.tabIndex = -1;
  button.material = m;
  button.words = `${spoken(name)} ${words}`.toLowerCase().replace(/gray/g, "grey gray").replace(/colour/g, "colour color").replace(/alum\b/, "aluminium aluminum");
  picture.width = picture.height = S;
  button.append(picture, spoken(name));
  button.addEventListener("click", () => choose(m));
  if (m < 0) thumbnail(picture);
  else { stale.add(m); watcher.observe(button); }
  return button;
}
function thumbnail(picture) {  // the photograph, small
  const whole = document.createElement("canvas"), image = new ImageData(W, HT);
  for (let i = 0; i < W * HT; i++) {
    for (let k = 0; k < 3; k++) image.data[4 * i + k] = photo[3 * i + k];
    image.data[4 * i + 3] = opacity ? opacity[i] : 255;
  }
  whole.width = W;
  whole.height = HT;
  whole.getContext("2d").putImageData(image, 0, 0);
  const side = Math.min(W, HT);
  picture.getContext("2d").drawImage(whole, (W - side) / 2, (HT - side) / 2, side, side, 0, 0, S, S);
}
function choose(m) {
  const targets = state.region < 0 ? state.regions : [state.regions[state.region]];
  for (const target of targets) {
    if (state.slot === 1 && target.materials[1] === m) target.materials[1] = -2;  // chosen again: no blend
    else if (state.slot === 1 && (m < 0 || target.materials[0] < 0)) target.materials[state.slot = 0] = m;
    else target.materials[state.slot] = m;
  }
  refresh();
}
const current = () => state.regions[Math.max(state.region, 0)];
function refresh() {
  const {materials: [a, b], blend} = current(), blended = a >= 0 && b >= 0;
  [[0, a, "unchanged"], [1, b, a < 0 ? "—" : "nothing"]].forEach(([slot, m, none]) => {
    const button = $(`slot-${slot}`), picture = button.querySelector("canvas");
    button.setAttribute("aria-checked", state.slot === slot);
    button.tabIndex = state.slot === slot ? 0 : -1;
    button.querySelector("b").textContent = m >= 0 ? spoken(H.materials[m].name) : none;
    picture.getContext("2d").clearRect(0, 0, S, S);
    if (m >= 0) sphere(picture, state.light, m);
    else if (slot === 0) thumbnail(picture);
  });
  $("blend").disabled = !blended;
  $("blend").value = blended ? blend : 0;
  $("blend-value").textContent = blended ? `${Math.round(100 * (1 - blend))} : ${Math.round(100 * blend)}` : "";
  $("mixing").hidden = !blended;
  const buttons = [...document.querySelectorAll(".tiles button")], chosen = current().materials[state.slot];
  for (const button of buttons) button.setAttribute("aria-pressed", button.material === chosen);
  focusable(buttons.find(x => x.material === chosen && !x.hidden) || buttons.find(x => !x.hidden));
  $("detail-value").textContent = state.detail.toFixed(2);
  $("edge").style.left = `${100 * state.split}%`;
  $("edge").hidden = state.split >= 1 || state.split <= 0;
  const text = state.regions.map((_, r) => {
    const [x, y, share] = mixture(r), name = x < 0 ? "unchanged" : spoken(H.materials[x].name);
    const part = state.regions.length > 1 ? `Part ${r + 1}: ` : "";
    return part + (share ? `${Math.round(100 * (1 - share))} % ${name} with ${Math.round(100 * share)} % ${spoken(H.materials[y].name)}` : name);
  }).join("; ");
  canvas.setAttribute("aria-label", `The photograph with its object as: ${text}`);
  status(`${text}${state.light ? `, under another light: ${H.lights[state.light].name}` : ""}${accelerated ? "" : " (drawn without WebGL)"}`);
  redraw();
}
function focusable(button) {
  for (const each of document.querySelectorAll(".tiles button")) each.tabIndex = each === button ? 0 : -1;
}
$("gallery").addEventListener("keydown", event => {
  const shown = [...document.querySelectorAll(".tiles button")].filter(b => !b.hidden && !b.closest("[hidden]"));
  const i = shown.indexOf(document.activeElement);
  if (i < 0) return;
  const y = b => b.getBoundingClientRect().top, here = shown[i].getBoundingClientRect();
  const vertical = (list, down) => {
    const row = list.find(b => down ? y(b) > here.top + 4 : y(b) < here.top - 4);
    if (!row) return null;
    return list.filter(b => Math.abs(y(b) - y(row)) < 4).sort((p, q) => Math.abs(p.getBoundingClientRect().left - here.left) - Math.abs(q.getBoundingClientRect().left - here.left))[0];
  };
  const next = {ArrowRight: () => shown[i + 1], ArrowLeft: () => shown[i - 1], Home: () => shown[0], End: () => shown.at(-1),
    ArrowDown: () => vertical(shown.slice(i), true), ArrowUp: () => vertical(shown.slice(0, i).reverse(), false)}[event.key]?.();
  if (next) { event.preventDefault(); focusable(next); next.focus(); }
});
$("search").addEventListener("input", () => {
  const wanted = $("search").value.toLowerCase().split(/[\s_-]+/).filter(Boolean);
  const hits = button => wanted.filter(word => button.words.includes(word)).length;
  const all = [...document.querySelectorAll(".tiles button")];
  // where no material has all words, those that have the most of them are close
  const most = Math.max(...all.map(hits));
  all.forEach(button => { button.hidden = wanted.length > 0 && (!most || hits(button) < most); });
  for (const group of $("gallery").children) group.hidden = [...group.querySelectorAll("button")].every(b => b.hidden);
  $("nothing").hidden = most === wanted.length;
  $("nothing").textContent = most ? "No material has that name. These are close:" : "No material of that name. Try a colour, or a class such as metal.";
  const first = all.find(b => !b.hidden);
  if (first) focusable(first);
});
for (const slot of [0, 1]) {
  $(`slot-${slot}`).addEventListener("click", () => { state.slot = slot; refresh(); });
  $(`slot-${slot}`).addEventListener("keydown", event => {
    if (!event.key.startsWith("Arrow")) return;
    event.preventDefault();
    state.slot = 1 - slot;
    refresh();
    $(`slot-${1 - slot}`).focus();
  });
}
$("blend").addEventListener("input", () => {
  for (const target of state.region < 0 ? state.regions : [current()]) target.blend = +$("blend").value;
  refresh();
});
$("detail").value = state.detail;
$("detail").addEventListener("input", () => { state.detail = +$("detail").value; refresh(); });
function showStops() {
  $("brightness-value").textContent = state.stops ? `${state.stops > 0 ? "+" : "−"}${Math.abs(state.stops)}` : "";
}
$("brightness").value = state.stops;
showStops();
$("brightness").addEventListener("input", () => { state.stops = +$("brightness").value; showStops(); refresh(); });
$("split").addEventListener("input", () => { state.split = +$("split").value; refresh(); });
const drag = event => {
  const box = canvas.getBoundingClientRect();
  $("split").value = state.split = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
  refresh();
};
$("frame").addEventListener("pointerdown", event => { $("frame").setPointerCapture(event.pointerId); drag(event); });
$("frame").addEventListener("pointermove", event => { if (event.buttons) drag(event); });
$("background").addEventListener("change", () => { state.ground = !$("background").checked; refresh(); });
function choices(box, name, options, chosen, change) {
  options.forEach(([value, text, picture]) => {
    const label = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, {type: "radio", name, value, checked: value === chosen});
    input.addEventListener("change", () => change(value));
    label.append(input);
    if (picture) { const image = new Image(); image.src = picture; image.alt = ""; label.append(image); }
    label.append(text);
    box.append(label);
  });
}
async function setLight(l) {
  status("Loading this light …");
  await loadLight(l);
  if (lights[state.light] && state.light !== l) lights[state.light].coarse.clear();
  state.light = l;
  tiles.forEach((button, m) => { stale.add(m); if (button.seen) paintTile(m); });
  refresh();
}
choices($("lights"), "light", H.lights.map((l, i) => [i, l.name, l.picture]), 0, setLight);
if (H.regions > 1) {
  $("regions").hidden = false;
  choices($("regions"), "region", [...state.regions.map((_, r) => [r, `Part ${r + 1}`]), [-1, "All parts"]], 0, r => { state.region = r; refresh(); });
}
for (const part of H.parts) {
  const figure = document.createElement("figure"), image = new Image(), caption = document.createElement("figcaption");
  image.src = part.picture;
  image.alt = caption.textContent = part.caption;
  figure.append(image, caption);
  $("parts").append(figure);
}
$("download").addEventListener("click", () => {
  const split = state.split;
  state.split = 1;
  draw();
  canvas.toBlob(blob => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${H.title}-edited.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  }, "image/png");
  state.split = split;
  redraw();
});
refresh();
draw();
// for tests, and for whoever opens the console
window.editPage = {state, draw, refresh, setLight, canvas, webgl: !!accelerated, materials: H.materials, lights: H.lights};
document.documentElement.dataset.ready = "yes";
})().catch(error => {
  document.getElementById("status").textContent = `This page could not be shown: ${error.message}. A newer browser may help.`;
  throw error;
});
