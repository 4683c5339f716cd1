"use strict";
// Plays a plan: data in, WebGL out. Poses are 16 numbers, row by row, as in the data; they are handed to WebGL
// transposed. Distances in m, angles in rad, times in s.

// ---------------------------------------------------------------- rigid transforms
const identity = () => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

function multiply(a, b) {
  const c = new Array(16);
  for (let i = 0; i < 4; i++)
    for (let j = 0; j < 4; j++)
      c[4 * i + j] = a[4 * i] * b[j] + a[4 * i + 1] * b[4 + j] + a[4 * i + 2] * b[8 + j] + a[4 * i + 3] * b[12 + j];
  return c;
}

function rotation(axis, angle) {  // Rodrigues
  const [x, y, z] = axis, c = Math.cos(angle), s = Math.sin(angle), t = 1 - c;
  return [t * x * x + c, t * x * y - s * z, t * x * z + s * y, 0, t * x * y + s * z, t * y * y + c, t * y * z - s * x, 0,
          t * x * z - s * y, t * y * z + s * x, t * z * z + c, 0, 0, 0, 0, 1];
}

const translation = (x, y, z) => [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const plus = (a, b, k = 1) => [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]];
const unit = a => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };

function bytes(text) {
  const raw = atob(text), found = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) found[i] = raw.charCodeAt(i);
  return found.buffer;
}

const color = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16) / 255);

function crc32(text) {  // of ASCII text
  let crc = -1;
  const table = crc32.table ||= Array.from({ length: 256 }, (_, n) => {
    for (let k = 0; k < 8; k++) n = n & 1 ? (n >>> 1) ^ 0xedb88320 : n >>> 1;
    return n;
  });
  for (let i = 0; i < text.length; i++) crc = table[(crc ^ text.charCodeAt(i)) & 255] ^ (crc >>> 8);
  return (crc ^ -1) >>> 0;
}

// ---------------------------------------------------------------- errors are told, never a blank page
function fail(message) {
  const box = document.getElementById("error");
  box.hidden = false;
  box.replaceChildren(Object.assign(document.createElement("b"), { textContent: "This plan cannot be shown" }),
                      document.createTextNode(message));
  window.takeapart = { error: message };
}

function readData() {
  const element = document.getElementById("data");
  if (!element || !element.textContent.trim()) throw new Error("The file ends before the plan: it was cut off.");
  const text = element.textContent.trim();
  if (crc32(text) !== window.takeapartChecksum)
    throw new Error("The plan in this file is damaged: its checksum does not fit. Ask for the file again.");
  const data = JSON.parse(text);
  if (data.format !== "takeapart/page" || data.version !== 1) throw new Error("The file holds no plan of a known version.");
  for (const step of data.steps) {
    step.joints = new Float32Array(bytes(step.joints));
    step.along = new Float32Array(bytes(step.along));
    step.path = new Float32Array(bytes(step.path));
    if (!data.parts[step.part] || step.joints.length !== step.rows * data.home.length || step.along.length !== step.rows)
      throw new Error(`The step that removes ${step.name} is damaged.`);
  }
  return data;
}

// ---------------------------------------------------------------- the arm
class Arm {
  constructor(robot) { this.robot = robot; }

  poses(q, opening) {
    const T = [];
    for (const link of this.robot.links) {
      let pose = multiply(link.parent < 0 ? this.robot.base : T[link.parent], link.pose);
      if (link.joint !== -1) {
        const value = link.joint === -2 ? opening / 2 : q[link.joint];
        pose = multiply(pose, link.slides ? translation(...link.axis.map(a => a * value)) : rotation(link.axis, value));
      }
      T.push(pose);
    }
    return T;
  }

  tool(poses) { return multiply(poses[this.robot.hand], translation(...this.robot.tool)); }
}

// ---------------------------------------------------------------- time: grip, move, let go, for every step
const GRIP = 0.4, SPEED = 0.25, OPEN = 0.02;  // s, m/s, m

class Timeline {
  constructor(steps) {
    this.steps = steps;
    this.starts = [0];
    for (const step of steps) this.starts.push(this.starts.at(-1) + 2 * GRIP + step.along.at(-1) / SPEED);
    this.total = this.starts.at(-1);
  }

  // where a plan stands at a time of the disassembly: step, fraction of its path, opening beyond the grasp
  at(time) {
    let k = 0;
    while (k < this.steps.length - 1 && time >= this.starts[k + 1]) k++;
    const t = time - this.starts[k], way = this.starts[k + 1] - this.starts[k] - 2 * GRIP;
    const fraction = Math.min(Math.max((t - GRIP) / way, 0), 1);
    const extra = t < GRIP ? OPEN * (1 - t / GRIP) : t > GRIP + way ? OPEN * Math.min((t - GRIP - way) / GRIP, 1) : 0;
    return { step: k, fraction, extra };
  }

  configuration(k, fraction, n) {
    const { along, joints, rows } = this.steps[k], wanted = fraction * along.at(-1);
    let low = 0, high = rows - 1;
    while (high - low > 1) { const mid = (low + high) >> 1; if (along[mid] <= wanted) low = mid; else high = mid; }
    const span = along[high] - along[low], share = span > 0 ? Math.min((wanted - along[low]) / span, 1) : 1;
    return Array.from({ length: n }, (_, j) => joints[low * n + j] * (1 - share) + joints[high * n + j] * share);
  }
}

// ---------------------------------------------------------------- drawing
const VERTEX = `#version 300 es
in vec3 position; in vec3 normal; in vec3 tint;
uniform mat4 camera, model; uniform vec3 low, size; uniform float flatten;
out vec3 n, c, w;
void main() {
  vec4 p = model * vec4(low + size * position, 1.0);
  if (flatten > -100.0) { p.xyz -= vec3(-0.38, -0.55, 1.0) * ((p.z - flatten) / 1.0); p.z = flatten + 0.0006; }
  n = mat3(model) * normal; c = tint; w = p.xyz;
  gl_Position = camera * p;
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 n, c, w; uniform vec3 eye, paint; uniform float alpha, own, glow; out vec4 color;
void main() {
  vec3 N = normalize(n), V = normalize(eye - w);
  if (dot(N, V) < 0.0) N = -N;
  vec3 L = normalize(vec3(-0.38, -0.55, 1.0));
  float diffuse = max(dot(N, L), 0.0), sky = 0.5 + 0.5 * N.z;
  float fill = max(dot(N, normalize(vec3(0.7, 0.4, 0.2))), 0.0);
  float gloss = pow(max(dot(N, normalize(L + V)), 0.0), 40.0) * 0.12;
  vec3 base = own > 0.5 ? c : paint;
  vec3 lit = base * (0.42 + 0.16 * sky + 0.44 * diffuse + 0.10 * fill + glow) + gloss;
  color = vec4(alpha < 1.0 ? paint : lit, alpha);
}`;

function drawnInSoftware() {  // without a graphics card smooth edges would cost several times the rest
  const gl = document.createElement("canvas").getContext("webgl2"), names = gl && gl.getExtension("WEBGL_debug_renderer_info");
  const name = names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
  if (gl) gl.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

class Painter {
  constructor(canvas) {
    this.canvas = canvas;
    const gl = this.gl = canvas.getContext("webgl2", { stencil: true, alpha: false, antialias: !drawnInSoftware() });
    if (!gl) throw new Error("This browser has no WebGL 2, which the view needs.");
    const program = this.program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    ["position", "normal", "tint"].forEach((name, i) => gl.bindAttribLocation(program, i, name));
    gl.linkProgram(program);
    gl.useProgram(program);
    this.at = name => this[`_${name}`] ??= gl.getUniformLocation(program, name);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0.957, 0.965, 0.976, 1);
  }

  // positions, normals and tints may be typed arrays of any kind; integers are taken as fractions
  shape(positions, normals, faces, tints = null, low = [0, 0, 0], size = [1, 1, 1]) {
    const gl = this.gl, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    [positions, normals, tints].forEach((values, i) => {
      if (!values) return gl.vertexAttrib3f(i, 1, 1, 1);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      const kind = values instanceof Uint16Array ? gl.UNSIGNED_SHORT : values instanceof Int8Array ? gl.BYTE : gl.FLOAT;
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, 3, kind, kind !== gl.FLOAT, 3 * values.BYTES_PER_ELEMENT, 0);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
    const kind = faces instanceof Uint32Array ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT;
    gl.bindVertexArray(null);
    return { array, count: faces.length, kind, low, size, own: tints ? 1 : 0 };
  }

  // boxes in one frame: each 12 numbers of its pose and 3 half extents
  boxes(list, tint) {
    const positions = [], normals = [], tints = [], faces = [];
    list.forEach((box, number) => {
      for (let axis = 0; axis < 3; axis++) for (const sign of [1, -1]) {
        const first = positions.length / 3, u = (axis + 1) % 3, v = (axis + 2) % 3;
        for (const [a, b] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
          const p = [0, 0, 0];
          p[axis] = sign * box[12 + axis]; p[u] = a * box[12 + u]; p[v] = b * box[12 + v];
          for (let r = 0; r < 3; r++) {
            positions.push(box[4 * r] * p[0] + box[4 * r + 1] * p[1] + box[4 * r + 2] * p[2] + box[4 * r + 3]);
            normals.push(sign * box[4 * r + axis]);
            tints.push(tint(number)[r]);
          }
        }
        faces.push(first, first + 1, first + 2, first, first + 2, first + 3);
      }
    });
    return this.shape(new Float32Array(positions), new Float32Array(normals), new Uint16Array(faces), new Float32Array(tints));
  }

  // a tube along points (x, y, z, x, ...)
  tube(points, radius) {
    const positions = [], normals = [], faces = [], sides = 7, count = points.length / 3;
    for (let i = 0; i < count; i++) {
      const at = k => points.subarray(3 * k, 3 * k + 3);
      const along = unit(minus(at(Math.min(i + 1, count - 1)), at(Math.max(i - 1, 0))));
      const side = unit(cross(along, Math.abs(along[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0])), up = cross(side, along);
      for (let s = 0; s < sides; s++) {
        const a = 2 * Math.PI * s / sides, n = plus(side.map(x => x * Math.cos(a)), up, Math.sin(a));
        positions.push(...plus([...at(i)], n, radius));
        normals.push(...n);
        if (i) { const b = i * sides, t = (s + 1) % sides; faces.push(b + s - sides, b + t - sides, b + s, b + t - sides, b + t, b + s); }
      }
    }
    return this.shape(new Float32Array(positions), new Float32Array(normals), new Uint16Array(faces));
  }

  begin(camera, eye) {
    const gl = this.gl, ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(this.canvas.clientWidth * ratio)), height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    if (this.canvas.width !== width || this.canvas.height !== height) { this.canvas.width = width; this.canvas.height = height; }
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.uniformMatrix4fv(this.at("camera"), true, camera);
    gl.uniform3fv(this.at("eye"), eye);
    this.mode(null);
  }

  mode(floor) {  // null: solid; a height: everything as its shadow on that height, each pixel once
    const gl = this.gl;
    gl.uniform1f(this.at("flatten"), floor ?? -1000);
    gl.uniform1f(this.at("alpha"), floor === null ? 1 : 0.13);
    if (floor === null) { gl.disable(gl.BLEND); gl.disable(gl.STENCIL_TEST); gl.depthMask(true); return; }
    gl.enable(gl.BLEND); gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.enable(gl.STENCIL_TEST); gl.stencilFunc(gl.EQUAL, 0, 255); gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    gl.depthMask(false);
  }

  draw(shape, model, paint = null, glow = 0) {
    const gl = this.gl;
    gl.uniformMatrix4fv(this.at("model"), true, model);
    gl.uniform3fv(this.at("low"), shape.low);
    gl.uniform3fv(this.at("size"), shape.size);
    gl.uniform3fv(this.at("paint"), paint || [0.12, 0.14, 0.18]);
    gl.uniform1f(this.at("own"), paint ? 0 : shape.own);
    gl.uniform1f(this.at("glow"), glow);
    gl.bindVertexArray(shape.array);
    gl.drawElements(gl.TRIANGLES, shape.count, shape.kind, 0);
  }
}

// ---------------------------------------------------------------- the camera goes around a point
class Orbit {
  constructor(view, canvas, changed) {
    this.target = [...view.target]; this.distance = view.distance; this.field = view.field; this.canvas = canvas;
    const d = view.direction.map(x => -x);
    this.azimuth = Math.atan2(d[1], d[0]); this.elevation = Math.asin(d[2]);
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", e => { this.moved = 0; this.pointers.set(e.pointerId, e); canvas.setPointerCapture(e.pointerId); });
    canvas.addEventListener("pointermove", e => { if (this.pointers.has(e.pointerId)) { this.drag(e); changed(); } });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, e => this.pointers.delete(e.pointerId));
    canvas.addEventListener("wheel", e => { e.preventDefault(); this.distance *= Math.exp(e.deltaY * 0.001); changed(); }, { passive: false });
    canvas.addEventListener("contextmenu", e => e.preventDefault());
  }

  drag(e) {
    const before = this.pointers.get(e.pointerId), dx = e.clientX - before.clientX, dy = e.clientY - before.clientY;
    const others = [...this.pointers.values()].filter(p => p.pointerId !== e.pointerId);
    this.moved += Math.abs(dx) + Math.abs(dy);
    if (others.length) {  // two fingers: zoom by their distance, shift by their middle
      const far = p => Math.hypot(p.clientX - others[0].clientX, p.clientY - others[0].clientY) + 1;
      this.distance *= far(before) / far(e);
      this.shift(dx / 2, dy / 2);
    } else if (e.buttons & 2 || e.shiftKey) this.shift(dx, dy);
    else {
      this.azimuth -= dx * 0.006;
      this.elevation = Math.min(Math.max(this.elevation + dy * 0.006, -0.2), 1.55);
    }
    this.pointers.set(e.pointerId, e);
  }

  get axes() {
    const [a, e] = [this.azimuth, this.elevation];
    const back = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)], right = [-Math.sin(a), Math.cos(a), 0];
    return { back, right, up: cross(back, right) };
  }

  shift(dx, dy) {
    const { right, up } = this.axes, scale = 2 * this.distance * Math.tan(this.field / 2) / this.canvas.clientHeight;
    this.target = plus(plus(this.target, right, -dx * scale), up, dy * scale);
  }

  get tangents() {  // narrow windows see as much across as wide ones do
    const aspect = this.canvas.clientWidth / this.canvas.clientHeight, v = Math.tan(this.field / 2) * Math.max(1, 1.25 / aspect);
    return [v * aspect, v];
  }

  get eye() { return plus(this.target, this.axes.back, this.distance); }

  get matrix() {
    const { back, right, up } = this.axes, eye = this.eye, [h, v] = this.tangents, near = 0.05, far = 30;
    const view = [...right, -dot(right, eye), ...up, -dot(up, eye), ...back, -dot(back, eye), 0, 0, 0, 1];
    const lens = [1 / h, 0, 0, 0, 0, 1 / v, 0, 0, 0, 0, (far + near) / (near - far), 2 * far * near / (near - far), 0, 0, -1, 0];
    return multiply(lens, view);
  }

  ray(x, y) {  // through a pixel of the canvas
    const { back, right, up } = this.axes, [h, v] = this.tangents;
    const across = (2 * x / this.canvas.clientWidth - 1) * h, above = (1 - 2 * y / this.canvas.clientHeight) * v;
    return unit(plus(plus(back.map(b => -b), right, across), up, above));
  }
}

// ---------------------------------------------------------------- the whole
class Player {
  constructor(data) {
    this.data = data;
    this.arm = new Arm(data.robot);
    this.timeline = new Timeline(data.steps);
    this.direction = data.direction;
    this.time = 0; this.playing = false; this.speed = 1; this.picked = null; this.frames = [];
    const canvas = document.getElementById("canvas"), painter = this.painter = new Painter(canvas);
    this.orbit = new Orbit(data.view, canvas, () => this.draw());
    this.parts = data.parts.map(part => {
      const own = color(part.color), wall = own.map(c => c * 0.82);
      return painter.boxes(part.boxes, k => k < part.own ? own : wall);
    });
    this.obstacles = painter.boxes(data.obstacles, () => color(data.colors.obstacle));
    this.links = data.robot.links.map(link => link.meshes.map(mesh => ({
      paint: mesh.color,
      shape: painter.shape(new Uint16Array(bytes(mesh.positions)), new Int8Array(bytes(mesh.normals)),
        mesh.wide ? new Uint32Array(bytes(mesh.faces)) : new Uint16Array(bytes(mesh.faces)), null, mesh.low, mesh.size),
    })));
    this.hulls = data.robot.links.map(({ shadow }) => shadow
      && painter.shape(new Float32Array(bytes(shadow.positions)), null, new Uint16Array(bytes(shadow.faces))));
    this.tubes = data.steps.map(step => painter.tube(step.path, 0.004));
    this.goal = painter.boxes([[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.011, 0.011, 0.011]], () => color(data.colors.goal));
    this.controls();
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // time of the disassembly, whichever way it is played
  get place() { return this.timeline.at(this.direction === "disassembly" ? this.time : this.timeline.total - this.time); }

  stepTime(k) {  // when a step begins as it is played
    return this.direction === "disassembly" ? this.timeline.starts[k] : this.timeline.total - this.timeline.starts[k + 1];
  }

  number(k) { return this.direction === "disassembly" ? k + 1 : this.data.steps.length - k; }

  model(i, place, poses) {  // pose of a part, null where it is hidden
    const k = this.data.steps.findIndex(step => step.part === i), part = this.data.parts[i];
    if (k < 0 || k > place.step) return part.pose;
    if (k === place.step) return multiply(this.arm.tool(poses), this.data.steps[k].tool);
    return document.getElementById("laid").checked ? part.laid : null;
  }

  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(now => { this.waiting = false; this.frame(now); });
  }

  frame(now) {
    if (this.playing) {
      if (this.last !== undefined) { this.frames.push(now - this.last); this.time += Math.min(now - this.last, 250) / 1000 * this.speed; }
      this.last = now;
      if (this.time >= this.timeline.total) { this.time = this.timeline.total; this.pause(); }
    }
    const { data, painter, orbit } = this, place = this.place, steps = data.steps;
    const held = steps.length ? steps[place.step] : null;
    const q = held ? this.timeline.configuration(place.step, place.fraction, data.home.length) : data.home;
    const poses = this.arm.poses(q, held ? Math.min(held.width + place.extra, data.opening) : data.opening);
    const models = data.parts.map((_, i) => this.model(i, place, poses));
    painter.begin(orbit.matrix, orbit.eye);
    painter.draw(this.obstacles, identity());
    const all = shadow => {
      models.forEach((model, i) => {
        if (!model) return;
        const current = held && held.part === i, chosen = this.picked === i;
        painter.draw(this.parts[i], model, !shadow && current ? color(data.colors.current) : null, !shadow && chosen ? 0.3 : 0);
      });
      if (shadow) poses.forEach((pose, k) => this.hulls[k] && painter.draw(this.hulls[k], pose));
      else poses.forEach((pose, k) => this.links[k].forEach(mesh => painter.draw(mesh.shape, pose, mesh.paint)));
    };
    painter.mode(data.floor);
    all(true);
    painter.mode(null);
    all(false);
    painter.draw(this.goal, translation(...data.goal));
    if (held) painter.draw(this.tubes[place.step], identity(), color(data.colors.path), 0.2);
    if (document.getElementById("paths").checked)
      steps.forEach((step, k) => { if (k !== place.step) painter.draw(this.tubes[k], identity(), color(data.parts[step.part].color)); });
    this.models = models;
    this.tell(place);
    if (!window.takeapart.firstPicture) { painter.gl.finish(); window.takeapart.firstPicture = performance.now(); }
    if (this.playing) this.draw();
  }

  pick(x, y) {
    const eye = this.orbit.eye, ray = this.orbit.ray(x, y);
    let best = Infinity, found = null;
    this.data.parts.forEach((part, i) => {
      const model = this.models[i];
      if (model) for (const box of part.boxes) {
        const T = multiply(model, [...box.slice(0, 12), 0, 0, 0, 1]), from = minus(eye, [T[3], T[7], T[11]]);
        let near = 0, far = Infinity;
        for (let a = 0; a < 3; a++) {  // slabs
          const axis = [T[a], T[4 + a], T[8 + a]], o = dot(axis, from), d = dot(axis, ray), h = box[12 + a] + 0.002;
          const [t1, t2] = Math.abs(d) < 1e-9 ? (Math.abs(o) < h ? [-Infinity, Infinity] : [Infinity, -Infinity]) : [(-h - o) / d, (h - o) / d];
          near = Math.max(near, Math.min(t1, t2)); far = Math.min(far, Math.max(t1, t2));
        }
        if (near <= far && near < best) { best = near; found = i; }
      }
    });
    this.choose(found);
  }

  choose(i) {
    this.picked = i;
    const box = document.getElementById("picked"), make = (tag, text, kind) => Object.assign(document.createElement(tag), { textContent: text, className: kind || "" });
    box.replaceChildren();
    if (i === null) box.append(make("p", "Click a part to see when it leaves, and why not earlier.", "soft"));
    else {
      const part = this.data.parts[i], k = this.data.steps.findIndex(step => step.part === i), heading = make("h2", part.name);
      const spot = make("span", "", "dot"); spot.style.background = part.color; heading.prepend(spot);
      const rows = [["size", part.size.join(" × ") + " mm"], ["mass", part.mass.toFixed(3) + " kg"]];
      if (k >= 0) rows.push(["step", `${this.number(k)} of ${this.data.steps.length}`], ["gripper path", metres(this.data.steps[k].length)],
                            ["straight-line bound", metres(part.bound)], ["grasp", this.data.steps[k].grasp]);
      box.append(heading, table(rows), make("p", part.why, "why"));
      if (part.alternatives.length) {
        box.append(make("p", "Other removals in the library:", "soft"));
        box.append(table(part.alternatives.map(a => [metres(a.length), (a.blockers.length ? `without ${a.blockers.join(", ")}` : "in any state") +
          (a.step ? `: from step ${a.step} of the disassembly` : "")])));
      }
      const refused = Object.entries(part.refusals);
      if (refused.length) box.append(make("p", `Refused ${refused.map(([stage, n]) => `${n}× at ${stage}`).join(", ")}.`, "soft"));
    }
    this.draw();
  }

  tell(place) {
    const { data } = this, steps = data.steps, key = `${place.step} ${this.direction}`;
    document.getElementById("time").value = this.time;
    if (this.told === key) return;
    this.told = key;
    const ordered = this.direction === "disassembly" ? steps : [...steps].reverse(), number = steps.length ? this.number(place.step) : 0;
    const running = ordered.slice(0, number).reduce((sum, step) => sum + step.length, 0);
    const now = document.getElementById("now"), step = steps[place.step];
    if (step) now.replaceChildren(table([["step", `${number} of ${steps.length}`], ["part", step.name], ["grasp", step.grasp],
      ["gripper path", metres(step.length)], ["running total", metres(running)]]));
    document.querySelectorAll("#list button").forEach((button, k) => {
      button.setAttribute("aria-current", k === number - 1);
      button.classList.toggle("gone", k < number - 1);
      if (k === number - 1 && this.playing) button.scrollIntoView({ block: "nearest" });
    });
  }

  controls() {
    const get = id => document.getElementById(id), { data } = this;
    document.title = get("title").textContent = data.title;
    const rows = [["total gripper path", metres(data.total)]];
    for (const [name, bound] of Object.entries(data.bounds))
      if (bound) rows.push([name, `${metres(bound)}, gap ${(100 * (data.total - bound) / bound).toFixed(1)} %`]);
    get("totals").replaceChildren(table(rows));
    get("time").max = this.timeline.total;
    get("time").addEventListener("input", () => { this.pause(); this.time = +get("time").value; this.draw(); });
    get("play").addEventListener("click", () => this.playing ? this.pause() : this.play());
    get("forward").addEventListener("click", () => this.jump(1));
    get("back").addEventListener("click", () => this.jump(-1));
    get("speed").addEventListener("change", () => { this.speed = +get("speed").value; });
    for (const id of ["laid", "paths"]) get(id).addEventListener("change", () => this.draw());
    get("direction").value = this.direction;
    get("direction").addEventListener("change", () => {
      this.direction = get("direction").value; this.time = this.timeline.total - this.time;
      this.list(); this.draw();
      if (this.picked !== null) this.choose(this.picked);
    });
    const canvas = this.painter.canvas;
    canvas.addEventListener("click", e => { if (this.orbit.moved < 6) this.pick(e.offsetX, e.offsetY); });
    window.addEventListener("keydown", e => {
      if (e.target.matches("input,select,button")) return;
      if (e.key === " ") { e.preventDefault(); this.playing ? this.pause() : this.play(); }
      if (e.key === "ArrowRight") this.jump(1);
      if (e.key === "ArrowLeft") this.jump(-1);
    });
    this.list();
  }

  list() {
    this.told = null;
    const ordered = this.data.steps.map((step, k) => [step, k]);
    if (this.direction === "assembly") ordered.reverse();
    document.getElementById("list").replaceChildren(...ordered.map(([step, k], n) => {
      const item = document.createElement("li"), button = document.createElement("button");
      for (const text of [n + 1, step.name, step.length.toFixed(3)]) button.append(Object.assign(document.createElement("span"), { textContent: text }));
      button.children[0].className = "soft";
      button.addEventListener("click", () => { this.time = this.stepTime(k) + 1e-6; this.choose(step.part); });
      item.append(button);
      return item;
    }));
  }

  jump(by) {  // to the beginning of the next step, or of this one or the one before
    this.pause();
    const starts = this.data.steps.map((_, k) => this.stepTime(k)).sort((a, b) => a - b), after = starts.filter(t => t > this.time + 1e-3);
    const before = starts.filter(t => t < this.time - 0.05);
    this.time = by > 0 ? (after.length ? after[0] + 1e-6 : this.timeline.total) : (before.length ? before.at(-1) + 1e-6 : 0);
    this.draw();
  }

  play() {
    if (this.time >= this.timeline.total) this.time = 0;
    this.playing = true; this.last = undefined; this.frames = [];
    document.getElementById("play").textContent = "\u275A\u275A";
    document.getElementById("play").setAttribute("aria-label", "Pause");
    this.draw();
  }

  pause() {
    this.playing = false;
    document.getElementById("play").textContent = "\u25B6\uFE0E";
    document.getElementById("play").setAttribute("aria-label", "Play");
  }
}

const metres = value => value === null ? "-" : `${value.toFixed(3)} m`;

function table(rows) {
  const list = document.createElement("dl");
  for (const [name, value] of rows)
    list.append(Object.assign(document.createElement("dt"), { textContent: name }), Object.assign(document.createElement("dd"), { textContent: value }));
  return list;
}

window.addEventListener("error", e => fail(e.message));
document.addEventListener("DOMContentLoaded", () => {
  try {
    window.takeapart = {};
    const player = new Player(readData());
    window.takeapart.player = player;
    player.draw();
  } catch (error) {
    fail(error.message);
  }
});
