// Reads the data, plays the plan, fills the panel; any error takes the place of the page.

// ---------------------------------------------------------------- errors are told, never a blank page
function fail(message) {
  const box = document.getElementById("error");
  box.hidden = false;
  box.replaceChildren(Object.assign(document.createElement("b"), { textContent: "This cannot be shown" }),
                      document.createTextNode(message));
  window.takeapart = { error: message };
}

function readData() {
  const element = document.getElementById("data");
  if (!element || !element.textContent.trim()) throw new Error("The file ends before its data: it was cut off.");
  const text = element.textContent.trim();
  if (crc32(text) !== Number(element.dataset.checksum))
    throw new Error("The data in this file are damaged: their checksum does not fit. Ask for the file again.");
  const data = JSON.parse(text);
  if (data.format !== "takeapart/page" || data.version !== 3) throw new Error("The file holds nothing of a known version.");
  for (const part of data.parts)
    if (part.shape !== null && !data.shapes[part.shape]) throw new Error(`The shape of ${part.name} is missing.`);
  for (const step of data.steps) {
    step.joints = new Float32Array(bytes(step.joints));
    step.along = new Float32Array(bytes(step.along));
    step.path = new Float32Array(bytes(step.path));
    if (!data.parts[step.part] || step.joints.length !== step.rows * data.home.length || step.along.length !== step.rows)
      throw new Error(`The step that removes ${step.name} is damaged.`);
  }
  return data;
}

// ---------------------------------------------------------------- the whole
class Player {
  constructor(data) {
    this.data = data;
    this.arm = new Arm(data.robot);
    this.timeline = new Timeline(data.steps, data.playback);
    this.direction = data.direction;
    this.time = 0; this.playing = false; this.speed = 1; this.picked = null; this.frames = [];
    const canvas = document.getElementById("canvas"), painter = this.painter = new Painter(canvas);
    this.orbit = new Orbit(data.view, canvas, () => this.draw());
    this.shapes = data.shapes.map(shape => painter.mesh(shape));
    this.parts = data.parts.map(part => {  // what is drawn of each: its mesh, its boxes with the walls of its connectors
      const own = color(part.color), wall = own.map(c => c * 0.82);
      const boxes = part.boxes.length ? [{ shape: painter.boxes(part.boxes, k => k < part.own ? own : wall), paint: null }] : [];
      return part.shape === null ? boxes : [{ shape: this.shapes[part.shape], paint: own }, ...boxes];
    });
    this.obstacles = painter.boxes(data.obstacles, () => color(data.colors.obstacle));
    this.links = data.robot.links.map(link => link.meshes.map(mesh => ({ paint: mesh.color, shape: painter.mesh(mesh) })));
    this.hulls = data.robot.links.map(({ shadow }) => shadow
      && painter.shape(new Float32Array(bytes(shadow.positions)), null, new Uint16Array(bytes(shadow.faces))));
    this.tubes = data.steps.map(step => painter.tube(step.path, data.path_radius));
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
    if (k === place.step) return multiply(poses[this.data.robot.hand], this.data.steps[k].held);
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
    painter.begin(orbit.matrix, orbit.eye, data.view.light);
    painter.draw(this.obstacles, identity());
    const all = shadow => {
      models.forEach((model, i) => {
        if (!model) return;
        const current = held && held.part === i, chosen = this.picked === i;
        for (const { shape, paint } of this.parts[i])
          painter.draw(shape, model, shadow ? null : current ? color(data.colors.current) : paint, !shadow && chosen ? 0.3 : 0);
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
      if (!model) return;
      const met = part.boxes.map(box => hitBox(multiply(model, [...box.slice(0, 12), 0, 0, 0, 1]), box.slice(12), eye, ray));
      if (part.shape !== null) met.push(hitMesh(this.shapes[part.shape], model, eye, ray));
      for (const way of met) if (way < best) { best = way; found = i; }
    });
    this.choose(found);
  }

  choose(i) {
    this.picked = i;
    const box = document.getElementById("picked"), make = (tag, text, kind) => Object.assign(document.createElement(tag), { textContent: text, className: kind || "" });
    box.replaceChildren();
    if (i === null) box.append(make("p", this.data.steps.length ? "Click a part to see when it leaves, and why not earlier." : "Click a part to see its size and mass, and what has to leave before it.", "soft"));
    else {
      const part = this.data.parts[i], k = this.data.steps.findIndex(step => step.part === i), heading = make("h2", part.name);
      const spot = make("span", "", "dot"); spot.style.background = part.color; heading.prepend(spot);
      const rows = [["size", part.size.join(" × ") + " mm"], ["mass", part.mass.toFixed(3) + " kg"]];
      const shape = part.shape === null ? null : this.data.shapes[part.shape], drawn = shape && this.shapes[part.shape].count / 3;
      if (shape && drawn < shape.triangles) rows.push(["drawn with", `${drawn} of ${shape.triangles} triangles`]);
      if (k >= 0) rows.push(["step", `${this.number(k)} of ${this.data.steps.length}`], ["gripper path", metres(this.data.steps[k].length)],
                            ["straight-line bound", metres(part.bound)], ["grasp", this.data.steps[k].grasp]);
      box.append(heading, table(rows), make("p", part.why, "why"));
      if (this.direction === "assembly" && k >= 0) box.append(make("p", "Steps in this text are those of the disassembly.", "soft"));
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
    document.getElementById("clock").textContent = `playback ${this.time.toFixed(1)} of ${this.timeline.total.toFixed(1)} s`;
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
    const removable = data.parts.filter(part => !part.fixed).length;
    const rows = data.steps.length ? [["total gripper path", metres(data.total)]]  // otherwise there is nothing to play
      : [["parts", data.parts.length], ["removable", removable]];
    for (const id of ["bar", "list", "now"]) get(id).hidden = !data.steps.length;
    for (const [name, bound] of Object.entries(data.bounds))
      if (bound) rows.push([name, metres(bound)],
        [name.startsWith("sequence") ? "sequence gap" : "proved gap", `${(100 * (data.total - bound) / bound).toFixed(1)}%`]);
    const note = document.createElement("p");
    note.textContent = data.bounds_note;
    get("totals").replaceChildren(...this.partial(), table(rows), note);
    get("time").max = this.timeline.total;
    get("time").title = get("clock").title = data.playback.note;
    new ResizeObserver(() => this.ticks()).observe(get("line"));
    get("time").addEventListener("input", () => { this.pause(); this.time = +get("time").value; this.draw(); });
    get("play").addEventListener("click", () => this.playing ? this.pause() : this.play());
    get("forward").addEventListener("click", () => this.jump(1));
    get("back").addEventListener("click", () => this.jump(-1));
    for (const [name, speed] of Object.entries(data.playback.speeds)) get("speed").add(new Option(name, speed, speed === this.speed, speed === this.speed));
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
      if (e.target.matches("input,select,button") || !data.steps.length) return;
      if (e.key === " ") { e.preventDefault(); this.playing ? this.pause() : this.play(); }
      if (e.key === "ArrowRight") this.jump(1);
      if (e.key === "ArrowLeft") this.jump(-1);
    });
    this.list();
    this.choose(null);
  }

  partial() {  // how far a plan goes that leaves parts where they are
    const { data } = this, make = (tag, text, kind) => Object.assign(document.createElement(tag), { textContent: text, className: kind });
    if (!data.partial) return [];
    return [make("p", `Partial: ${data.partial}.`, "partial"), make("p", `Stated by the file: ${data.partial_claim}.`, "soft")];
  }

  list() {
    this.told = null;
    const ordered = this.data.steps.map((step, k) => [step, k]);
    if (this.direction === "assembly") ordered.reverse();
    this.ticks();
    document.getElementById("list").replaceChildren(...ordered.map(([step, k], n) => {
      const item = document.createElement("li"), button = document.createElement("button");
      for (const text of [n + 1, step.name, step.length.toFixed(3)]) button.append(Object.assign(document.createElement("span"), { textContent: text }));
      button.children[0].className = "soft";
      button.addEventListener("click", () => { this.time = this.stepTime(k) + 1e-6; this.choose(step.part); });
      item.append(button);
      return item;
    }));
  }

  ticks() {  // where each step begins; numbered as far as there is room
    const box = document.getElementById("ticks"), steps = this.data.steps;
    const each = Math.max(1, Math.ceil(steps.length * 22 / Math.max(box.clientWidth, 1)));
    box.replaceChildren(...steps.map((_, k) => {
      const n = this.number(k), tick = document.createElement("span");
      tick.textContent = (n - 1) % each ? "" : n;
      tick.style.left = `${100 * this.stepTime(k) / this.timeline.total}%`;
      return tick;
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
