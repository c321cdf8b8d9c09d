"use strict";
// What robomill view writes: numbers in #scene and #data, shown by three.js. Lengths in m, z up, base frame B unless said otherwise.
(async () => {
  const $ = (id) => document.getElementById(id);
  const fail = (text) => { $("problem").textContent = text; $("problem").hidden = false; document.documentElement.dataset.state = "failed"; };
  const scene = JSON.parse($("scene").textContent);
  const TYPES = { f4: Float32Array, u2: Uint16Array, u4: Uint32Array, i1: Int8Array };
  const SHORTEST = 1e-9; // m: a body shorter than this is a ball
  const ARROW = 0.4; // of the part's diagonal: length of the arrow at the largest force
  const HEAD = 0.22; // of the arrow: its point
  const LARGEST_FACTOR = 500;
  const ARM = 0.9; // m: half the height of such robots, which the eye looks at

  let bytes;
  try {
    const packed = Uint8Array.from(atob($("data").textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    bytes = await new Response(stream).arrayBuffer();
  } catch (error) {
    return fail(`The numbers of this page cannot be read: ${error}. It needs a browser of 2023 or later.`);
  }
  const array = (a) => new TYPES[a.type](bytes, a.at, a.n);
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas: $("canvas"), antialias: true });
  } catch (error) {
    return fail(`This browser gives no WebGL, which the picture needs (${error.message}).`);
  }

  // ---------------------------------------------------------------- colours
  const colour = (name) => new THREE.Color(getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  const materials = {};
  for (const part of ["arm", "link", "base", "spindle", "cutter"]) materials[part] = new THREE.MeshLambertMaterial();
  materials.mesh = new THREE.MeshLambertMaterial({ side: THREE.DoubleSide });
  materials.ghost = new THREE.MeshLambertMaterial({ transparent: true, opacity: 0.45, depthWrite: false });
  materials.planned = new THREE.LineBasicMaterial({ depthTest: false, transparent: true });
  materials.real = new THREE.LineBasicMaterial({ depthTest: false, transparent: true });
  materials.floor = new THREE.LineBasicMaterial();
  materials.force = new THREE.MeshBasicMaterial({ depthTest: false, transparent: true });
  materials.part = new THREE.MeshLambertMaterial({ vertexColors: true, alphaTest: 0.02, flatShading: true, side: THREE.DoubleSide });
  const ramp = scene.map.map((c) => new THREE.Color(c));
  const shade = (share, out) => { // share -1..1
    const x = Math.min(Math.max(0.5 + 0.5 * share, 0), 1) * (ramp.length - 1), k = Math.min(Math.floor(x), ramp.length - 2);
    return out.copy(ramp[k]).lerp(ramp[k + 1], x - k);
  };

  // ---------------------------------------------------------------- bodies
  const UP = new THREE.Vector3(0, 1, 0); // of three's cylinders
  function solid(body, material) {
    if (body.triangles) {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(array(body.corners), 3));
      geometry.setIndex(new THREE.BufferAttribute(array(body.triangles), 1));
      const flat = geometry.toNonIndexed();
      flat.computeVertexNormals();
      return new THREE.Mesh(flat, material);
    }
    const a = new THREE.Vector3(...body.start), b = new THREE.Vector3(...body.end), way = b.clone().sub(a), length = way.length();
    const geometry = body.round
      ? new THREE.CapsuleGeometry(body.radius, length, 8, 24)
      : new THREE.CylinderGeometry(body.radius, body.radius, Math.max(length, SHORTEST), 32);
    const mesh = new THREE.Mesh(geometry, material);
    mesh.position.copy(a).addScaledVector(way, 0.5);
    if (length > SHORTEST) mesh.quaternion.setFromUnitVectors(UP, way.divideScalar(length));
    return mesh;
  }
  function tree(said, wanted) { // frames as groups: `fixed` in the parent, and in it what turns
    const root = new THREE.Group(), turned = [];
    for (const f of said.frames) {
      const fixed = new THREE.Group(), moved = new THREE.Group();
      fixed.matrixAutoUpdate = false;
      fixed.matrix.set(...f.fixed);
      fixed.add(moved);
      (f.parent < 0 ? root : turned[f.parent]).add(fixed);
      turned.push(moved);
    }
    for (const b of said.bodies) if (wanted(b)) (b.frame < 0 ? root : turned[b.frame]).add(solid(b, materials[b.part]));
    const axes = said.frames.map((f) => f.axis && new THREE.Vector3(...f.axis));
    return {
      root, turned,
      move(q) {
        said.frames.forEach((f, i) => {
          if (!axes[i]) return;
          const value = f.offset + f.row.reduce((sum, c, j) => sum + c * q[j], 0);
          if (f.slides) turned[i].position.copy(axes[i]).multiplyScalar(value);
          else turned[i].quaternion.setFromAxisAngle(axes[i], value);
        });
      },
    };
  }

  // ---------------------------------------------------------------- the part: heights that go down and up again with time
  function block(part) {
    const [ny, nx] = part.shape, [start, frame, cell, level] = ["start", "frame", "cell", "level"].map((k) => array(part[k]));
    const levels = Uint16Array.from(start), before = new Uint16Array(level.length);
    for (let e = 0; e < level.length; e++) { before[e] = levels[cell[e]]; levels[cell[e]] = level[e]; }
    levels.set(start);
    // cell centres, and around them twice the rim of the box: at the height of its neighbour, and at the bottom
    const w = nx + 4, h = ny + 4, size = part.high.map((x, i) => x - part.low[i]);
    const position = new Float32Array(3 * w * h), tint = new Float32Array(4 * w * h), inner = (i, n) => Math.min(Math.max(i - 2, 0), n - 1);
    const along = (i, n, k) => part.low[k] + size[k] * (i < 2 ? 0 : i > n + 1 ? 1 : (i - 1.5) / n);
    const places = Array.from({ length: nx * ny }, () => []), feet = Array.from({ length: nx * ny }, () => []);
    for (let y = 0; y < h; y++) for (let x = 0; x < w; x++) {
      const v = y * w + x, c = inner(y, ny) * nx + inner(x, nx), foot = x === 0 || y === 0 || x === w - 1 || y === h - 1;
      position.set([along(x, nx, 0), along(y, ny, 1), part.low[2]], 3 * v);
      (foot ? feet : places)[c].push(v);
    }
    const index = new Uint32Array(6 * (w - 1) * (h - 1));
    for (let y = 0, n = 0; y < h - 1; y++) for (let x = 0; x < w - 1; x++, n += 6) {
      const a = y * w + x;
      index.set([a, a + 1, a + w, a + 1, a + w + 1, a + w], n);
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(position, 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(tint, 4));
    geometry.setIndex(new THREE.BufferAttribute(index, 1));
    const mesh = new THREE.Mesh(geometry, materials.part);
    mesh.frustumCulled = false;
    let done = 0, raw, cut;
    const LEVELS = 65000;
    const put = (c, value) => {
      levels[c] = value;
      const k = value === start[c] ? raw : cut, z = part.low[2] + size[2] * value / LEVELS;
      const there = value > 1 ? 1 : 0; // else it is cut through, or there never was anything
      for (const v of places[c]) { position[3 * v + 2] = z; tint.set([k.r, k.g, k.b, there], 4 * v); }
      for (const v of feet[c]) tint.set([raw.r, raw.g, raw.b, there], 4 * v);
    };
    return {
      mesh,
      paint() { raw = colour("raw"); cut = colour("cut"); for (let c = 0; c < nx * ny; c++) put(c, levels[c]); geometry.attributes.color.needsUpdate = geometry.attributes.position.needsUpdate = true; },
      show(i) { // all changes up to frame i, and none after it
        const was = done;
        while (done < frame.length && frame[done] <= i) { put(cell[done], level[done]); done++; }
        while (done > 0 && frame[done - 1] > i) { done--; put(cell[done], before[done]); }
        if (done !== was) geometry.attributes.color.needsUpdate = geometry.attributes.position.needsUpdate = true;
      },
      removed: () => start.reduce((sum, value, c) => sum + value - levels[c], 0) / LEVELS * size[0] * size[1] * size[2] / (nx * ny),
    };
  }
  function coloured(said, limit, pitch) {
    const [point, normal, deviation, time] = ["point", "normal", "deviation", "time"].map((k) => array(said[k]));
    const material = new THREE.MeshBasicMaterial();
    const lift = (1.5 * pitch).toFixed(6); // towards the eye: the walls of the part stand a cell away from where they are
    material.onBeforeCompile = (shader) => {
      shader.vertexShader = shader.vertexShader.replace("#include <project_vertex>", `#include <project_vertex>
        mvPosition.xyz *= 1.0 - ${lift} / length(mvPosition.xyz);
        gl_Position = projectionMatrix * mvPosition;`);
    };
    const mesh = new THREE.InstancedMesh(new THREE.PlaneGeometry(said.size, said.size), material, time.length);
    const m = new THREE.Matrix4(), q = new THREE.Quaternion(), p = new THREE.Vector3(), one = new THREE.Vector3(1, 1, 1), z = new THREE.Vector3(0, 0, 1), c = new THREE.Color();
    for (let i = 0; i < time.length; i++) {
      q.setFromUnitVectors(z, p.fromArray(normal, 3 * i).normalize());
      mesh.setMatrixAt(i, m.compose(p.fromArray(point, 3 * i), q, one));
      mesh.setColorAt(i, shade(deviation[i] / limit, c));
    }
    mesh.frustumCulled = false;
    return { mesh, show(t) { mesh.count = after(time, t); } };
  }
  const after = (times, t) => { // number of times that are not later than t
    let low = 0, high = times.length;
    while (low < high) { const k = (low + high) >> 1; if (times[k] <= t) low = k + 1; else high = k; }
    return low;
  };

  // ---------------------------------------------------------------- what all runs share
  const largest = (values) => { let most = 0; for (const v of values) most = Math.max(most, Math.abs(v)); return most; };
  const lengths = (values) => Float32Array.from({ length: values.length / 3 }, (_, i) => Math.hypot(values[3 * i], values[3 * i + 1], values[3 * i + 2]));
  const limit = Math.max(...scene.variants.map((v) => (v.patches ? largest(array(v.patches.deviation)) : 0))) || 1e-3;
  const strongest = Math.max(...scene.variants.map((v) => (v.force ? largest(lengths(array(v.force))) : 0))) || 1;
  const begin = Math.min(...scene.variants.map((v) => array(v.t)[0])), end = Math.max(...scene.variants.map((v) => array(v.t).at(-1)));
  const camera = new THREE.PerspectiveCamera(35, 1, 0.02, 60);
  camera.up.set(0, 0, 1);
  const eye = new THREE.OrbitControls(camera, $("canvas"));
  eye.enableDamping = false;

  // ---------------------------------------------------------------- a run
  function variant(v) {
    const world = new THREE.Scene();
    world.add(new THREE.HemisphereLight(0xffffff, 0x8899aa, 1.6));
    const sun = new THREE.DirectionalLight(0xffffff, 1.8);
    sun.position.set(-1.5, -2.5, 4);
    world.add(sun);
    const grid = new THREE.GridHelper(5, 20);
    grid.rotation.x = Math.PI / 2;
    grid.material = materials.floor;
    grid.material.vertexColors = false;
    const robot = new THREE.Group();
    robot.add(grid);
    world.add(robot);
    const t = array(v.t), n = t.length, [tip, quat] = [array(v.tip), array(v.quat)];
    const [target, across, force, q, bend] = ["target", "across", "force", "q", "bend"].map((k) => v[k] && array(v[k]));
    const trees = [];
    if (v.robot) {
      trees.push(tree(v.robot, (b) => !scene.urdf || b.part === "spindle" || b.part === "cutter"));
      if (scene.urdf) trees.push(tree(scene.urdf, () => true));
      for (const each of trees) robot.add(each.root);
    }
    const tool = new THREE.Group(); // where the tool really is; x of T points out of the spindle
    tool.add(solid({ start: [0, 0, 0], end: [-0.06, 0, 0], radius: v.cutter }, materials.ghost));
    world.add(tool);
    let part = null, spots = null, place = new THREE.Vector3().fromArray(tip, 3 * (n >> 1));
    if (v.part) {
      const at = new THREE.Group();
      at.position.set(...v.part.position);
      at.quaternion.set(...v.part.turn);
      part = block(v.part);
      at.add(part.mesh);
      if (v.patches) { spots = coloured(v.patches, limit, (v.part.high[0] - v.part.low[0]) / v.part.shape[1]); at.add(spots.mesh); }
      world.add(at);
      place = new THREE.Vector3(...v.part.low).add(new THREE.Vector3(...v.part.high)).multiplyScalar(0.5).applyQuaternion(at.quaternion).add(at.position);
    }
    const extent = v.part ? Math.hypot(...v.part.high.map((x, i) => x - v.part.low[i])) : 0.3;
    const line = (values, material, order) => {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(values, 3));
      const drawn = new THREE.Line(geometry, material);
      drawn.frustumCulled = false;
      drawn.renderOrder = order;
      world.add(drawn);
      return drawn;
    };
    const planned = target && line(target, materials.planned, 1), real = line(Float32Array.from(tip), materials.real, 2);
    const worst = v.patches && (1e3 * largest(array(v.patches.deviation))).toFixed(2);
    let drawn = 1;
    function magnify(factor) {
      if (!across || factor === drawn) return;
      drawn = factor;
      const p = real.geometry.attributes.position;
      for (let i = 0; i < p.array.length; i++) p.array[i] = tip[i] + (factor - 1) * across[i];
      p.needsUpdate = true;
    }
    const full = ARROW * extent, arrow = new THREE.Group(), shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.012 * full, 0.012 * full, 1, 12), materials.force);
    const point = new THREE.Mesh(new THREE.CylinderGeometry(0, 0.05 * full, HEAD * full, 16), materials.force);
    shaft.renderOrder = point.renderOrder = 3;
    arrow.add(shaft, point);
    world.add(arrow);

    const pane = document.createElement("div");
    pane.className = "pane";
    pane.innerHTML = '<div class="said"><b></b> <span></span></div><span class="newton" hidden></span>';
    pane.querySelector("b").textContent = v.name;
    $("panes").append(pane);
    const said = pane.querySelector(".said span"), newton = pane.querySelector(".newton");
    const mix = (values, width, i, u) => Array.from({ length: width }, (_, k) => values[width * i + k] * (1 - u) + values[width * Math.min(i + 1, n - 1) + k] * u);
    const head = new THREE.Vector3();

    function show(time, state) {
      const i = Math.max(after(t, time) - 1, 0), u = i + 1 < n ? Math.min(Math.max((time - t[i]) / (t[i + 1] - t[i]), 0), 1) : 0;
      tool.position.set(...mix(tip, 3, i, u));
      const [w, x, y, z] = mix(quat, 4, i, u);
      tool.quaternion.set(x, y, z, w).normalize();
      if (v.robot) {
        const turn = mix(bend, 6, i, u), now = mix(q, 6, i, u).map((a, k) => a + state.factor * turn[k]);
        for (const each of trees) each.move(now);
      }
      robot.visible = state.robot;
      part?.show(i);
      if (spots) { spots.show(time); spots.mesh.visible = state.deviation; }
      magnify(state.factor);
      real.geometry.setDrawRange(0, i + 1);
      real.visible = state.path;
      if (planned) planned.visible = state.path;
      const rows = [];
      arrow.visible = false;
      if (force) {
        const f = new THREE.Vector3(...mix(force, 3, i, u)), size = f.length(), long = full * size / strongest;
        rows.push(`${size.toFixed(0)} N`);
        if (size > 0.01 * strongest && state.force) {
          arrow.visible = true;
          arrow.position.copy(tool.position);
          arrow.quaternion.setFromUnitVectors(UP, f.divideScalar(size));
          shaft.scale.y = Math.max(long - HEAD * full, SHORTEST);
          shaft.position.y = 0.5 * shaft.scale.y;
          point.scale.setScalar(Math.min(1, long / (HEAD * full)));
          point.position.y = long - 0.5 * HEAD * full * point.scale.y;
        }
        newton.textContent = `${size.toFixed(0)} N`;
        head.set(0, long, 0).applyQuaternion(arrow.quaternion).add(tool.position);
      }
      if (across) rows.push(`tool ${(1e3 * Math.hypot(...mix(across, 3, i, u))).toFixed(2)} mm off`);
      if (v.patches) rows.push(`part up to ${worst} mm`);
      said.textContent = rows.join(" · ");
      if (trees.length) { // for tests and scripts: where the tree put the tool, and what is cut
        trees[0].root.updateWorldMatrix(true, true);
        const e = trees[0].turned.at(-1).matrixWorld.elements;
        pane.dataset.tip = [e[12], e[13], e[14]].map((m) => (1e3 * m).toFixed(4)).join(" ");
      }
      if (part) pane.dataset.removed = (1e6 * part.removed()).toFixed(3);
    }
    function label(box) { // the newtons beside the arrow's point
      newton.hidden = !arrow.visible;
      if (!arrow.visible) return;
      const p = head.clone().project(camera);
      newton.style.transform = `translate(${((p.x + 1) / 2 * box.width + 8).toFixed(1)}px, ${((1 - p.y) / 2 * box.height - 10).toFixed(1)}px)`;
    }
    return { v, key: v.name.replaceAll(" ", "_"), world, pane, show, label, place, extent, wanted: true, paint: () => part?.paint() };
  }
  const runs = scene.variants.map(variant);

  // ---------------------------------------------------------------- state, and what changes it
  const state = { time: begin, factor: 1, playing: false, deviation: true, force: true, path: true, robot: true };
  let asked_for = false, last = null;
  const redraw = () => { if (!asked_for) { asked_for = true; requestAnimationFrame(frame); } }; // nothing is drawn while nothing changes
  const set = (values) => { Object.assign(state, values); redraw(); };
  const slider = $("time");
  slider.min = begin; slider.max = end;
  slider.oninput = () => set({ time: +slider.value, playing: false });
  $("play").onclick = () => set({ playing: !state.playing, time: !state.playing && state.time >= end ? begin : state.time });
  const factor = $("factor");
  factor.oninput = () => set({ factor: Math.round(LARGEST_FACTOR ** +factor.value) });
  for (const what of ["deviation", "force", "path", "robot"]) $(`show-${what}`).onchange = (e) => set({ [what]: e.target.checked });
  function look(where) {
    const run = runs.find((r) => r.wanted) ?? runs[0], p = run.place;
    const away = { cell: [1.9, -3.6, 1.3], part: [0.55, -1.3, 1.1], top: [0, -1e-3, 1.8] }[where];
    const size = where === "cell" ? 1.15 * Math.max(1, Math.hypot(p.x, p.y, p.z) / 1.8) : 0.6 * run.extent, target = p.clone();
    if (where === "cell") target.set(0.5 * p.x, 0.5 * p.y, Math.max(0.72 * p.z, ARM));
    const d = new THREE.Vector3(...away).normalize().multiplyScalar(size / Math.tan(Math.PI * 35 / 360) / Math.min(1, Math.max(camera.aspect, 0.45)));
    eye.target.copy(target);
    camera.position.copy(target).add(d);
    eye.update();
    redraw();
  }
  for (const where of ["cell", "part", "top"]) $(`eye-${where}`).onclick = () => look(where);
  eye.addEventListener("change", redraw);
  const dark = matchMedia("(prefers-color-scheme: dark)");
  $("theme").onclick = () => {
    const now = document.documentElement.dataset.theme ?? (dark.matches ? "dark" : "light");
    document.documentElement.dataset.theme = now === "dark" ? "light" : "dark";
    paint();
  };
  dark.addEventListener("change", () => paint());
  function paint() {
    for (const [name, material] of Object.entries(materials)) {
      const key = { mesh: "arm", ghost: "cutter", floor: "lines", force: "mark" }[name] ?? name;
      if (name !== "part") material.color.copy(colour(key));
    }
    for (const r of runs) r.paint();
    renderer.setClearColor(colour("air"));
    redraw();
  }
  function arrange() {
    const shown = runs.filter((r) => r.wanted), narrow = innerWidth < 700, n = shown.length;
    const columns = n <= 1 ? 1 : n === 2 ? (narrow ? 1 : 2) : n <= 4 || narrow ? 2 : 3;
    $("panes").style.gridTemplate = `repeat(${Math.ceil(n / columns)}, 1fr) / repeat(${columns}, 1fr)`;
    for (const r of runs) r.pane.hidden = !r.wanted, r.pane.style.display = r.wanted ? "" : "none";
    redraw();
  }
  if (runs.length > 1) for (const r of runs) {
    const label = document.createElement("label"), box = Object.assign(document.createElement("input"), { type: "checkbox", checked: true });
    box.onchange = () => { if (!box.checked && runs.filter((o) => o.wanted).length === 1) box.checked = true; r.wanted = box.checked; arrange(); };
    r.box = box;
    label.append(box, r.v.name);
    $("runs").append(label);
  }
  const keys = {
    " ": () => $("play").click(), Home: () => set({ time: begin, playing: false }), End: () => set({ time: end, playing: false }),
    ArrowRight: (e) => step(e.shiftKey ? 10 : 1), ArrowLeft: (e) => step(e.shiftKey ? -10 : -1),
    "+": () => { factor.value = +factor.value + 0.1; factor.oninput(); }, "-": () => { factor.value = +factor.value - 0.1; factor.oninput(); },
    d: () => $("show-deviation").click(), f: () => $("show-force").click(), w: () => $("show-path").click(), r: () => $("show-robot").click(),
    c: () => look("cell"), p: () => look("part"), t: () => look("top"),
  };
  const step = (frames) => set({ time: Math.min(Math.max(state.time + frames * (end - begin) / Math.max(runs[0].v.t.n - 1, 1), begin), end), playing: false });
  addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey || e.target.matches("select, summary, input[type=range]:not(#time)")) return;
    if (e.key === " " && e.target.matches("button, input[type=checkbox]")) return;
    const act = keys[e.key];
    if (act) { act(e); e.preventDefault(); }
  });

  // ---------------------------------------------------------------- words
  const signed = (m) => `${m > 0 ? "+" : m < 0 ? "−" : ""}${Math.abs(1e3 * m).toFixed(2)}`;
  $("ramp").style.background = `linear-gradient(to right, ${scene.map.join(", ")})`;
  $("ticks").append(...[-1, 0, 1].map((s) => Object.assign(document.createElement("span"), { textContent: s ? signed(s * limit) : "0" })));
  const measured = scene.variants.some((v) => v.patches);
  $("scale").hidden = !measured;
  $("legend-text").textContent = [
    measured ? "mm off on the part: red, material left; blue, gouged; grey, not cut yet or beside an edge" : "",
    scene.variants.some((v) => v.force) ? `red arrow: force on the tool` : "",
    "violet line: way of the tool; grey line: planned",
  ].filter(Boolean).join(" · ");
  const remarks = [...scene.notes, ...scene.variants.map((v) => `${v.name}: ${v.t.n} of ${v.samples} samples; between them the tool is at most ${(1e3 * v.lost).toPrecision(2)} mm from where it was`)];
  $("notes").append(...remarks.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
  if (scene.report) { $("report").href = scene.report; $("report").hidden = false; }

  // ---------------------------------------------------------------- drawing
  function draw() {
    const box = $("stage").getBoundingClientRect(), ratio = Math.min(devicePixelRatio, 2);
    if ($("canvas").width !== Math.floor(box.width * ratio) || $("canvas").height !== Math.floor(box.height * ratio)) {
      renderer.setPixelRatio(ratio);
      renderer.setSize(box.width, box.height, false);
    }
    renderer.setScissorTest(true);
    for (const r of runs) if (r.wanted) {
      const p = r.pane.getBoundingClientRect(), x = p.left - box.left, y = box.bottom - p.bottom;
      camera.aspect = p.width / p.height;
      camera.updateProjectionMatrix();
      r.show(state.time, state);
      renderer.setViewport(x, y, p.width, p.height);
      renderer.setScissor(x, y, p.width, p.height);
      renderer.render(r.world, camera);
      r.label(p);
    }
    slider.value = state.time;
    $("now").textContent = `${state.time.toFixed(2)} / ${end.toFixed(2)} s`;
    $("play").textContent = state.playing ? "Pause" : "Play";
    $("factor-now").textContent = state.factor;
  }
  function frame(now) {
    asked_for = false;
    if (state.playing) {
      state.time = Math.min(state.time + (last === null ? 0 : now - last) / 1e3 * +$("speed").value, end);
      last = now;
      if (state.time >= end) state.playing = false;
    }
    draw();
    if (state.playing) redraw(); else last = null;
  }
  addEventListener("resize", redraw);
  new ResizeObserver(redraw).observe($("stage"));
  // a link may say what to show: view.html#t=3.2&factor=100&eye=part
  const asked = new URLSearchParams(location.hash.slice(1));
  if (asked.has("theme")) document.documentElement.dataset.theme = asked.get("theme");
  if (asked.has("t")) state.time = Math.min(Math.max(+asked.get("t"), begin), end);
  if (asked.has("factor")) { state.factor = Math.min(Math.max(Math.round(+asked.get("factor")), 1), LARGEST_FACTOR); factor.value = Math.log(state.factor) / Math.log(LARGEST_FACTOR); }
  const only = (asked.get("only") ?? "").split(",").filter((name) => runs.some((r) => r.key === name));
  if (only.length) for (const r of runs) { r.wanted = only.includes(r.key); if (r.box) r.box.checked = r.wanted; }
  arrange();
  paint();
  const first = runs.find((r) => r.wanted).pane.getBoundingClientRect();
  camera.aspect = first.width / first.height;
  look(asked.get("eye") ?? (scene.variants.some((v) => v.part) ? "part" : "cell"));
  draw();
  document.documentElement.dataset.state = "ready";
})();
