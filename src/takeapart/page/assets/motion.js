"use strict";
// Poses, the arm's forward kinematics, and when what happens. Poses are 16 numbers, row by row, as in the data; they are handed to WebGL
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

// ---------------------------------------------------------------- the arm
class Arm {
  constructor(robot) { this.robot = robot; }

  // what the joints of the gripper stand at, linear between the openings of the table
  gripper(opening) {
    const { openings, positions } = this.robot, last = openings.length - 1;
    let k = 1;
    while (k < last && openings[k] < opening) k++;
    const share = last < 1 ? 0 : Math.min(Math.max((opening - openings[k - 1]) / (openings[k] - openings[k - 1]), 0), 1);
    return positions.map(row => last < 1 ? row[0] : row[k - 1] * (1 - share) + row[k] * share);
  }

  poses(q, opening) {
    const T = [], values = [...q, ...this.gripper(opening)];
    for (const link of this.robot.links) {
      let pose = multiply(link.parent < 0 ? this.robot.base : T[link.parent], link.pose);
      if (link.joint >= 0) {
        const value = link.follows[0] * values[link.joint] + link.follows[1];
        pose = multiply(pose, link.slides ? translation(...link.axis.map(a => a * value)) : rotation(link.axis, value));
      }
      T.push(pose);
    }
    return T;
  }
}

// ---------------------------------------------------------------- time: grip, move, let go, for every step
class Timeline {
  // playback: grip in s, tool_speed in m/s, fingers_open in m
  constructor(steps, playback) {
    this.steps = steps; this.playback = playback;
    this.starts = [0];
    for (const step of steps) this.starts.push(this.starts.at(-1) + 2 * playback.grip + step.along.at(-1) / playback.tool_speed);
    this.total = this.starts.at(-1);
  }

  // where a plan stands at a time of the disassembly: step, fraction of its path, opening beyond the grasp
  at(time) {
    let k = 0;
    while (k < this.steps.length - 1 && time >= this.starts[k + 1]) k++;
    const { grip, fingers_open } = this.playback;
    const t = time - this.starts[k], way = this.starts[k + 1] - this.starts[k] - 2 * grip;
    const fraction = Math.min(Math.max((t - grip) / way, 0), 1);
    const opened = t < grip ? 1 - t / grip : t > grip + way ? Math.min((t - grip - way) / grip, 1) : 0;
    return { step: k, fraction, extra: fingers_open * opened };
  }

  configuration(k, fraction, n) {
    const { along, joints, rows } = this.steps[k], wanted = fraction * along.at(-1);
    let low = 0, high = rows - 1;
    while (high - low > 1) { const mid = (low + high) >> 1; if (along[mid] <= wanted) low = mid; else high = mid; }
    const span = along[high] - along[low], share = span > 0 ? Math.min((wanted - along[low]) / span, 1) : 1;
    return Array.from({ length: n }, (_, j) => joints[low * n + j] * (1 - share) + joints[high * n + j] * share);
  }
}

