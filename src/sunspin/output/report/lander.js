// The vehicle in 3-D: attitudes are interpolated between stored instants, the scene's axes are fixed in space (momentum up).
"use strict";
(function () {
  const { data, colour, styled, config, drawn, near, turnCamera, bytes } = window.sunspin;
  if (!data.lander) return;
  const app = data.lander, shape = app.shape, $ = (id) => document.getElementById(id);
  const stage = $("lander-stage"), slider = $("lander-slider"), playButton = $("lander-play"), motionSelect = $("lander-motion"), eventSelect = $("lander-event");
  const floats = (text) => new Float32Array(bytes(text).buffer);
  const reach = 1.25 * shape.size, size = shape.size;
  let motion = null, t = 0, playing = false, last = 0, ready = false, busy = false;

  function unpack(m) {
    if (!m.ready) {
      m.Q = floats(m.q); m.rate = floats(m.omega); m.H = m.momentum ? floats(m.momentum) : null; m.W = m.wheel.map(floats); m.P = bytes(m.power);
      m.ready = true;
    }
    return m;
  }
  // ---- what holds at a time: attitude by spherical interpolation, the rest from the nearest instant before
  function at(time) {
    const m = motion, x = Math.max(0, Math.min(m.n - 1, (time - m.t0) / m.dt)), i = Math.min(Math.floor(x), m.n - 2), f = x - i;
    const a = m.Q.subarray(4 * i, 4 * i + 4), b = m.Q.subarray(4 * i + 4, 4 * i + 8);
    let dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
    const sign = dot < 0 ? -1 : 1; dot = Math.min(1, Math.abs(dot));
    const angle = Math.acos(dot), s = Math.sin(angle);
    const wa = s < 1e-6 ? 1 - f : Math.sin((1 - f) * angle) / s, wb = (s < 1e-6 ? f : Math.sin(f * angle) / s) * sign;
    const q = [0, 1, 2, 3].map((k) => wa * a[k] + wb * b[k]), k = f < 0.5 ? i : i + 1;
    return { q, k };
  }
  function matrix([x, y, z, w]) {
    const n = 1 / Math.hypot(x, y, z, w); x *= n; y *= n; z *= n; w *= n;
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]];
  }
  const turn = (R, v) => R.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
  const columns = (points) => [0, 1, 2].map((k) => points.map((p) => (p ? p[k] : null)));

  // dark violet to yellow, readable without telling red from green (points of the scale "plasma")
  const SCALE = [[13, 8, 60], [84, 2, 163], [139, 10, 165], [185, 50, 137], [219, 92, 104], [244, 136, 73], [254, 188, 43], [240, 249, 33]];
  function heat(part) {
    const x = Math.max(0, Math.min(1, part)) * (SCALE.length - 1), i = Math.min(Math.floor(x), SCALE.length - 2), f = x - i;
    return "rgb(" + [0, 1, 2].map((k) => Math.round(SCALE[i][k] * (1 - f) + SCALE[i + 1][k] * f)).join(",") + ")";
  }
  const EDGES = (() => { // edges between faces that belong to different panels, or lie in different planes
    const seen = new Map(), found = [];
    shape.faces.forEach((face, f) => [[0, 1], [1, 2], [2, 0]].forEach(([a, b]) => {
      const key = [face[a], face[b]].sort((p, q) => p - q).join(" ");
      if (!seen.has(key)) seen.set(key, []);
      seen.get(key).push(f);
    }));
    const normal = (f) => { const [a, b, c] = shape.faces[f].map((i) => shape.vertices[i]); const u = b.map((x, k) => x - a[k]), v = c.map((x, k) => x - a[k]);
      const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]], l = Math.hypot(...n) || 1; return n.map((x) => x / l); };
    seen.forEach((faces, key) => {
      const flat = faces.length === 2 && shape.owner[faces[0]] === shape.owner[faces[1]] && normal(faces[0]).reduce((s, x, k) => s + x * normal(faces[1])[k], 0) > 0.999;
      if (!flat) found.push(key.split(" ").map(Number));
    });
    return found;
  })();

  function moving(time) {
    const { q, k } = at(time), R = matrix(q), V = shape.vertices.map((v) => turn(R, v));
    const edges = EDGES.flatMap(([a, b]) => [V[a].map((x) => x * 1.002), V[b].map((x) => x * 1.002), null]);
    const legs = shape.legs.flatMap(([hip, foot]) => [turn(R, hip), turn(R, foot), null]);
    const axis = shape.wheel_axes.flatMap((u) => [turn(R, u.map((x) => -0.75 * size * x)), turn(R, u.map((x) => 0.85 * size * x)), null]);
    const trail = [], tip = shape.wheel_axes[0] || [0, 0, 1], span = Math.min(60, (motion.n - 1) * motion.dt);
    for (let s = -span; s <= 1e-9; s += span / 60) trail.push(turn(matrix(at(Math.max(motion.t0, time + s)).q), tip.map((x) => 0.85 * size * x)));
    const h = motion.H ? [0, 1, 2].map((j) => motion.H[3 * k + j] / (motion.momentum_max || 1) * reach) : null;
    const faces = shape.owner.map((panel) => (panel < 0 ? colour("@hull") : heat(motion.P[k * app.panels.length + panel] / 255)));
    return { V: columns(V), lines: columns([...edges, ...legs]), axis: columns(axis.length ? axis : [null]), trail: columns(trail), h: columns(h ? [[0, 0, 0], h] : [null]), faces, k };
  }
  function traces(time) {
    const m = moving(time), sun = motion.sun.map((x) => x * reach), c = columns([[0, 0, 0], sun]);
    const line = (xyz, rest) => Object.assign({ type: "scatter3d", mode: "lines", x: xyz[0], y: xyz[1], z: xyz[2], hoverinfo: "skip", connectgaps: false }, rest);
    return [
      { type: "mesh3d", x: m.V[0], y: m.V[1], z: m.V[2], i: shape.faces.map((f) => f[0]), j: shape.faces.map((f) => f[1]), k: shape.faces.map((f) => f[2]), facecolor: m.faces, flatshading: true,
        lighting: { ambient: 0.8, diffuse: 0.35, specular: 0.05, roughness: 0.9 }, lightposition: { x: 1e4 * motion.sun[0], y: 1e4 * motion.sun[1], z: 1e4 * motion.sun[2] }, hoverinfo: "skip", showlegend: false },
      line(m.lines, { line: { width: 4, color: colour("@ink") }, name: "edges and legs", showlegend: false }),
      line(m.axis, { line: { width: 5, color: colour("@green") }, name: "wheel axis", showlegend: shape.wheel_axes.length > 0 }),
      line(m.trail, { line: { width: 2, color: colour("@green") }, name: "its path in the last minute", opacity: 0.55 }),
      line(m.h, { mode: "lines+markers+text", line: { width: 8, color: colour("@blue") }, marker: { size: [0, 7], symbol: "diamond", color: colour("@blue") }, text: ["", "momentum"], textposition: "top center", textfont: { color: colour("@blue"), size: 13 }, name: "angular momentum", showlegend: !!motion.H }),
      line(c, { mode: "lines+markers+text", line: { width: 5, color: colour("@gold") }, marker: { size: [0, 11], color: colour("@gold") }, text: ["", "Sun"], textposition: "top center", textfont: { color: colour("@gold"), size: 13 }, name: "to the Sun" }),
    ];
  }
  const CAMERAS = { side: () => ({ x: 0.47, y: -1.2, z: 0.34 }), sun: () => { const s = motion.sun; return { x: 1.25 * s[0], y: 1.25 * s[1] - 0.01, z: 1.25 * s[2] }; }, top: () => ({ x: 0.01, y: -0.05, z: 1.3 }) };
  function layout() {
    const axis = { range: [-1.08 * reach, 1.08 * reach], visible: false, showspikes: false };
    return styled({ scene: { xaxis: { ...axis }, yaxis: { ...axis }, zaxis: { ...axis }, aspectmode: "cube", camera: { eye: CAMERAS.side(), center: { x: 0.05, y: 0, z: 0.08 }, projection: { type: "perspective" } }, dragmode: "orbit" },
      showlegend: !window.sunspin.isNarrow(), legend: { orientation: "h", y: 0, yanchor: "bottom", font: { size: 11 } }, margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: "kept" });
  }
  function drawAll() {
    return Plotly.react(stage, traces(t), layout(), { ...config, displayModeBar: false }).then(() => {
      ready = true; stage.dataset.drawn = "yes"; drawn.set(stage, drawAll);
    });
  }
  function draw() {
    readings();
    if (!ready || busy) return;
    busy = true;
    const m = moving(t), parts = [m.V, m.lines, m.axis, m.trail, m.h];
    Plotly.restyle(stage, { x: parts.map((p) => p[0]), y: parts.map((p) => p[1]), z: parts.map((p) => p[2]), facecolor: [m.faces, undefined, undefined, undefined, undefined] }, [0, 1, 2, 3, 4]).then(() => { busy = false; });
  }
  // ---- readings
  function clockText(time) {
    if (motion.epoch === null) return `${time.toFixed(1)} s`;
    return new Date(Math.round((motion.epoch + 1000 * time) / 1000) * 1000).toISOString().replace("T", " ").slice(0, 19) + " UTC";
  }
  function readings() {
    const k = at(t).k, rate = motion.rate[k];
    $("lander-time").textContent = clockText(t);
    $("lander-rate").textContent = `${(rate * 180 / Math.PI).toPrecision(3)} deg/s (${rate.toPrecision(3)} rad/s)` + (rate > 1e-6 ? `, a turn in ${(2 * Math.PI / rate).toPrecision(3)} s` : "");
    document.querySelectorAll("[data-wheel]").forEach((e) => { const j = Number(e.dataset.wheel), w = motion.W[j] ? motion.W[j][k * 1] : NaN; e.textContent = Number.isFinite(w) ? `${w.toFixed(0)} rad/s (${(w * 60 / (2 * Math.PI)).toFixed(0)} turns per minute)` : "not known"; });
    document.querySelectorAll("[data-wheel-bar]").forEach((e) => { const j = Number(e.dataset.wheelBar); e.style.width = motion.W[j] && motion.wheel_max[j] ? `${Math.abs(motion.W[j][k]) / motion.wheel_max[j] * 100}%` : "0"; });
    app.panels.forEach((_, p) => {
      const part = motion.P[k * app.panels.length + p] / 255, bar = document.querySelector(`[data-panel-bar="${p}"]`);
      bar.style.width = `${100 * part}%`; bar.style.background = heat(part);
      document.querySelector(`[data-panel="${p}"]`).textContent = `${Math.round(100 * part)} %`;
    });
    slider.value = t;
    slider.setAttribute("aria-valuetext", clockText(t));
  }
  // ---- controls
  function choose(index, keep) {
    motion = unpack(app.motions[index]);
    const end = motion.t0 + (motion.n - 1) * motion.dt;
    slider.min = motion.t0; slider.max = end;
    if (!keep || t < motion.t0 || t > end) t = motion.t0;
    $("lander-about").textContent = motion.about ? motion.about[0].toUpperCase() + motion.about.slice(1) + "." : "";
    eventSelect.replaceChildren(new Option("an event", ""), ...motion.events.map((e) => new Option(`${e.what}, ${clockText(e.t).slice(motion.epoch === null ? 0 : 11)}`, e.t)));
    const ticks = $("lander-ticks");
    ticks.replaceChildren(...motion.events.slice(1, -1).map((e, row) => {
      const mark = document.createElement("span");
      mark.textContent = e.what; if (row % 2) mark.className = "lower"; mark.style.left = `${(e.t - motion.t0) / (end - motion.t0) * 100}%`;
      return mark;
    }));
    if (ready) drawAll();
    readings();
  }
  function setPlaying(on) {
    playing = on;
    playButton.textContent = on ? "❚❚ Pause" : "▶ Play";
    if (on) { if (t >= motion.t0 + (motion.n - 1) * motion.dt - 1e-6) t = motion.t0; last = performance.now(); requestAnimationFrame(step); }
  }
  function step(now) {
    if (!playing) return;
    t += Math.min(0.25, (now - last) / 1000) * Number($("lander-speed").value);
    last = now;
    const end = motion.t0 + (motion.n - 1) * motion.dt;
    if (t >= end) { t = end; setPlaying(false); }
    draw();
    if (playing) requestAnimationFrame(step);
  }
  motionSelect.addEventListener("change", () => choose(Number(motionSelect.value), true));
  eventSelect.addEventListener("change", () => { if (eventSelect.value !== "") { t = Number(eventSelect.value); draw(); } });
  slider.addEventListener("input", () => { t = Number(slider.value); draw(); });
  playButton.addEventListener("click", () => setPlaying(!playing));
  $("lander-camera").addEventListener("change", (event) => Plotly.relayout(stage, { "scene.camera.eye": CAMERAS[event.target.value]() }));
  stage.addEventListener("keydown", (event) => {
    if (event.key === " ") { setPlaying(!playing); event.preventDefault(); } else if (ready) turnCamera(stage, event);
  });
  document.querySelectorAll("button[data-seek]").forEach((button) => button.addEventListener("click", () => {
    const time = Number(button.dataset.seek), inside = (m) => time >= m.t0 - 1.5 && time <= m.t0 + (m.n - 1) * m.dt + 1.5;
    let index = Number(motionSelect.value);
    if (!inside(app.motions[index])) { index = app.motions.findIndex(inside); if (index < 0) return; motionSelect.value = String(index); }
    t = time; choose(index, true); t = Math.max(motion.t0, Math.min(motion.t0 + (motion.n - 1) * motion.dt, time)); draw();
    $("lander-app").scrollIntoView({ block: "start" });
  }));
  choose(0, false);
  stage.sunspinDraw = drawAll;
  near.observe(stage);
  window.sunspin.lander = { now: () => t, seek: (time) => { t = time; draw(); } };
})();
