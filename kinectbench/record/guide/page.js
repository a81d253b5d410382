"use strict";
// The guide's page: asks for the state four times a second, and for the object when it has grown.
(() => {
const ASK_MS = 250, RINGS = [60, 84, 108], RING_PX = 20, SECTORS = 12;
const by = id => document.getElementById(id), style = name => getComputedStyle(document.body).getPropertyValue(name);
let state = null, looks = -1, mesh = null, spoken = "";
let renderer = null, sized = "";
const scene = new THREE.Scene(), eye = new THREE.PerspectiveCamera(45, 1, 0.01, 100);
scene.add(new THREE.AmbientLight(0xffffff, 1.2));
const lamp = new THREE.DirectionalLight(0xffffff, 2);
scene.add(lamp);
eye.up.set(0, 0, 1);
try {
  renderer = new THREE.WebGLRenderer({ canvas: by("object"), antialias: true, alpha: true });
} catch {
  by("object").hidden = true;  // no WebGL here: the ring and the sentence are enough
}

async function ask(name) {
  const answer = await fetch(name, { cache: "no-store" });
  return answer.status === 200 ? answer : null;
}

async function grow() {
  const answer = await ask("mesh");
  if (!answer) return;
  const bytes = await answer.arrayBuffer(), [points, faces] = new Uint32Array(bytes, 0, 2);
  const made = new THREE.BufferGeometry();
  made.setAttribute("position", new THREE.BufferAttribute(new Float32Array(bytes, 8, 3 * points), 3));
  made.setIndex(new THREE.BufferAttribute(new Uint32Array(bytes, 8 + 12 * points, 3 * faces), 1));
  made.computeVertexNormals();
  if (mesh) { scene.remove(mesh); mesh.geometry.dispose(); }
  mesh = new THREE.Mesh(made, mesh ? mesh.material : new THREE.MeshLambertMaterial({ color: 0xcdbaa0, side: 2 }));
  scene.add(mesh);
  window.guideFaces = faces;
}

// The object from behind the camera and somewhat above it, so that left and right are those of who walks.
function draw() {
  if (!renderer || !state || !state.box) return;
  const canvas = by("object"), size = `${canvas.clientWidth}x${canvas.clientHeight}`;
  if (size !== sized) {
    sized = size;
    renderer.setSize(canvas.clientWidth, canvas.clientHeight, false);
    eye.aspect = canvas.clientWidth / Math.max(canvas.clientHeight, 1);
    eye.updateProjectionMatrix();
  }
  const [x, y, z] = state.box.center_m, reach = Math.hypot(...state.box.size_m);
  const from = state.pose ? [0, 1, 2].map(k => state.pose[k][3] - state.box.center_m[k]) : [1, 0, 0.5];
  const far = Math.hypot(...from) || 1;
  eye.position.set(x + from[0] / far * 2 * reach, y + from[1] / far * 2 * reach, z + from[2] / far * 2 * reach + 0.3 * reach);
  eye.lookAt(x, y, z);
  lamp.position.copy(eye.position);
  renderer.render(scene, eye);
}

function above() {
  const canvas = by("above"), pen = canvas.getContext("2d"), middle = canvas.width / 2;
  pen.clearRect(0, 0, canvas.width, canvas.height);
  if (!state || !state.box) return;
  const step = 2 * Math.PI / SECTORS;
  state.ring.forEach((heights, sector) => heights.forEach((seen, height) => {
    pen.beginPath();
    pen.lineWidth = RING_PX;
    pen.strokeStyle = style(seen ? "--seen" : "--faint");
    // The floor's y goes up on the page, as seen from above.
    pen.arc(middle, middle, RINGS[height], -(sector + 1) * step + 0.03, -sector * step - 0.03);
    pen.stroke();
  }));
  const [cx, cy] = state.box.center_m;
  const farthest = Math.max(0.5, ...state.path.map(p => Math.hypot(p[0] - cx, p[1] - cy)));
  const at = p => [middle + (p[0] - cx) / farthest * 150, middle - (p[1] - cy) / farthest * 150];
  pen.beginPath();
  pen.lineWidth = 2;
  pen.strokeStyle = style("--ink");
  state.path.forEach(p => pen.lineTo(...at(p)));
  pen.stroke();
  if (!state.pose) return;
  const here = [state.pose[0][3], state.pose[1][3]], look = [state.pose[0][2], state.pose[1][2]];
  const [u, v] = at(here), length = Math.hypot(...look) || 1;
  pen.strokeStyle = pen.fillStyle = style("--now");
  pen.lineWidth = 4;
  pen.beginPath();
  pen.arc(u, v, 6, 0, 7);
  pen.fill();
  pen.beginPath();
  pen.moveTo(u, v);
  pen.lineTo(u + look[0] / length * 24, v - look[1] / length * 24);
  pen.stroke();
  if (!state.turn_rad) return;
  // How far to go around the object until the opening is seen into.
  const from = Math.atan2(v - middle, u - middle), to = from - state.turn_rad;
  pen.setLineDash([4, 6]);
  pen.beginPath();
  pen.arc(middle, middle, Math.hypot(u - middle, v - middle), from, to, state.turn_rad > 0);
  pen.stroke();
  pen.setLineDash([]);
}

// A short tone when the sentence changes; browsers allow it after the first click on the page.
let sound = null;
addEventListener("pointerdown", () => { sound = sound || new AudioContext(); });
function tone() {
  if (!sound) return;
  const source = sound.createOscillator(), level = sound.createGain();
  level.gain.value = 0.1;
  source.connect(level).connect(sound.destination);
  source.start();
  source.stop(sound.currentTime + 0.15);
}

// A click is on the picture that is seen: a picture has its number once it is loaded, and one loads at a time.
function show(number) {
  const at = by("picture");
  if (at.dataset.loading || at.dataset.number === String(number)) return;
  at.dataset.loading = number;
  at.src = `picture?${number}`;
}
by("picture").addEventListener("load", event => {
  event.target.dataset.number = event.target.dataset.loading;
  delete event.target.dataset.loading;
});
by("picture").addEventListener("error", event => { delete event.target.dataset.loading; });

function showPicked() {
  const at = by("picked");
  at.hidden = !state.picked;
  const name = state.picked ? `picked?${state.picked.frame},${state.picked.pixel}` : "";
  if (name && at.getAttribute("src") !== name) at.src = name;
}

by("picture").addEventListener("click", async event => {
  const at = event.target, box = at.getBoundingClientRect();
  const told = { picture: Number(at.dataset.number), x: (event.clientX - box.left) / box.width, y: (event.clientY - box.top) / box.height };
  const answer = await fetch("pick", { method: "POST", body: JSON.stringify(told) });
  by("answer").className = answer.ok ? "picked" : "missed";
  by("answer").textContent = answer.ok ? "this is the object:" : await answer.text();
});

async function turn() {
  try {
    const answer = await ask("state");
    if (answer) {
      state = await answer.json();
      if (state.looks !== looks) { looks = state.looks; await grow(); }
      by("sentence").textContent = state.sentence;
      by("sentence").className = state.kind;
      if (state.sentence !== spoken) { spoken = state.sentence; tone(); }
      const distance = state.distance_m === null ? "" : `, ${state.distance_m.toFixed(2)} m away`;
      by("figures").textContent = `frame ${state.number}, ${state.speed_mps.toFixed(2)} m/s${distance}`;
      show(state.picture);
      showPicked();
      draw();
      above();
    }
  } catch {
    by("sentence").textContent = "the recording has ended";
    by("sentence").className = "";
  }
  setTimeout(turn, ASK_MS);
}
turn();
})();
