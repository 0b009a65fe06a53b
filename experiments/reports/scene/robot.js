// The robot: a box and capsules, painted from far to near; its shadow; the contact forces.
(() => {
  "use strict";
  const { add, sub, times, dot, size, unit, middle, turn, shade, polygon, capsulePath, capsule, ball } = playback;

  const LINK_RADIUS = { hip: 0.042, thigh: 0.03, knee: 0.034, shank: 0.02, ankle: 0.014 };
  const LIGHT = unit([0.24, -0.2, -1]);
  const COLOURS = { torso: [92, 103, 118], hip: [74, 83, 96], thigh: [176, 185, 196], shank: [120, 130, 143], foot: [54, 59, 67] };
  const FORCE_COLOURS = { safe: "#2a9d78", near: "#e0a52f", over: "#d4483d" };
  const FACES = [0, 1, 2].flatMap((axis) => [1, -1].map((sign) => ({ axis, sign })));

  function boxFaces(pose, box) {
    const half = box.map((l) => l / 2);
    return FACES.map(({ axis, sign }) => {
      const u = (axis + 1) % 3, v = (axis + 2) % 3;
      const corner = (a, b, inset = 0) => {
        const c = [0, 0, 0];
        c[axis] = sign * half[axis]; c[u] = a * (half[u] - inset); c[v] = b * (half[v] - inset);
        return add(pose.position, turn(pose.R, c));
      };
      const ring = (inset) => [corner(1, 1, inset), corner(-1, 1, inset), corner(-1, -1, inset), corner(1, -1, inset)];
      const normal = turn(pose.R, [0, 1, 2].map((k) => (k === axis ? sign : 0)));
      return { axis, sign, normal, centre: middle(corner(1, 1), corner(-1, -1)), ring };
    });
  }

  function paintBox(ctx, camera, faces, accent) {
    for (const face of faces) {
      if (dot(face.normal, sub(camera.eye, face.centre)) <= 0) continue;
      const bright = 0.62 + 0.62 * Math.max(0, -dot(face.normal, LIGHT)) + 0.08 * face.normal[2];
      if (!polygon(ctx, camera, face.ring(0))) continue;
      ctx.fillStyle = ctx.strokeStyle = shade(COLOURS.torso, bright);
      ctx.lineWidth = 1.5;
      ctx.lineJoin = "round";
      ctx.fill();
      ctx.stroke();
      if (!polygon(ctx, camera, face.ring(0.014))) continue;
      ctx.fillStyle = shade(COLOURS.torso, bright * 1.08);
      ctx.fill();
      if (face.axis === 0 && face.sign > 0) {  // the front
        ctx.fillStyle = accent;
        ctx.globalAlpha = 0.85;
        if (polygon(ctx, camera, face.ring(0.05))) ctx.fill();
        ctx.globalAlpha = 1;
      }
    }
  }

  // The robot from far to near. A convex box and a small body are ordered by the face that parts them best.
  function paintRobot(ctx, camera, pose, scene, accent) {
    const faces = boxFaces(pose, scene.box);
    const before = [], after = [];
    for (const leg of pose.legs) {
      const parts = [
        { at: middle(leg.haa, leg.hfe), paint: () => capsule(ctx, camera, leg.haa, leg.hfe, LINK_RADIUS.hip, LINK_RADIUS.hip, COLOURS.hip) },
        { at: middle(leg.hfe, leg.knee), paint: () => capsule(ctx, camera, leg.hfe, leg.knee, LINK_RADIUS.knee, LINK_RADIUS.thigh, COLOURS.thigh) },
        { at: middle(leg.knee, leg.foot), paint: () => {
          ball(ctx, camera, leg.knee, LINK_RADIUS.thigh, COLOURS.hip);
          capsule(ctx, camera, leg.knee, leg.foot, LINK_RADIUS.shank, LINK_RADIUS.ankle, COLOURS.shank);
          ball(ctx, camera, leg.foot, scene.footRadius, COLOURS.foot);
        } },
      ];
      for (const part of parts) {
        part.distance = camera.distance(part.at);
        const outside = faces.map((f) => ({ f, d: dot(f.normal, sub(part.at, f.centre)) })).sort((a, b) => b.d - a.d)[0].f;
        (dot(outside.normal, sub(camera.eye, outside.centre)) > 0 ? after : before).push(part);
      }
    }
    const far = (a, b) => b.distance - a.distance;
    before.sort(far).forEach((part) => part.paint());
    paintBox(ctx, camera, faces, accent);
    after.sort(far).forEach((part) => part.paint());
  }

  // Shadows are painted small and blown up: that blurs them for nothing.
  const SHADOW_SCALE = 0.3;

  function paintShadow(ctx, layer, camera, pose, scene, colour) {
    const s = layer.getContext("2d"), { ground } = scene;
    s.setTransform(1, 0, 0, 1, 0, 0);
    s.clearRect(0, 0, layer.width, layer.height);
    s.setTransform(SHADOW_SCALE, 0, 0, SHADOW_SCALE, 0, 0);
    s.fillStyle = colour;
    for (const face of boxFaces(pose, scene.box)) {
      if (polygon(s, camera, face.ring(0).map((p) => ground.shadow(p)))) s.fill();
    }
    for (const leg of pose.legs) {
      const links = [[leg.haa, leg.hfe, LINK_RADIUS.hip], [leg.hfe, leg.knee, LINK_RADIUS.thigh], [leg.knee, leg.foot, LINK_RADIUS.shank]];
      for (const [p, q, r] of links) {
        const a = camera.project(ground.shadow(p)), b = camera.project(ground.shadow(q));
        if (!a || !b) continue;
        capsulePath(s, a, b, r * a.scale, r * b.scale);
        s.fill();
      }
    }
    ctx.globalAlpha = 0.26;
    ctx.drawImage(layer, 0, 0, layer.width / SHADOW_SCALE, layer.height / SHADOW_SCALE);
    ctx.globalAlpha = 1;
  }

  function paintForces(ctx, camera, pose, scene) {
    for (const leg of pose.legs) {
      const normalForce = dot(leg.force, scene.ground.normal);
      if (normalForce < scene.contactForce) continue;
      const tangential = size(sub(leg.force, times(scene.ground.normal, normalForce)));
      const use = tangential / (scene.friction * normalForce);
      const start = sub(leg.foot, times(scene.ground.normal, scene.footRadius));
      const a = camera.project(start), b = camera.project(add(start, times(leg.force, scene.metresPerNewton)));
      if (!a || !b) continue;
      const along = Math.atan2(b.y - a.y, b.x - a.x), head = Math.min(11, 0.6 * Math.hypot(b.x - a.x, b.y - a.y));
      ctx.strokeStyle = ctx.fillStyle = use < 0.8 ? FORCE_COLOURS.safe : use < 1 ? FORCE_COLOURS.near : FORCE_COLOURS.over;
      ctx.lineWidth = 3.2;
      ctx.lineCap = "round";
      ctx.beginPath();
      ctx.moveTo(a.x, a.y);
      ctx.lineTo(b.x - 0.8 * head * Math.cos(along), b.y - 0.8 * head * Math.sin(along));
      ctx.stroke();
      ctx.beginPath();
      ctx.moveTo(b.x, b.y);
      for (const side of [2.72, -2.72]) ctx.lineTo(b.x + head * Math.cos(along + side), b.y + head * Math.sin(along + side));
      ctx.fill();
    }
  }

  Object.assign(playback, { LIGHT, SHADOW_SCALE, paintRobot, paintShadow, paintForces });
})();
