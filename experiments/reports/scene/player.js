// The player: controls, mouse and keys, and the clock. Its state stands in the element's data attributes.
(() => {
  "use strict";
  const { add, size, clamp, Track, Camera, Ground, Timeline } = playback;
  const { SHADOW_SCALE, paintRobot, paintShadow, paintForces, paintRod, paintStrip } = playback;

  const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1], USUAL_SPEED = 0.25;
  const VIEW = { azimuth: -0.95, elevation: 0.2, distance: 2.8 };
  const ARROW = 0.5;  // m, of the largest force
  const GROUND_CLEARANCE = 0.15;  // m, of the eye
  const COLOURS = ["ink", "muted", "faint", "accent", "floor", "shadow", "wash", "sans"];
  const CONTROLS = `
    <div class="stage"><canvas></canvas><div class="readout"></div></div>
    <canvas class="line strip"></canvas>
    <canvas class="line time" role="slider" aria-label="Time" aria-valuemin="0"></canvas>
    <div class="bar">
      <button class="play">Play</button>
      <label>Speed <select class="speed"></select></label>
      <label><input type="checkbox" class="forces" checked> Forces</label>
      <label class="ghost-label"><input type="checkbox" class="ghost"> <span></span></label>
      <button class="view">Reset view</button>
      <span class="hint">Drag to turn, Ctrl + scroll to zoom, space to play, ← → to step</span>
    </div>`;

  class Player {
    constructor(root) {
      this.root = root;
      const content = JSON.parse(root.querySelector("script").textContent);
      this.tracks = content.tracks.map((track) => new Track(track, content.columns));
      this.scene = { ...content, ground: new Ground(content.ground) };
      this.time = content.poster;
      this.started = false;  // until then the poster is shown, and playing begins at the start
      this.playing = false;
      this.view = { ...VIEW };
      this.shadowLayer = document.createElement("canvas");
      this.ghostLayer = document.createElement("canvas");
      this.build();
      this.measure();
      this.connect();
      this.layout();
    }

    build() {
      const { root } = this, get = (selector) => root.querySelector(selector), ghost = this.tracks[1];
      root.insertAdjacentHTML("beforeend", CONTROLS);
      Object.assign(this, {
        stage: get(".stage canvas"), strip: get(".strip"), bar: get(".time"), readout: get(".readout"),
        button: get(".play"), speed: get(".speed"), forces: get(".forces"), ghost: get(".ghost"),
      });
      for (const s of SPEEDS) this.speed.add(new Option(`${s}×`, s, s === USUAL_SPEED, s === USUAL_SPEED));
      if (ghost) get(".ghost-label span").textContent = ghost.name;
      else get(".ghost-label").remove();
      if (!this.scene.snapshots.length) this.strip.remove();
    }

    // extremes of the whole motion: they scale the arrows, the rod and the height curve
    measure() {
      const { scene } = this, heights = [], contacts = [];
      let force = 1;
      for (let k = 0; k < this.tracks[0].count; k++) {
        const pose = this.tracks[0].pose(k, scene.hips);
        heights.push(scene.ground.height(pose.position));
        contacts.push(pose.legs.map((leg) => size(leg.force) >= scene.contactForce));
        force = Math.max(force, ...pose.legs.map((leg) => size(leg.force)));
      }
      scene.top = Math.max(...heights);
      scene.rod = Math.ceil(this.highest() / 0.2 + 0.25) * 0.2;
      scene.metresPerNewton = ARROW / force;
      this.timeline = new Timeline(this.bar, scene, heights, contacts);
      this.last = this.timeline.last;
      this.bar.setAttribute("aria-valuemax", this.last.toFixed(3));
    }

    highest() {
      const { hips, ground } = this.scene;
      return Math.max(...this.tracks.flatMap((track) =>
        Array.from({ length: track.count }, (_, k) => ground.height(track.pose(k, hips).position))));
    }

    connect() {
      const { root, scene, strip } = this;
      this.button.addEventListener("click", () => this.play(!this.playing));
      root.querySelector(".view").addEventListener("click", () => { this.view = { ...VIEW }; this.paint(); });
      for (const input of [this.forces, this.ghost]) input.addEventListener("change", () => this.paint());
      this.drag(this.stage, (dx, dy) => {
        this.view.azimuth -= 0.007 * dx;
        this.view.elevation = clamp(this.view.elevation + 0.005 * dy, 0.02, 1.5);
        this.paint();
      });
      this.stage.addEventListener("wheel", (event) => {
        if (!event.ctrlKey && !event.metaKey) return;  // plain scrolling belongs to the page
        event.preventDefault();
        this.view.distance = clamp(this.view.distance * Math.exp(0.002 * event.deltaY), 1.2, 9);
        this.paint();
      }, { passive: false });
      this.drag(this.bar, (_dx, _dy, x) => this.seek(this.timeline.timeAt(x)), true);
      strip.addEventListener("click", (event) => {
        this.seek(scene.snapshots[Math.floor(event.offsetX / strip.clientWidth * scene.snapshots.length)]);
      });
      root.addEventListener("seek", (event) => this.seek(event.detail));
      root.addEventListener("keydown", (event) => this.key(event));
      addEventListener("themechange", () => this.layout());
      new ResizeObserver(() => { if (root.clientWidth !== this.width) this.layout(); }).observe(root);
    }

    drag(canvas, move, atOnce = false) {
      let from = null;
      canvas.addEventListener("pointerdown", (event) => {
        from = event;
        canvas.setPointerCapture(event.pointerId);
        if (atOnce) move(0, 0, event.offsetX);
      });
      canvas.addEventListener("pointermove", (event) => {
        if (!from) return;
        move(event.clientX - from.clientX, event.clientY - from.clientY, event.offsetX);
        from = event;
      });
      for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { from = null; });
    }

    key(event) {
      if (event.target !== this.root) return;
      const step = event.shiftKey ? 0.05 : this.scene.period;
      const action = {
        " ": () => this.play(!this.playing), ArrowLeft: () => this.seek(this.time - step),
        ArrowRight: () => this.seek(this.time + step), Home: () => this.seek(0), End: () => this.seek(this.last),
      }[event.key];
      if (!action) return;
      event.preventDefault();
      action();
    }

    play(on) {
      if (on && (!this.started || this.time >= this.last)) this.time = 0;
      this.started = true;
      this.playing = on;
      this.button.textContent = on ? "Pause" : "Play";
      this.paint();
      if (!on) return;
      let before = null;
      const tick = (now) => {
        if (!this.playing) return;
        if (before !== null) this.time += 1e-3 * (now - before) * this.speed.value;
        before = now;
        if (this.time >= this.last) {
          this.time = this.last;
          this.play(false);
          return;
        }
        this.paint();
        requestAnimationFrame(tick);
      };
      requestAnimationFrame(tick);
    }

    seek(time) {
      this.started = true;
      this.time = clamp(time, 0, this.last);
      this.paint();
    }

    layout() {
      const style = getComputedStyle(document.documentElement), width = this.width = this.root.clientWidth;
      const colour = (name) => style.getPropertyValue(`--${name}`).trim();
      this.colours = { line: colour("floor-line"), ...Object.fromEntries(COLOURS.map((name) => [name, colour(name)])) };
      const height = clamp(0.5 * width, 300, 540), snapshots = this.scene.snapshots.length;
      this.fit(this.stage, width, height);
      this.fit(this.ghostLayer, width, height);
      this.fit(this.bar, width, 142);
      if (snapshots) {
        const stripHeight = clamp(1.32 * width / snapshots, 90, 190);
        this.fit(this.strip, width, stripHeight);
        this.fit(this.shadowLayer, width * SHADOW_SCALE, stripHeight * SHADOW_SCALE, 1);
        paintStrip(this.strip, this.shadowLayer, this.tracks[0], this.scene, this.colours);
      }
      this.fit(this.shadowLayer, width * SHADOW_SCALE, height * SHADOW_SCALE, 1);
      this.paint();
    }

    fit(canvas, width, height, ratio = devicePixelRatio) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      canvas.style.height = `${height}px`;
      canvas.getContext("2d").setTransform(ratio, 0, 0, ratio, 0, 0);
    }

    camera(below) {
      const { ground, rod } = this.scene, target = add(below, [0, 0, 0.5 * rod - 0.02]), view = { ...this.view, target };
      const look = () => new Camera(view, 0, 0, this.stage.clientWidth, this.stage.clientHeight);
      let camera = look();
      while (ground.height(camera.eye) < GROUND_CLEARANCE && view.elevation < 1.5) {  // a slope may rise behind the robot
        view.elevation += 0.02;
        camera = look();
      }
      return camera;
    }

    paint() {
      const { scene, colours, stage } = this, width = stage.clientWidth, height = stage.clientHeight;
      const ctx = stage.getContext("2d"), frame = this.time / scene.period;
      const pose = this.tracks[0].pose(frame, scene.hips), below = scene.ground.below(pose.position);
      const camera = this.camera(below);
      ctx.clearRect(0, 0, width, height);
      scene.ground.paint(ctx, camera, below, Math.min(2.6, 0.85 * this.view.distance), colours);
      paintShadow(ctx, this.shadowLayer, camera, pose, scene, colours.shadow);
      paintRod(ctx, camera, pose, scene, colours);
      if (this.ghost.checked && this.tracks[1]) {
        const layer = this.ghostLayer.getContext("2d");
        layer.clearRect(0, 0, width, height);
        paintRobot(layer, camera, this.tracks[1].pose(frame, scene.hips), scene, colours.accent);
        ctx.globalAlpha = 0.35;
        ctx.drawImage(this.ghostLayer, 0, 0, width, height);
        ctx.globalAlpha = 1;
      }
      paintRobot(ctx, camera, pose, scene, colours.accent);
      if (this.forces.checked) paintForces(ctx, camera, pose, scene);
      this.timeline.paint(this.time, colours);
      this.report(pose);
    }

    report(pose) {
      const span = this.scene.spans.find(([, start, end]) => this.time >= start && this.time < end);
      const time = this.time.toFixed(3), height = this.scene.ground.height(pose.position).toFixed(3);
      const bold = (text) => Object.assign(document.createElement("b"), { textContent: text });
      this.readout.replaceChildren(bold(`${time} s`), `  ${span ? span[0] : ""}\ntorso height `, bold(`${height} m`));
      this.bar.setAttribute("aria-valuenow", time);
      Object.assign(this.root.dataset, { time, height, state: this.playing ? "playing" : "paused" });
    }
  }

  document.querySelectorAll(".playback").forEach((root) => new Player(root));
})();
