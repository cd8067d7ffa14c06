"use strict";
// A point cloud to turn round, drawn into a canvas with a depth buffer of its own: no libraries, no graphics card, no network.
// The page shows a still picture until this has run, and on paper.

function start(host) {
  const scene = JSON.parse(host.querySelector(".scene").textContent);
  const cloud = unpack(host.querySelector(".points").textContent.trim(), scene);
  const canvas = host.querySelector("canvas"), context = canvas.getContext("2d", {willReadFrequently: true});
  const axes = frame(scene.forward, scene.up);
  const reach = Math.hypot(...scene.size) / 2;
  const close = {yaw: 0, pitch: 0, distance: 2.3 * reach, target: scene.centre};
  const all = around(scene);
  // Devices far from a small cloud would make it a speck.
  const first = {...(all.distance > 6 * reach ? close : all), yaw: -0.5, pitch: 0.45};
  let eye = {...first}, outlines = true, waiting = false;

  function redraw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  }

  function draw() {
    const ratio = Math.min(window.devicePixelRatio || 1, 1.5);
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const view = look(eye, axes, width, height);
    const picture = blank(context, width, height);
    drawPoints(picture, cloud, scene.splat, view);
    const style = getComputedStyle(host);
    if (outlines) for (const line of scene.lines) drawLine(picture, line, view, Math.round(2 * ratio), style);
    context.putImageData(picture.image, 0, 0);
    if (outlines) for (const line of scene.lines) if (line.text) write(context, line, view, ratio, style);
    scaleBar(context, scene.unit, view.focal / eye.distance, width, height, ratio, style);
  }

  function turn(right, up) {
    eye.yaw += right;
    eye.pitch = Math.max(-1.5, Math.min(1.5, eye.pitch + up));
    redraw();
  }
  function zoom(factor) {
    eye.distance = Math.max(0.05 * reach, Math.min(12 * reach, eye.distance * factor));
    redraw();
  }
  function shift(right, up) {
    const view = look(eye, axes, 1, 1), step = eye.distance;
    eye.target = eye.target.map((value, i) => value - step * (right * view.right[i] + up * view.up[i]));
    redraw();
  }

  const keys = {
    ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
  };
  canvas.addEventListener("keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (keys[event.key]) {
      const [x, y] = keys[event.key];
      if (event.shiftKey) shift(-0.05 * x, -0.05 * y); else turn(0.1 * x, 0.1 * y);
    } else if (event.key === "+" || event.key === "=") zoom(0.85);
    else if (event.key === "-") zoom(1 / 0.85);
    else if (event.key === "Home" || event.key === "0") { eye = {...first}; redraw(); }
    else return;
    event.preventDefault();
  });

  const fingers = new Map();
  canvas.addEventListener("pointerdown", event => {
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, event => fingers.delete(event.pointerId));
  canvas.addEventListener("pointermove", event => {
    if (!fingers.has(event.pointerId)) return;
    const before = [...fingers.values()], spread = apart(before), [x, y] = fingers.get(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    const dx = (event.clientX - x) / canvas.clientHeight, dy = (event.clientY - y) / canvas.clientHeight;
    if (fingers.size > 1) {
      zoom(spread / Math.max(1, apart([...fingers.values()])));
      shift(dx / 2, -dy / 2);
    } else if (event.shiftKey || event.buttons === 2) shift(dx, -dy);
    else turn(-3 * dx, 3 * dy);
  });
  // The page scrolls under the wheel until the picture was chosen.
  canvas.addEventListener("wheel", event => {
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    zoom(Math.exp(Math.sign(event.deltaY) * 0.12));
  }, {passive: false});
  canvas.addEventListener("contextmenu", event => event.preventDefault());

  const views = {start: first, front: close, above: {...close, pitch: 1.5}};
  for (const button of host.querySelectorAll("button[data-view]")) button.addEventListener("click", () => {
    eye = {...views[button.dataset.view]};
    redraw();
  });
  host.querySelector("input").addEventListener("change", event => { outlines = event.target.checked; redraw(); });
  new ResizeObserver(redraw).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  host.classList.add("live");
  redraw();
}

function unpack(base64, scene) {
  const bytes = Uint8Array.from(atob(base64), letter => letter.charCodeAt(0)), data = new DataView(bytes.buffer);
  const count = scene.count, at = new Float32Array(3 * count), rgb = new Uint8Array(3 * count), normal = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) for (let k = 0; k < 3; k++) {
    at[3 * i + k] = scene.low[k] + scene.size[k] * data.getUint16(12 * i + 2 * k, true) / 65535;
    rgb[3 * i + k] = bytes[12 * i + 6 + k];
    normal[3 * i + k] = data.getInt8(12 * i + 9 + k) / 127;
  }
  return {count, at, rgb, normal};
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => a.map(value => value / Math.hypot(...a));
const apart = ([a, b]) => b ? Math.hypot(a[0] - b[0], a[1] - b[1]) : 1;

// Level forward, right and up, from any forward and up.
function frame(forward, up) {
  const u = unit(up), lift = dot(forward, u), level = unit(forward.map((value, i) => value - lift * u[i]));
  return {level, right: unit(cross(level, u)), up: u};
}

// The picture's axes in the cloud's frame, the eye's place, and the focal length in pixels.
function look(eye, axes, width, height) {
  const [sy, cy, sp, cp] = [Math.sin(eye.yaw), Math.cos(eye.yaw), Math.sin(eye.pitch), Math.cos(eye.pitch)];
  const ahead = axes.level.map((value, i) => cy * value + sy * axes.right[i]);
  const right = axes.right.map((value, i) => cy * value - sy * axes.level[i]);
  const forward = ahead.map((value, i) => cp * value - sp * axes.up[i]);
  const up = ahead.map((value, i) => sp * value + cp * axes.up[i]);
  const place = eye.target.map((value, i) => value - eye.distance * forward[i]);
  return {forward, right, up, place, focal: 1.2 * Math.min(width, 1.5 * height), near: 0.02 * eye.distance, x: width / 2, y: height / 2};
}

// From where everything is in the picture, both devices too.
function around(scene) {
  const high = scene.low.map((value, i) => value + scene.size[i]);
  const points = [scene.low, high, ...scene.lines.flatMap(line => line.at)];
  const ends = [0, 1, 2].map(i => [Math.min(...points.map(point => point[i])), Math.max(...points.map(point => point[i]))]);
  return {target: ends.map(([low, top]) => (low + top) / 2), distance: Math.hypot(...ends.map(([low, top]) => top - low))};
}

function blank(context, width, height) {
  const image = context.createImageData(width, height);
  return {image, width, height, pixels: new Uint32Array(image.data.buffer), depth: new Float32Array(width * height).fill(Infinity)};
}

function square(picture, column, row, side, far, colour) {
  const {width, height, pixels, depth} = picture;
  const left = Math.round(column - side / 2), top = Math.round(row - side / 2);
  if (left < 0 || top < 0 || left + side > width || top + side > height) return;
  for (let v = top * width; v < (top + side) * width; v += width) for (let w = v + left; w < v + left + side; w++)
    if (far < depth[w]) { depth[w] = far; pixels[w] = colour; }
}

function drawPoints(picture, cloud, splat, view) {
  const {at, rgb, normal} = cloud, {forward, right, up, place, focal, near} = view;
  const lamp = unit(forward.map((value, i) => -value - 0.5 * right[i] + 0.6 * up[i]));
  for (let i = 0; i < 3 * cloud.count; i += 3) {
    const x = at[i] - place[0], y = at[i + 1] - place[1], z = at[i + 2] - place[2];
    const far = x * forward[0] + y * forward[1] + z * forward[2];
    // Surfaces seen from behind are left out, so that one looks into a room through its walls.
    if (far < near || x * normal[i] + y * normal[i + 1] + z * normal[i + 2] > 0) continue;
    const scale = focal / far, side = Math.max(1, Math.min(9, Math.round(scale * splat)));
    const light = 0.45 + 0.55 * Math.max(0, lamp[0] * normal[i] + lamp[1] * normal[i + 1] + lamp[2] * normal[i + 2]);
    const colour = 255 << 24 | light * rgb[i + 2] << 16 | light * rgb[i + 1] << 8 | light * rgb[i];
    square(picture,
      view.x + scale * (x * right[0] + y * right[1] + z * right[2]),
      view.y - scale * (x * up[0] + y * up[1] + z * up[2]), side, far, colour);
  }
}

// A point in the picture: column, row and distance; null if it is behind the eye.
function seen(point, view) {
  const from = point.map((value, i) => value - view.place[i]), far = dot(from, view.forward);
  if (far < view.near) return null;
  return [view.x + view.focal * dot(from, view.right) / far, view.y - view.focal * dot(from, view.up) / far, far];
}

function drawLine(picture, line, view, thickness, style) {
  const name = line.colour.startsWith("--") ? style.getPropertyValue(line.colour).trim() : line.colour;
  const [r, g, b] = [1, 3, 5].map(i => parseInt(name.slice(i, i + 2), 16)), colour = 255 << 24 | b << 16 | g << 8 | r;
  const ends = line.at.map(point => seen(point, view));
  for (let i = line.closed ? 0 : 1; i < ends.length; i++) {
    const a = ends.at(i - 1), c = ends[i];
    if (!a || !c) continue;
    const steps = Math.ceil(Math.min(4000, Math.hypot(c[0] - a[0], c[1] - a[1])));
    for (let k = 0; k <= steps; k++) {
      const share = steps ? k / steps : 0, mix = index => a[index] + share * (c[index] - a[index]);
      // One over the distance is what changes evenly along a line; a little nearer, so that outlines lie on their faces.
      const far = 0.99 / (1 / a[2] + share * (1 / c[2] - 1 / a[2]));
      square(picture, mix(0), mix(1), thickness, far, colour);
    }
  }
}

// A round length at the distance that one turns about, as long as an eighth to a quarter of the picture.
function scaleBar(context, [factor, name], pixels, width, height, ratio, style) {
  const most = width / 4 / pixels * factor, decade = 10 ** Math.floor(Math.log10(most));
  const length = decade * [5, 2, 1].find(step => step * decade <= most), long = length / factor * pixels;
  const left = 16 * ratio, row = height - 16 * ratio;
  context.strokeStyle = style.getPropertyValue("--ink");
  context.lineWidth = 2 * ratio;
  context.beginPath();
  for (const [x, y] of [[0, -6], [0, 0], [long, 0], [long, -6 * ratio]]) context.lineTo(left + x, row + y);
  context.stroke();
  label(context, `${Number(length.toPrecision(3))} ${length === 1 && name === "baselines" ? "baseline" : name}`, [left + long / 2, row - 8 * ratio], ratio, style);
}

function label(context, text, place, ratio, style) {
  context.font = `600 ${14 * ratio}px ${style.fontFamily}`;
  context.textAlign = "center";
  context.lineWidth = 4 * ratio;
  context.strokeStyle = style.getPropertyValue("--panel");
  context.fillStyle = style.getPropertyValue("--ink");
  context.strokeText(text, ...place);
  context.fillText(text, ...place);
}

function write(context, line, view, ratio, style) {
  const points = line.at.map(point => seen(point, view));
  if (points.includes(null)) return;
  const middle = [0, 1].map(k => points.reduce((sum, point) => sum + point[k], 0) / points.length);
  label(context, line.text, middle, ratio, style);
}

for (const host of document.querySelectorAll(".viewer")) start(host);
