// 3-D playback of a motion on a 2-D canvas: no WebGL, so that it runs on every machine, and no library.
// Here: vectors, the recorded motion, the eye. Lengths in metres, world frame, z up.
const playback = {};
(() => {
  "use strict";
  const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
  const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const times = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const size = (a) => Math.sqrt(dot(a, a));
  const unit = (a) => times(a, 1 / size(a));
  const middle = (a, b) => times(add(a, b), 0.5);
  const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

  // ---- the motion

  class Track {
    constructor({ name, frames }, columns) {
      this.name = name;
      const bytes = Uint8Array.from(atob(frames), (c) => c.charCodeAt(0));
      this.data = new Float32Array(bytes.buffer);
      this.columns = columns;
      this.count = this.data.length / columns;
    }

    // pose between two frames; `frame` is real-valued
    pose(frame, hips) {
      const i = clamp(Math.floor(frame), 0, this.count - 1), j = Math.min(i + 1, this.count - 1), w = clamp(frame - i, 0, 1);
      const row = new Array(this.columns);
      for (let c = 0; c < this.columns; c++) {
        row[c] = (1 - w) * this.data[i * this.columns + c] + w * this.data[j * this.columns + c];
      }
      const point = (c) => row.slice(c, c + 3);
      const position = point(0), R = rotation(row.slice(3, 7));
      const legs = hips.map((hip, leg) => ({
        haa: add(position, turn(R, hip)),
        hfe: point(7 + 9 * leg), knee: point(10 + 9 * leg), foot: point(13 + 9 * leg), force: point(43 + 3 * leg),
      }));
      return { position, R, legs };
    }
  }

  function rotation(q) {
    const n = Math.hypot(...q), [w, x, y, z] = q.map((c) => c / n);
    return [
      [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
      [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
      [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ];
  }
  const turn = (R, v) => R.map((r) => dot(r, v));

  // ---- the eye

  class Camera {
    constructor({ azimuth, elevation, distance, target }, x, y, width, height, zoom = 2.1) {
      const c = Math.cos(elevation);
      this.eye = add(target, times([c * Math.cos(azimuth), c * Math.sin(azimuth), Math.sin(elevation)], distance));
      this.forward = unit(sub(target, this.eye));
      this.right = unit(cross(this.forward, [0, 0, 1]));
      this.up = cross(this.right, this.forward);
      this.x = x + width / 2;
      this.y = y + height / 2;
      this.focal = zoom * Math.min(height, 0.75 * width);
    }

    // screen x, y, pixels per metre there; null behind the eye
    project(p) {
      const d = sub(p, this.eye), depth = dot(d, this.forward);
      if (depth < 0.05) return null;
      const scale = this.focal / depth;
      return { x: this.x + dot(d, this.right) * scale, y: this.y - dot(d, this.up) * scale, scale };
    }

    distance(p) { return size(sub(p, this.eye)); }
  }

  Object.assign(playback, { add, sub, times, dot, cross, size, unit, middle, clamp, turn, Track, Camera });
})();
