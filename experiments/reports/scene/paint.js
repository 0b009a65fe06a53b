// What everything in the scene is painted with: polygons, capsules and balls, rounded by shading.
(() => {
  "use strict";
  const { clamp } = playback;

  const shade = (rgb, k) => `rgb(${rgb.map((c) => clamp(Math.round(c * k), 0, 255)).join(",")})`;

  function polygon(ctx, camera, points) {
    const screen = points.map((p) => camera.project(p));
    if (screen.includes(null)) return false;
    ctx.beginPath();
    screen.forEach((s, i) => (i ? ctx.lineTo(s.x, s.y) : ctx.moveTo(s.x, s.y)));
    ctx.closePath();
    return true;
  }

  // outline of a capsule: the hull of two circles on the screen
  function capsulePath(ctx, a, b, ra, rb) {
    const dx = b.x - a.x, dy = b.y - a.y, d = Math.hypot(dx, dy);
    ctx.beginPath();
    if (d <= Math.abs(ra - rb)) {
      const [c, r] = ra > rb ? [a, ra] : [b, rb];
      ctx.arc(c.x, c.y, r, 0, 2 * Math.PI);
      return;
    }
    const along = Math.atan2(dy, dx), half = Math.acos((ra - rb) / d);
    ctx.arc(a.x, a.y, ra, along + half, along - half + 2 * Math.PI);
    ctx.arc(b.x, b.y, rb, along - half, along + half);
    ctx.closePath();
  }

  function capsule(ctx, camera, p, q, rp, rq, rgb) {
    const a = camera.project(p), b = camera.project(q);
    if (!a || !b) return;
    const ra = rp * a.scale, rb = rq * b.scale, r = Math.max(ra, rb);
    capsulePath(ctx, a, b, ra, rb);
    // round by light from the upper left
    let nx = -(b.y - a.y), ny = b.x - a.x;
    const n = Math.hypot(nx, ny) || 1;
    const sign = -0.6 * nx - 0.8 * ny < 0 ? -1 : 1;
    nx *= sign / n; ny *= sign / n;
    const mx = (a.x + b.x) / 2, my = (a.y + b.y) / 2;
    const across = ctx.createLinearGradient(mx + nx * r, my + ny * r, mx - nx * r, my - ny * r);
    across.addColorStop(0, shade(rgb, 0.95));
    across.addColorStop(0.3, shade(rgb, 1.18));
    across.addColorStop(0.65, shade(rgb, 0.85));
    across.addColorStop(1, shade(rgb, 0.52));
    ctx.fillStyle = across;
    ctx.fill();
  }

  function ball(ctx, camera, p, r, rgb) {
    const s = camera.project(p);
    if (!s) return;
    const R = r * s.scale, g = ctx.createRadialGradient(s.x - 0.35 * R, s.y - 0.4 * R, 0.1 * R, s.x, s.y, R);
    g.addColorStop(0, shade(rgb, 1.6));
    g.addColorStop(0.55, shade(rgb, 1));
    g.addColorStop(1, shade(rgb, 0.55));
    ctx.fillStyle = g;
    ctx.beginPath();
    ctx.arc(s.x, s.y, R, 0, 2 * Math.PI);
    ctx.fill();
  }

  Object.assign(playback, { shade, polygon, capsulePath, capsule, ball });
})();
