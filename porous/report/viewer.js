"use strict";
// A view of a body that can be turned: WebGL2, no library, nothing loaded, drawn when it changes.
// Lengths are in halves of the diagonal of the body's box, about its middle.
(() => {
  const root = document.documentElement;
  const canvas = document.getElementById("view");
  const part = (name) => document.getElementById(`view-${name}`);
  const say = (text) => {
    part("message").textContent = text;
    part("message").hidden = !text;
  };
  const fail = (text) => {
    root.dataset.view = "failed";
    part("body").hidden = true;
    say(text);
  };

  const AXES = ["x", "y", "z"];
  const VIEWS = { reset: [0.64, 0.43], front: [0, 0], side: [Math.PI / 2, 0], top: [0, Math.PI / 2] };
  const FIELD = 2.6; // how much narrower the view is than far
  const STEPS = 65535;

  const data = JSON.parse(part("data").textContent);
  const middle = AXES.map((_, a) => (data.box[0][a] + data.box[1][a]) / 2);
  const half = Math.hypot(...AXES.map((_, a) => data.box[1][a] - data.box[0][a])) / 2 || 1;
  const inside = (point) => point.map((v, a) => (v - middle[a]) / half);
  const box = data.box.map(inside);
  const dot = (u, v) => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
  const short = (value) => String(+value.toPrecision(3));

  const shaders = {};
  for (const text of part("shaders").textContent.split("//: ").slice(1)) {
    const end = text.indexOf("\n");
    shaders[text.slice(0, end)] = text.slice(end);
  }

  // --- what the graphics card holds ----------------------------------------------------------
  let gl, gpu, body;

  const program = (vertex, fragment) => {
    const made = gl.createProgram();
    [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]].forEach(([kind, text]) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, `#version 300 es\n${shaders.head}${text}`);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    });
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost())
      throw new Error([...gl.getAttachedShaders(made).map((s) => gl.getShaderInfoLog(s)), gl.getProgramInfoLog(made)].join("\n"));
    const at = (name) => gl.getUniformLocation(made, name);
    return {
      use: () => gl.useProgram(made),
      f: (name, ...v) => gl[`uniform${v.length}f`](at(name), ...v),
      i: (name, v) => gl.uniform1i(at(name), v),
    };
  };

  const fields = (rows) => {
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    rows.forEach(([values, count, kind, stride, each], index) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(index);
      gl.vertexAttribPointer(index, count, kind, kind !== gl.FLOAT, stride, 0);
      gl.vertexAttribDivisor(index, each);
    });
    return array;
  };

  const texture = (unit, kind, upload) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(kind, gl.createTexture());
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    upload();
    gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    for (const way of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(kind, way, gl.CLAMP_TO_EDGE);
  };

  const edges = () => {
    const corner = (bits) => AXES.map((_, a) => box[(bits >> a) & 1][a] * 1.004);
    const pairs = [0, 1, 2, 3, 4, 5, 6, 7].flatMap((bits) =>
      [1, 2, 4].filter((axis) => !(bits & axis)).map((axis) => [corner(bits), corner(bits | axis)]));
    return [0, 1].map((end) => new Float32Array(pairs.flatMap((pair) => pair[end])));
  };

  const setUp = () => {
    const held = {};
    for (const name of ["body", "slice", "line"])
      held[name] = program(shaders[`${name}-vertex`], shaders[`${name}-fragment`]);
    held.triangles = fields([[body.place, 3, gl.UNSIGNED_SHORT, 8, 0], [body.normal, 3, gl.BYTE, 4, 0], [body.value, 2, gl.UNSIGNED_SHORT, 4, 0]]);
    held.edges = fields(edges().map((ends) => [ends, 3, gl.FLOAT, 0, 1]));
    held.empty = gl.createVertexArray();
    const [nx, ny, nz] = data.greys ? data.greys.shape : [1, 1, 1];
    texture(0, gl.TEXTURE_3D, () => {
      gl.texImage3D(gl.TEXTURE_3D, 0, gl.R8, nz, ny, nx, 0, gl.RED, gl.UNSIGNED_BYTE, body.greys || new Uint8Array(1));
      gl.texParameteri(gl.TEXTURE_3D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      gl.generateMipmap(gl.TEXTURE_3D);
    });
    texture(1, gl.TEXTURE_2D, () => {
      const table = new Uint8Array(data.colours.flat());
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, data.colours.length, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, table);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    });
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gpu = held;
  };

  // --- the camera, and a picture -------------------------------------------------------------
  const camera = { turn: 0, rise: 0, away: 3, target: [0, 0, 0] };
  const checked = (name) => part(name).checked;
  let waiting = 0;

  const sight = () => {
    const [st, ct, sr, cr] = [Math.sin(camera.turn), Math.cos(camera.turn), Math.sin(camera.rise), Math.cos(camera.rise)];
    const aspect = canvas.width / canvas.height;
    return {
      right: [ct, st, 0],
      up: [-sr * st, sr * ct, cr],
      back: [st * cr, -ct * cr, sr],
      target: camera.target,
      lens: [FIELD * Math.min(1, 1 / aspect), FIELD * Math.min(1, aspect)],
      away: [camera.away],
      cut: AXES.map((axis, a) => box[0][a] + part(`${axis}-at`).value * (box[1][a] - box[0][a])),
      side: AXES.map((axis, a) => checked(axis) * [1, -1, 1][a]),
      greyLow: data.greys ? inside(data.greys.box[0]) : [9, 9, 9],
      greySize: data.greys ? data.greys.box[1].map((v, a) => (v - data.greys.box[0][a]) / half) : [1, 1, 1],
    };
  };

  const begin = (shader, seen) => {
    shader.use();
    for (const name in seen) shader.f(name, ...seen[name]);
    shader.i("greys", 0);
    shader.i("cutting", checked("cut") && seen.side.some(Boolean));
    return shader;
  };

  const drawBody = (phase, seen, alpha) => {
    const shader = begin(gpu.body, seen);
    const pores = phase === "pore";
    const { count, walls } = data.triangles;
    const values = data.values[phase];
    const reach = values && (values.range[1] - values.range[0] || 1);
    const limit = values && checked("marks") ? values.limit : null;
    const low = inside(data.corners.box[0]);
    shader.f("low", ...low);
    shader.f("size", ...inside(data.corners.box[1]).map((v, a) => v - low[a]));
    shader.f("alpha", alpha);
    shader.f("pixel", devicePixelRatio);
    shader.f("limit", limit === null ? -1 : (((limit - values.range[0]) / reach) * (STEPS - 1) + 1) / STEPS);
    shader.f("voxel", data.greys ? seen.greySize[0] / data.greys.shape[0] : 0);
    shader.i("walls", 3 * walls);
    shader.i("pores", pores);
    shader.i("coloured", Boolean(values) && checked("colour"));
    shader.i("shaded", Boolean(data.greys));
    shader.i("scale", 1);
    const cutting = checked("cut") && seen.side.some(Boolean);
    const whole = pores && walls < count; // pores that end in caps are open there: one looks in
    (cutting || whole ? gl.disable : gl.enable).call(gl, gl.CULL_FACE);
    gl.cullFace(pores ? gl.FRONT : gl.BACK);
    (alpha < 1 ? gl.enable : gl.disable).call(gl, gl.BLEND);
    gl.depthMask(alpha === 1);
    gl.bindVertexArray(gpu.triangles);
    gl.drawArrays(gl.TRIANGLES, 0, 3 * (pores ? walls : count));
    gl.depthMask(true);
    [gl.CULL_FACE, gl.BLEND].forEach((what) => gl.disable(what));
  };

  const drawSlices = (seen) => {
    const shader = begin(gpu.slice, seen);
    gl.bindVertexArray(gpu.empty);
    AXES.forEach((axis, a) => {
      if (!checked(axis)) return;
      const along = (k) => AXES.map((_, b) => (b === (a + k) % 3 ? box[1][b] - box[0][b] : 0));
      shader.f("from", ...box[0].map((v, b) => (b === a ? seen.cut[a] : v)));
      shader.f("along", ...along(1));
      shader.f("across", ...along(2));
      shader.f("own", ...AXES.map((_, b) => +(b === a)));
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    });
  };

  const drawEdges = (seen) => {
    const shader = begin(gpu.line, seen);
    shader.f("pixels", canvas.width, canvas.height);
    shader.f("thick", 0.7 * devicePixelRatio);
    gl.bindVertexArray(gpu.edges);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, 12);
  };

  // Names of the axes stand at the lowest edges of the outline, and outside of it.
  const project = (seen, point) => {
    const q = point.map((v, a) => v - seen.target[a]);
    const ahead = seen.away[0] - dot(q, seen.back);
    return [0, 1].map((k) => (seen.lens[k] * dot(q, k ? seen.up : seen.right)) / ahead);
  };

  const label = (seen) => {
    const faces = (a, end) => (end ? 1 : -1) * (seen.back[a] * seen.away[0] + seen.target[a] - box[end][a]) > 0;
    const centre = project(seen, [0, 0, 0]);
    AXES.forEach((axis, a) => {
      const [b, c] = [(a + 1) % 3, (a + 2) % 3];
      const ends = [[0, 0], [0, 1], [1, 0], [1, 1]].filter(([j, k]) => faces(b, j) !== faces(c, k));
      const places = ends.map(([j, k]) => project(seen, AXES.map((_, i) => (i === a ? 0 : box[i === b ? j : k][i]))));
      const at = places.sort((p, q) => p[1] - q[1])[0];
      part(`name-${axis}`).hidden = !at;
      if (!at) return;
      const [w, h] = [canvas.clientWidth / 2, canvas.clientHeight / 2];
      const [dx, dy] = [(at[0] - centre[0]) * w, (at[1] - centre[1]) * h];
      const out = 22 / (Math.hypot(dx, dy) || 1);
      part(`name-${axis}`).style.transform =
        `translate(${w * (1 + at[0]) + 1.6 * out * dx}px, ${h * (1 - at[1]) - out * dy}px) translate(-50%, -50%)`;
    });
  };

  const draw = () => {
    waiting = 0;
    if (!gpu || gl.isContextLost() || !canvas.clientWidth) return;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((n) => Math.round(n * devicePixelRatio));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const seen = sight();
    const [surface, pores] = [checked("surface"), checked("pores")];
    drawEdges(seen);
    drawSlices(seen);
    if (pores) drawBody("pore", seen, 1);
    if (surface) drawBody("solid", seen, pores ? 0.25 : 1);
    label(seen);
    canvas.dataset.drawn = 1 + +(canvas.dataset.drawn || 0);
  };

  const redraw = () => {
    waiting ||= requestAnimationFrame(draw);
  };

  // --- what the reader does ------------------------------------------------------------------
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  const HOME = 2.95;

  const turnBy = (turn, rise) => {
    camera.turn += turn;
    camera.rise = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, camera.rise + rise));
    redraw();
  };
  const moveBy = (x, y) => {
    const { right, up } = sight();
    camera.target = camera.target.map((v, a) => Math.max(-2, Math.min(2, v - x * right[a] - y * up[a])));
    redraw();
  };
  const zoomBy = (factor) => {
    camera.away = Math.max(0.25, Math.min(12, camera.away * factor));
    redraw();
  };

  const go = (name) => {
    const [turn, rise] = VIEWS[name];
    const from = { ...camera };
    from.turn = Math.atan2(Math.sin(from.turn - turn), Math.cos(from.turn - turn)) + turn;
    const to = { turn, rise, away: HOME, target: [0, 0, 0] };
    const first = performance.now();
    const step = (now) => {
      const part = still.matches ? 1 : Math.max(0, Math.min(1, (now - first) / 250));
      const share = part * part * (3 - 2 * part);
      const between = (a, b) => (share === 1 ? b : a + share * (b - a));
      for (const key of ["turn", "rise", "away"]) camera[key] = between(from[key], to[key]);
      camera.target = from.target.map((v, a) => between(v, to.target[a]));
      draw();
      if (part < 1) requestAnimationFrame(step);
    };
    step(first);
  };

  const fingers = new Map();
  const spread = () => {
    const [p, q] = [...fingers.values()];
    return Math.hypot(p[0] - q[0], p[1] - q[1]) || 1;
  };
  const pointed = (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const size = Math.min(canvas.clientWidth, canvas.clientHeight);
    const [x, y] = [(event.clientX - before[0]) / size, (event.clientY - before[1]) / size];
    const apart = fingers.size === 2 && spread();
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    const reach = (2 * camera.away) / FIELD / fingers.size;
    if (apart) zoomBy(apart / spread());
    if (apart || event.shiftKey || event.buttons & 6) moveBy(x * reach, -y * reach);
    else turnBy(-4 * x, 4 * y);
  };
  const KEYS = {
    ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
    "+": 0.88, "=": 0.88, "-": 1.14, "_": 1.14, 0: "reset", Home: "reset",
  };
  const pressed = (event) => {
    const meant = KEYS[event.key];
    if (meant === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    if (typeof meant === "string") go(meant);
    else if (typeof meant === "number") zoomBy(meant);
    else if (event.shiftKey) moveBy(0.08 * meant[0], 0.08 * meant[1]);
    else turnBy(0.13 * meant[0], 0.13 * meant[1]);
  };

  // What is not there is not offered, and what stands beside the picture says what it shows.
  const changed = () => {
    AXES.forEach((axis, a) => {
      const place = data.box[0][a] + part(`${axis}-at`).value * (data.box[1][a] - data.box[0][a]);
      part(`${axis}-is`).textContent = `${short(place)} ${data.unit}`;
      part(`${axis}-at`).disabled = !checked(axis);
    });
    Object.keys(data.values).forEach((phase) => {
      const shown = checked(phase === "pore" ? "pores" : "surface");
      part(`bar-${phase}`).hidden = !shown || !checked("colour");
      part(`thin-${phase}`).hidden = !shown || !checked("marks") || data.values[phase].limit === null;
    });
    redraw();
  };

  const listen = () => {
    const on = (what, act, how) => canvas.addEventListener(what, act, how);
    on("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    on("pointermove", pointed);
    for (const end of ["pointerup", "pointercancel"]) on(end, (event) => fingers.delete(event.pointerId));
    on("contextmenu", (event) => event.preventDefault());
    on("dblclick", () => go("reset"));
    on("keydown", pressed);
    on("wheel", (event) => {
      event.preventDefault();
      zoomBy(Math.exp(Math.max(-60, Math.min(60, event.deltaY)) / 400));
    }, { passive: false });
    on("webglcontextlost", (event) => {
      event.preventDefault();
      gpu = null;
      say("The graphics card was taken away; the view comes back with it.");
    });
    on("webglcontextrestored", () => {
      setUp();
      say("");
      redraw();
    });
    part("controls").addEventListener("input", changed);
    for (const name in VIEWS) part(name).addEventListener("click", () => go(name));
    new ResizeObserver(redraw).observe(canvas);
  };

  const start = async () => {
    gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) return fail("This browser has no WebGL2, so the body cannot be turned here.");
    body = await porousBody(data, half);
    setUp();
    listen();
    const [turn, rise] = VIEWS.reset;
    Object.assign(camera, { turn, rise, away: HOME });
    changed();
    draw();
    root.dataset.view = "ready";
  };

  start().catch((error) => fail(`The body cannot be turned here: ${error.message}`));
})();
