// WebGL and the camera.

// ---------------------------------------------------------------- drawing
const VERTEX = `#version 300 es
in vec3 position; in vec3 normal; in vec3 tint;
uniform mat4 camera, model; uniform vec3 low, size, sun; uniform float flatten;
out vec3 n, c, w;
void main() {
  vec4 p = model * vec4(low + size * position, 1.0);
  if (flatten > -100.0) { p.xyz -= sun * ((p.z - flatten) / sun.z); p.z = flatten + 0.0006; }
  n = mat3(model) * normal; c = tint; w = p.xyz;
  gl_Position = camera * p;
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 n, c, w; uniform vec3 eye, paint, sun; uniform float alpha, own, glow; out vec4 color;
void main() {
  vec3 N = normalize(n), V = normalize(eye - w);
  if (dot(N, V) < 0.0) N = -N;
  vec3 L = normalize(sun);
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

  // triangles as the data hold them; a pick looks at them too
  mesh({ positions, normals, faces, wide, low, size }) {
    const points = new Uint16Array(bytes(positions)), corners = wide ? new Uint32Array(bytes(faces)) : new Uint16Array(bytes(faces));
    if (corners.some(corner => 3 * corner >= points.length)) throw new Error("A triangle has a corner that does not exist.");
    return { ...this.shape(points, new Int8Array(bytes(normals)), corners, null, low, size), points, corners };
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

  begin(camera, eye, sun) {
    const gl = this.gl, ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(this.canvas.clientWidth * ratio)), height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    if (this.canvas.width !== width || this.canvas.height !== height) { this.canvas.width = width; this.canvas.height = height; }
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.uniformMatrix4fv(this.at("camera"), true, camera);
    gl.uniform3fv(this.at("eye"), eye);
    gl.uniform3fv(this.at("sun"), sun);
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

// ---------------------------------------------------------------- what a ray meets first: how far away, or infinity
const SLACK = 0.002;  // m, by which boxes are larger for a ray

function hitBox(T, half, eye, ray) {  // slabs
  const from = minus(eye, [T[3], T[7], T[11]]);
  let near = 0, far = Infinity;
  for (let a = 0; a < 3; a++) {
    const axis = [T[a], T[4 + a], T[8 + a]], o = dot(axis, from), d = dot(axis, ray), h = half[a] + SLACK;
    const [t1, t2] = Math.abs(d) < 1e-9 ? (Math.abs(o) < h ? [-Infinity, Infinity] : [Infinity, -Infinity]) : [(-h - o) / d, (h - o) / d];
    near = Math.max(near, Math.min(t1, t2)); far = Math.min(far, Math.max(t1, t2));
  }
  return near <= far ? near : Infinity;
}

function hitMesh({ points, corners, low, size }, T, eye, ray) {  // Moeller and Trumbore 1997
  const middle = low.map((l, a) => l + size[a] / 2), half = size.map(s => s / 2);
  const place = [0, 1, 2].map(r => T[4 * r] * middle[0] + T[4 * r + 1] * middle[1] + T[4 * r + 2] * middle[2] + T[4 * r + 3]);
  const bounds = [T[0], T[1], T[2], place[0], T[4], T[5], T[6], place[1], T[8], T[9], T[10], place[2], 0, 0, 0, 1];
  if (hitBox(bounds, half, eye, ray) === Infinity) return Infinity;
  const away = minus(eye, [T[3], T[7], T[11]]), inside = v => [0, 1, 2].map(a => T[a] * v[0] + T[4 + a] * v[1] + T[8 + a] * v[2]);
  const from = inside(away), along = inside(ray), at = corner => [0, 1, 2].map(a => low[a] + size[a] * points[3 * corner + a] / 65535);
  let best = Infinity;
  for (let k = 0; k < corners.length; k += 3) {
    const a = at(corners[k]), u = minus(at(corners[k + 1]), a), v = minus(at(corners[k + 2]), a), p = cross(along, v), d = dot(u, p);
    if (Math.abs(d) < 1e-18) continue;
    const s = minus(from, a), x = dot(s, p) / d, q = cross(s, u), y = dot(along, q) / d, way = dot(v, q) / d;
    if (x >= 0 && y >= 0 && x + y <= 1 && way > 0 && way < best) best = way;
  }
  return best;
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

