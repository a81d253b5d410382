"use strict";
// The gallery: cells of 64^3 as surfaces of their faces, drawn by one WebGL context for all pictures.
(() => {
const N = 64, PAGE = 6;
const COLORS = {
  partial: [118, 160, 205], truth: [205, 186, 160], unseen: [240, 150, 20], prediction: [150, 178, 142],
  agreed: [190, 186, 178], missing: [43, 108, 180], extra: [208, 84, 40], uncounted: [222, 196, 96],
};
// A viewer stands 32 degrees to the right of the view's camera and somewhat above it.
const START = { azimuth: 32, elevation: 18 }, STEP_DEG = 10, DRAG_DEG_PX = 0.5;
const holder = document.getElementById("gallery"), cards = holder.querySelector(".cards");
const data = JSON.parse(document.getElementById("gallery-data").textContent);
const select = name => holder.querySelector(`select[name=${name}]`);

async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const packed = new Uint8Array(await new Response(stream).arrayBuffer()), cells = new Uint8Array(N * N * N);
  for (let i = 0; i < cells.length; i++) cells[i] = packed[i >> 3] >> (7 - (i & 7)) & 1;
  return cells;
}

// Grids have a margin of one empty cell, so that every cell has neighbours: index steps along x, y, z.
const M = N + 2, STEPS = [M * M, M, 1];
function padded(cells) {
  const grid = new Uint8Array(M * M * M);
  for (let x = 0; x < N; x++) for (let y = 0; y < N; y++)
    grid.set(cells.subarray((x * N + y) * N, (x * N + y + 1) * N), ((x + 1) * M + y + 1) * M + 1);
  return grid;
}

// A grid blurred by (1, 2, 1) / 4 along each axis, twice: its gradient is a surface's normal without steps.
function blurred(grid) {
  let from = Float32Array.from(grid);
  for (let pass = 0; pass < 6; pass++) {
    const step = STEPS[pass % 3], to = new Float32Array(from.length);
    for (let i = step; i < from.length - step; i++) to[i] = (from[i - step] + 2 * from[i] + from[i + step]) / 4;
    from = to;
  }
  return from;
}

// Faces of the cells of class `of`, towards cells that are not in `solid`; corners between others are darker.
function surface(classes, of, solid, color) {
  const grid = padded(solid), own = padded(classes), soft = blurred(grid);
  const position = [], normal = [], shade = [], index = [];
  const base = new THREE.Color().setRGB(color[0] / 255, color[1] / 255, color[2] / 255, THREE.SRGBColorSpace);
  const corners = [[0, 0], [1, 0], [1, 1], [0, 1]];
  for (let i = STEPS[0]; i < grid.length - STEPS[0]; i++) {
    if (own[i] !== of) continue;
    const cell = [Math.floor(i / STEPS[0]) - 1, Math.floor(i / M) % M - 1, i % M - 1];
    const slope = STEPS.map(step => soft[i - step] - soft[i + step]), length = Math.hypot(...slope) || 1;
    for (let axis = 0; axis < 3; axis++) for (const side of [1, -1]) {
      const u = (axis + 1) % 3, v = (axis + 2) % 3, front = i + side * STEPS[axis];
      if (grid[front]) continue;
      const first = position.length / 3, facing = slope.map((s, c) => s / length + (c === axis ? 0.5 * side : 0));
      const open = corners.map(([a, b]) => {
        const du = (2 * a - 1) * STEPS[u], dv = (2 * b - 1) * STEPS[v];
        return grid[front + du] && grid[front + dv] ? 0 : 3 - grid[front + du] - grid[front + dv] - grid[front + du + dv];
      });
      corners.forEach(([a, b], k) => {
        const corner = [...cell], lit = [0.76, 0.86, 0.94, 1][open[k]];
        corner[axis] += side > 0 ? 1 : 0; corner[u] += a; corner[v] += b;
        position.push(...corner);
        normal.push(...facing);
        shade.push(base.r * lit, base.g * lit, base.b * lit);
      });
      const quad = open[0] + open[2] >= open[1] + open[3] ? [0, 1, 2, 0, 2, 3] : [1, 2, 3, 1, 3, 0];
      if (side < 0) quad.reverse();
      quad.forEach(k => index.push(first + k));
    }
  }
  const geometry = new THREE.BufferGeometry(), floats = values => new THREE.BufferAttribute(new Float32Array(values), 3);
  geometry.setAttribute("position", floats(position));
  geometry.setAttribute("normal", floats(normal));
  geometry.setAttribute("color", floats(shade));
  geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(index), 1));
  geometry.normalizeNormals();
  return geometry;
}

const solidLook = new THREE.MeshLambertMaterial({ vertexColors: true });
const glassLook = new THREE.MeshLambertMaterial({ vertexColors: true, transparent: true, opacity: 0.42, depthWrite: false });

// The truth's cells, coloured by whether they were found, in a glass of what was predicted beyond them.
function errorMeshes(truth, prediction, known) {
  const classes = truth.map((t, i) => t && prediction[i] ? 1 : t ? (known[i] ? 2 : 4) : prediction[i] ? (known[i] ? 3 : 5) : 0);
  const either = classes.map(c => c ? 1 : 0);
  return [[1, "agreed"], [2, "missing"], [3, "extra"], [4, "uncounted"], [5, "uncounted"]].map(([of, name]) => {
    const beyond = of === 3 || of === 5;
    return new THREE.Mesh(surface(classes, of, beyond ? either : truth, COLORS[name]), beyond ? glassLook : solidLook);
  });
}

// The truth's cells, in a colour of their own where nobody saw them.
function truthMeshes(truth, unseen) {
  const classes = truth.map((t, i) => t ? (unseen[i] ? 2 : 1) : 0);
  return [[1, "truth"], [2, "unseen"]].map(([of, name]) =>
    new THREE.Mesh(surface(classes, of, truth, COLORS[name]), solidLook));
}

// The ball around every cell that is set in one of the grids.
function ball(grids) {
  const low = [N, N, N], high = [0, 0, 0], set = [];
  for (let i = 0; i < N * N * N; i++) {
    if (!grids.some(cells => cells[i])) continue;
    const cell = [i >> 12, i >> 6 & 63, i & 63];
    set.push(cell);
    cell.forEach((k, axis) => { low[axis] = Math.min(low[axis], k); high[axis] = Math.max(high[axis], k); });
  }
  if (!set.length) return { center: [N / 2, N / 2, N / 2], radius: N / 2 };
  const center = low.map((l, axis) => (l + high[axis] + 1) / 2);
  const reach = set.reduce((far, cell) => Math.max(far, Math.hypot(...cell.map((k, axis) => k + 0.5 - center[axis]))), 0);
  return { center, radius: reach + 1 };
}

let studio = null;
function openStudio() {
  const canvas = document.createElement("canvas");
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(22, 1, 1, 2000);
  const sun = new THREE.DirectionalLight(0xffffff, 2.0);
  sun.position.set(-0.45, 0.7, 0.75);
  camera.add(sun);
  scene.add(camera, new THREE.AmbientLight(0xffffff, 1.5));
  studio = { renderer, scene, camera };
}

function place(card) {
  const up = new THREE.Vector3(...card.pair.up), ahead = new THREE.Vector3(0, 0, 1);
  if (Math.abs(ahead.dot(up)) > 0.97) ahead.set(0, -1, 0);
  ahead.addScaledVector(up, -ahead.dot(up)).normalize();
  const a = card.azimuth * Math.PI / 180, e = card.elevation * Math.PI / 180;
  const across = ahead.clone().multiplyScalar(Math.cos(a)).addScaledVector(up.clone().cross(ahead), Math.sin(a));
  const forward = across.multiplyScalar(Math.cos(e)).addScaledVector(up, -Math.sin(e));
  const { camera } = studio, center = new THREE.Vector3(...card.ball.center);
  camera.up.copy(up);
  camera.position.copy(center).addScaledVector(forward, -card.ball.radius * 0.98 / Math.sin(11 * Math.PI / 180));
  camera.lookAt(center);
}

function draw(card) {
  if (!card.meshes) return;
  const { renderer, scene, camera } = studio;
  place(card);
  card.canvases.forEach((canvas, k) => {
    const px = Math.max(1, Math.round(canvas.clientWidth * Math.min(devicePixelRatio, 2)));
    if (canvas.width !== px) canvas.width = canvas.height = px;
    renderer.setSize(px, px, false);
    scene.add(...card.meshes[k]);
    renderer.render(scene, camera);
    scene.remove(...card.meshes[k]);
    const paper = canvas.getContext("2d");
    paper.clearRect(0, 0, px, px);
    paper.drawImage(renderer.domElement, 0, 0);
  });
  Object.assign(card.element.dataset, { drawn: "yes", azimuth: card.azimuth, elevation: card.elevation });
}

async function load(card) {
  const { pair, shown } = card;
  const [partial, truth, known, unseen, ...predictions] =
    await Promise.all([pair.partial, pair.full, pair.known, pair.unseen, ...shown.map(of => of.cells)].map(unpack));
  if (!card.element.isConnected) return;
  const plain = (cells, name) => [new THREE.Mesh(surface(cells, 1, cells, COLORS[name]), solidLook)];
  card.ball = ball([partial, truth, ...predictions]);
  card.meshes = [plain(partial, "partial"), ...predictions.map(of => plain(of, "prediction")),
    truthMeshes(truth, unseen), ...predictions.map(of => errorMeshes(truth, of, known))];
  draw(card);
}

function discard(card) {
  card.meshes?.flat().forEach(mesh => mesh.geometry.dispose());
  card.meshes = null;
}

function turn(card, azimuth, elevation) {
  card.azimuth = ((card.azimuth + azimuth) % 360 + 360) % 360;
  card.elevation = Math.min(85, Math.max(-60, card.elevation + elevation));
  cancelAnimationFrame(card.waiting);
  card.waiting = requestAnimationFrame(() => draw(card));
}

function listen(card, panes) {
  let from = null;
  panes.addEventListener("pointerdown", event => { from = [event.clientX, event.clientY]; panes.setPointerCapture(event.pointerId); });
  panes.addEventListener("pointermove", event => {
    if (!from) return;
    // A finger that moves up or down scrolls the page.
    const tilt = event.pointerType === "touch" ? 0 : (event.clientY - from[1]) * DRAG_DEG_PX;
    turn(card, (event.clientX - from[0]) * DRAG_DEG_PX, tilt);
    from = [event.clientX, event.clientY];
  });
  ["pointerup", "pointercancel"].forEach(name => panes.addEventListener(name, () => { from = null; }));
  panes.addEventListener("dblclick", () => turn(card, START.azimuth - card.azimuth, START.elevation - card.elevation));
  const keys = { ArrowLeft: [-STEP_DEG, 0], ArrowRight: [STEP_DEG, 0], ArrowUp: [0, STEP_DEG], ArrowDown: [0, -STEP_DEG] };
  panes.addEventListener("keydown", event => {
    if (!keys[event.key]) return;
    event.preventDefault();
    turn(card, ...keys[event.key]);
  });
}

function element(name, properties, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

// The methods side by side: above what is seen and their predictions, below the truth and their errors.
function makeCard(methods, name) {
  const pair = data.pairs[name], of = methods.filter(method => method.pairs[name]), shown = of.map(method => method.pairs[name]);
  const captions = ["partial", ...of.map(method => method.name), "truth", ...of.map(method => `error of ${method.name}`)];
  const canvases = captions.map(() => element("canvas", { width: 1, height: 1 }));
  const panes = element("div", { className: "panes", tabIndex: 0 },
    ...captions.map((caption, k) => element("figure", {}, canvases[k], element("figcaption", { textContent: caption }))));
  panes.style.setProperty("--methods", of.length + 1);
  panes.setAttribute("role", "group");
  panes.setAttribute("aria-label", `${name}: ${captions.join(", ")}; arrow keys turn`);
  const far = one => one.chamfer_m === null ? "–" : `– (Chamfer ${(1000 * one.chamfer_m).toFixed(1)} mm)`;
  const under = one => one.under ? ` (${one.under})` : "";
  const iou = "IoU " + shown.map(one => (one.iou === null ? far(one) : one.iou.toFixed(3)) + under(one)).join(" and ");
  const view = pair.picture ? [element("img", { className: "view", src: pair.picture, alt: `view ${name}` })] : [];
  const larger = element("button", { type: "button", className: "larger", textContent: "larger" });
  const head = element("h4", {}, name, element("span", { className: "note", textContent: ` ${pair.category}` }),
    element("span", { className: "iou", textContent: iou }), larger);
  const card = { ...START, pair, shown, canvases, element: element("article", { className: "card" }, head, ...view, panes) };
  larger.addEventListener("click", () => {
    larger.textContent = card.element.classList.toggle("large") ? "smaller" : "larger";
    draw(card);
  });
  card.element.dataset.pair = name;
  listen(card, panes);
  return card;
}

let live = [], limit = PAGE;
const watcher = new IntersectionObserver(entries => entries.forEach(entry => {
  const card = live.find(c => c.element === entry.target);
  if (!card || !entry.isIntersecting) return;
  watcher.unobserve(entry.target);
  load(card).catch(error => { card.element.append(element("p", { className: "alert", textContent: String(error) })); });
}), { rootMargin: "300px" });

function names(method) {
  const category = select("category").value, order = select("order").value, iou = name => method.pairs[name].iou ?? -1 - (method.pairs[name].chamfer_m ?? 0);
  const found = Object.keys(method.pairs).filter(name => !category || data.pairs[name].category === category).sort();
  if (order === "worst") found.sort((a, b) => iou(a) - iou(b));
  if (order === "best") found.sort((a, b) => iou(b) - iou(a));
  return found;
}

function show(wanted) {
  const method = data.methods[select("method").value], beside = data.methods[select("beside").value], found = names(method);
  const methods = beside && beside !== method ? [method, beside] : [method];
  if (wanted) limit = Math.max(limit, found.indexOf(wanted) + 1);
  live.forEach(card => { watcher.unobserve(card.element); discard(card); });
  live = found.slice(0, limit).map(name => makeCard(methods, name));
  cards.replaceChildren(...live.map(card => card.element));
  live.forEach(card => watcher.observe(card.element));
  holder.querySelector(".more").hidden = found.length <= limit;
  const target = wanted && live.find(card => card.element.dataset.pair === wanted);
  if (target) { target.element.scrollIntoView({ block: "center" }); target.element.querySelector(".panes").focus({ preventScroll: true }); }
}

try {
  openStudio();
} catch {
  cards.append(element("p", { className: "alert", textContent: "This browser cannot draw in 3-D (WebGL is off)." }));
  holder.querySelector(".controls").hidden = holder.querySelector(".more").hidden = true;
  return;
}
data.methods.forEach((method, k) => ["method", "beside"].forEach(name => select(name).append(new Option(method.name, k))));
select("beside").append(new Option("none", ""));
select("beside").value = data.methods.length > 1 ? 1 : "";
const categories = [...new Set(Object.values(data.pairs).map(pair => pair.category))].sort();
[["all", ""], ...categories.map(name => [name, name])].forEach(([text, value]) => select("category").append(new Option(text, value)));
holder.querySelectorAll("select").forEach(one => one.addEventListener("change", () => { limit = PAGE; show(); }));
holder.querySelector(".more").addEventListener("click", () => { limit += PAGE; show(); });
window.addEventListener("resize", () => live.forEach(draw));
document.querySelectorAll("a[data-pair]").forEach(link => {
  const at = data.methods.findIndex(method => method.name === link.dataset.method);
  if (at < 0 || !data.methods[at].pairs[link.dataset.pair]) return;
  link.href = "#gallery-title";
  link.addEventListener("click", event => {
    event.preventDefault();
    select("method").value = at;
    select("category").value = "";
    show(link.dataset.pair);
  });
});
show();
})();
