// What stands below the stage: a strip of pictures, and the time line with phases, torso height and contacts.
(() => {
  "use strict";
  const { add, times, clamp, Camera, SHADOW_SCALE, paintRobot, paintShadow } = playback;

  const LEG_COLOURS = ["#3a7fd0", "#e0802f", "#2a9d78", "#9a6cc9"];
  const MARGIN = { left: 46, right: 16, top: 20, legs: 80, row: 10, bottom: 18 };

  // The robot at some times from its right side, all at one scale, as in a sequence of photographs.
  function paintStrip(canvas, layer, track, scene, colours) {
    const ctx = canvas.getContext("2d"), height = canvas.clientHeight;
    const width = canvas.clientWidth / scene.snapshots.length, shown = scene.top + 0.16;
    ctx.clearRect(0, 0, canvas.clientWidth, height);
    scene.snapshots.forEach((time, n) => {
      const pose = track.pose(time / scene.period, scene.hips), below = scene.ground.below(pose.position);
      const view = { azimuth: -Math.PI / 2 + 0.22, elevation: 0.1, distance: 4.2, target: add(below, [0, 0, 0.45 * shown]) };
      const camera = new Camera(view, n * width, 0, width, height - 20);
      camera.focal = view.distance * Math.min(0.86 * (height - 22) / shown, 1.1 * width);
      const edges = [-1, 1].map((x) => camera.project(add(below, times(camera.right, 0.5 * x * width * view.distance / camera.focal))));
      ctx.strokeStyle = colours.line;
      ctx.lineWidth = 1;
      ctx.beginPath();
      ctx.moveTo(edges[0].x, edges[0].y);
      ctx.lineTo(edges[1].x, edges[1].y);
      ctx.stroke();
      paintShadow(ctx, layer, camera, pose, scene, colours.shadow);
      paintRobot(ctx, camera, pose, scene, colours.accent);
      ctx.fillStyle = colours.muted;
      ctx.font = `11.5px ${colours.sans}`;
      ctx.textAlign = "center";
      ctx.textBaseline = "alphabetic";
      ctx.fillText(`${time.toFixed(2)} s`, (n + 0.5) * width, height - 7);
    });
  }

  class Timeline {
    // heights: of the torso over the ground, per frame; contacts: of each leg, per frame
    constructor(canvas, scene, heights, contacts) {
      Object.assign(this, { canvas, scene, heights, contacts, last: (heights.length - 1) * scene.period });
    }

    get inner() { return this.canvas.clientWidth - MARGIN.left - MARGIN.right; }
    x(time) { return MARGIN.left + this.inner * time / this.last; }
    timeAt(x) { return clamp((x - MARGIN.left) / this.inner, 0, 1) * this.last; }

    paint(time, colours) {
      const ctx = this.canvas.getContext("2d"), foot = this.canvas.clientHeight - MARGIN.bottom;
      ctx.clearRect(0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
      ctx.textBaseline = "middle";
      ctx.font = `11px ${colours.sans}`;
      const label = (text, x, y, align, pixels) => {
        ctx.fillStyle = colours.muted;
        ctx.textAlign = align;
        ctx.font = `${pixels}px ${colours.sans}`;
        ctx.fillText(text, x, y);
      };
      this.paintSpans(ctx, label, foot, colours);
      this.paintHeight(ctx, label, colours);
      this.paintContacts(ctx, label);
      const step = [0.1, 0.2, 0.5, 1, 2, 5, 10].find((s) => this.x(s) - this.x(0) > 48) ?? 20;
      for (let k = 0; k * step <= this.last + 1e-9; k++) {
        label(`${(k * step).toFixed(step < 1 ? 1 : 0)} s`, this.x(k * step), foot + 10, "center", 10.5);
      }
      this.paintCursor(ctx, this.x(time), foot, colours.ink);
    }

    paintSpans(ctx, label, foot, colours) {
      this.scene.spans.forEach(([name, start, end], n) => {
        const from = this.x(start), to = this.x(Math.min(end, this.last));
        if (n % 2) { ctx.fillStyle = colours.wash; ctx.fillRect(from, 0, to - from, foot); }
        if (to - from > ctx.measureText(name).width + 4) label(name, (from + to) / 2, 10, "center", 11);
      });
    }

    paintHeight(ctx, label, colours) {
      const low = MARGIN.legs - 8, y = (h) => low - (low - MARGIN.top) * h / this.scene.top;
      ctx.beginPath();
      this.heights.forEach((h, k) => ctx.lineTo(this.x(k * this.scene.period), y(h)));
      ctx.strokeStyle = colours.accent;
      ctx.lineWidth = 1.6;
      ctx.stroke();
      label("torso", MARGIN.left - 8, y(this.heights[0]), "right", 11);
    }

    paintContacts(ctx, label) {
      const { period, legs } = this.scene, count = this.contacts.length;
      legs.forEach((leg, n) => {
        const top = MARGIN.legs + n * MARGIN.row;
        label(leg, MARGIN.left - 8, top + MARGIN.row / 2, "right", 9.5);
        ctx.fillStyle = LEG_COLOURS[n];
        for (let k = 0; k < count; k++) {
          if (!this.contacts[k][n]) continue;
          const start = k;
          while (k + 1 < count && this.contacts[k + 1][n]) k++;
          const from = this.x(start * period), to = this.x(Math.min(k + 1, count - 1) * period);
          ctx.fillRect(from, top + 1, Math.max(1, to - from), MARGIN.row - 2.5);
        }
      });
    }

    paintCursor(ctx, x, foot, ink) {
      ctx.fillStyle = ctx.strokeStyle = ink;
      ctx.lineWidth = 1.2;
      ctx.beginPath();
      ctx.moveTo(x, 4);
      ctx.lineTo(x, foot);
      ctx.stroke();
      ctx.beginPath();
      ctx.arc(x, foot, 4, 0, 2 * Math.PI);
      ctx.fill();
    }
  }

  Object.assign(playback, { paintStrip, Timeline });
})();
