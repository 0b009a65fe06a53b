// The ground, a plane with obstacles and patches of other friction, and a measuring rod that stands on it.
(() => {
  "use strict";
  const { add, sub, times, dot, cross, size, unit, middle, clamp, shade, polygon, LIGHT } = playback;

  const STONE = [148, 155, 166];

  class Ground {
    constructor({ normal, offset, obstacles, patches }) {
      this.normal = normal;
      this.offset = offset;
      this.origin = times(normal, offset);
      this.t1 = unit(sub([1, 0, 0], times(normal, normal[0])));
      this.t2 = cross(normal, this.t1);
      this.obstacles = obstacles;
      this.patches = patches;
    }

    point(a, b, height = 0) {
      return add(add(add(this.origin, times(this.t1, a)), times(this.t2, b)), times(this.normal, height));
    }

    under(p) { return [dot(p, this.t1), dot(p, this.t2)]; }
    height(p) { return (dot(p, this.normal) - this.offset) / this.normal[2]; }
    below(p) { return add(p, [0, 0, -this.height(p)]); }

    shadow(p) {
      return add(p, times(LIGHT, (this.offset - dot(p, this.normal)) / dot(LIGHT, this.normal)));
    }

    paint(ctx, camera, centre, radius, colours) {
      const [ca, cb] = this.under(centre);
      ctx.fillStyle = colours.floor;
      for (let k = 0; k < 6; k++) {  // a soft edge
        const r = radius * (1 - 0.07 * k);
        const rim = Array.from({ length: 48 }, (_, i) => this.point(ca + r * Math.cos(i * Math.PI / 24), cb + r * Math.sin(i * Math.PI / 24)));
        ctx.globalAlpha = 0.3;
        if (polygon(ctx, camera, rim)) ctx.fill();
      }
      this.paintGrid(ctx, camera, ca, cb, radius, colours.line);
      ctx.globalAlpha = 1;
      for (const patch of this.patches) this.paintPatch(ctx, camera, patch, colours.line);
      for (const obstacle of this.obstacles) this.paintObstacle(ctx, camera, obstacle);
    }

    paintGrid(ctx, camera, ca, cb, radius, colour) {
      const step = 0.25, n = Math.ceil(radius / step), levels = Array.from({ length: 6 }, () => []);
      const a0 = Math.round(ca / step) * step, b0 = Math.round(cb / step) * step;
      for (let i = -n; i <= n; i++) for (let j = -n; j < n; j++) for (const swap of [false, true]) {
        const [a1, b1, a2, b2] = swap
          ? [a0 + i * step, b0 + j * step, a0 + i * step, b0 + (j + 1) * step]
          : [a0 + j * step, b0 + i * step, a0 + (j + 1) * step, b0 + i * step];
        const far = Math.hypot((a1 + a2) / 2 - ca, (b1 + b2) / 2 - cb) / radius;
        if (far < 1) levels[Math.floor((1 - far) * 5.999)].push([this.point(a1, b1), this.point(a2, b2)]);
      }
      ctx.strokeStyle = colour;
      ctx.lineWidth = 1;
      levels.forEach((segments, level) => {
        ctx.globalAlpha = Math.min(1, (level + 0.5) / 4);
        ctx.beginPath();
        for (const [p, q] of segments) {
          const a = camera.project(p), b = camera.project(q);
          if (a && b) { ctx.moveTo(a.x, a.y); ctx.lineTo(b.x, b.y); }
        }
        ctx.stroke();
      });
    }

    paintPatch(ctx, camera, { centre: [a, b], halfSize: [p, q] }, colour) {
      ctx.fillStyle = colour;
      ctx.globalAlpha = 0.45;
      if (polygon(ctx, camera, [this.point(a - p, b - q), this.point(a + p, b - q), this.point(a + p, b + q), this.point(a - p, b + q)])) ctx.fill();
      ctx.globalAlpha = 1;
    }

    // rings of equal height from the foot of the flank to the top, as the flank rises by t²(3 - 2t)
    paintObstacle(ctx, camera, { centre, half_size: half, yaw, height, flank }) {
      const c = Math.cos(yaw), s = Math.sin(yaw), steps = flank < 0.03 ? [0, 1] : [0, 0.25, 0.5, 0.75, 1];
      const ring = (t) => {
        const [p, q] = half.map((h) => Math.max(0, h + flank * (0.5 - t)));
        return [[p, q], [-p, q], [-p, -q], [p, -q]].map(([x, y]) =>
          this.point(centre[0] + c * x - s * y, centre[1] + s * x + c * y, height * t * t * (3 - 2 * t)));
      };
      const faces = [];
      for (let k = 1; k < steps.length; k++) {
        const low = ring(steps[k - 1]), high = ring(steps[k]);
        for (let i = 0; i < 4; i++) faces.push([low[i], low[(i + 1) % 4], high[(i + 1) % 4], high[i]]);
      }
      faces.push(ring(1));
      for (const face of faces.sort((a, b) => camera.distance(middle(b[0], b[2])) - camera.distance(middle(a[0], a[2])))) {
        const normal = cross(sub(face[1], face[0]), sub(face[3], face[0]));
        if (size(normal) === 0 || dot(normal, sub(camera.eye, face[0])) < 0) continue;
        if (!polygon(ctx, camera, face)) continue;
        ctx.fillStyle = ctx.strokeStyle = shade(STONE, 0.55 + 0.5 * clamp(-dot(unit(normal), LIGHT), 0, 1));
        ctx.fill();
        ctx.lineWidth = 0.75;
        ctx.stroke();
      }
    }
  }

  // A measuring rod beside the robot, always to its left on the screen.
  function paintRod(ctx, camera, pose, scene, colours) {
    const side = unit([camera.right[0], camera.right[1], 0]);
    const foot = scene.ground.below(sub(pose.position, times(side, 0.62)));
    const at = (h, out = 0) => camera.project(add(foot, add([0, 0, h], times(side, out))));
    ctx.strokeStyle = ctx.fillStyle = colours.faint;
    ctx.lineWidth = 1;
    ctx.font = `11px ${colours.sans}`;
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    ctx.beginPath();
    const ends = [at(0), at(scene.rod)];
    if (ends.includes(null)) return;
    ctx.moveTo(ends[0].x, ends[0].y);
    ctx.lineTo(ends[1].x, ends[1].y);
    for (let k = 0; k <= Math.round(scene.rod / 0.1); k++) {
      const p = at(0.1 * k), q = at(0.1 * k, -(k % 2 ? 0.012 : 0.025));
      ctx.moveTo(p.x, p.y);
      ctx.lineTo(q.x, q.y);
      if (k % 2 === 0) ctx.fillText((0.1 * k).toFixed(1), q.x - 5, q.y);
    }
    ctx.stroke();
    const mark = (h, colour, filled) => {
      const p = at(h, 0.008);
      ctx.strokeStyle = ctx.fillStyle = colour;
      ctx.beginPath();
      ctx.moveTo(p.x, p.y);
      ctx.lineTo(p.x + 9, p.y - 5);
      ctx.lineTo(p.x + 9, p.y + 5);
      ctx.closePath();
      filled ? ctx.fill() : ctx.stroke();
    };
    mark(scene.top, colours.faint, false);
    mark(scene.ground.height(pose.position), colours.accent, true);
  }

  Object.assign(playback, { Ground, paintRod });
})();
