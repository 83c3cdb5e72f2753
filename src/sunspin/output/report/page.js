// Draws the plots of the page when they come near the window, in the colours of the theme, and lets keys turn the 3-D ones.
"use strict";
(function () {
  const data = JSON.parse(document.getElementById("data").textContent);
  const root = document.documentElement;
  const narrowWindow = window.matchMedia("(max-width: 40rem)");
  const darkSystem = window.matchMedia("(prefers-color-scheme: dark)");
  let printing = ""; // the theme to come back to
  const drawn = new Map(); // element -> function that draws it anew
  const config = { displaylogo: false, displayModeBar: window.matchMedia("(hover: hover)").matches ? "hover" : false, responsive: true, plotlyServerURL: "", modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d", "tableRotation", "resetCameraLastSave3d"] };

  // ---- theme: "@blue" is the colour --blue of the style sheet, "@blue:0.2" the same, translucent
  function colour(token) {
    const [name, alpha] = token.slice(1).split(":");
    const hex = getComputedStyle(root).getPropertyValue("--" + name).trim();
    if (alpha === undefined || !/^#[0-9a-f]{6}$/i.test(hex)) return hex;
    const part = (k) => parseInt(hex.slice(k, k + 2), 16);
    return `rgba(${part(1)},${part(3)},${part(5)},${alpha})`;
  }
  function themed(value) {
    if (typeof value === "string") return /^@[a-z]+(:[\d.]+)?$/.test(value) ? colour(value) : value;
    if (Array.isArray(value)) return value.map(themed);
    if (value && typeof value === "object") {
      const copy = {};
      for (const key of Object.keys(value)) copy[key] = key === "bdata" ? value[key] : themed(value[key]);
      return copy;
    }
    return value;
  }
  function setPath(object, path, value) {
    const keys = path.split(".");
    let at = object;
    for (const key of keys.slice(0, -1)) at = at[key] = typeof at[key] === "object" && at[key] ? at[key] : {};
    at[keys[keys.length - 1]] = value;
  }
  function styled(layout) {
    const ink = colour("@ink"), grid = colour("@grid"), line = colour("@line");
    layout.paper_bgcolor = layout.plot_bgcolor = "rgba(0,0,0,0)";
    layout.font = Object.assign({ family: "system-ui, sans-serif", size: 13, color: ink }, layout.font);
    layout.modebar = { bgcolor: "rgba(0,0,0,0)", color: colour("@muted"), activecolor: ink };
    layout.hoverlabel = { bgcolor: colour("@panel"), bordercolor: line, font: { color: ink } };
    layout.colorway = ["@blue", "@orange", "@green", "@pink", "@gold"].map(colour);
    for (const key of Object.keys(layout)) {
      if (/^[xy]axis\d*$/.test(key)) {
        layout[key] = Object.assign({ gridcolor: grid, linecolor: line, zerolinecolor: line, automargin: true }, layout[key]);
        if (layout[key].title) layout[key].title = Object.assign({}, layout[key].title, { font: Object.assign({ size: layout.font.size }, layout[key].title.font) });
      }
      if (/^scene\d*$/.test(key))
        for (const axis of ["xaxis", "yaxis", "zaxis"])
          layout[key][axis] = Object.assign({ gridcolor: grid, zerolinecolor: line, linecolor: line, showbackground: false, color: ink }, layout[key][axis]);
    }
    return layout;
  }
  function isNarrow() { return narrowWindow.matches; }

  // ---- plots
  function specOf(id, view) {
    const plot = data.plots[id];
    const traces = themed(plot.data), layout = themed(plot.layout);
    const chosen = plot.views && plot.views[view];
    if (chosen) {
      traces.forEach((trace, k) => { trace.visible = chosen.show.includes(k); });
      if (chosen.range) layout.xaxis.range = chosen.range.slice();
    }
    if (isNarrow()) for (const path of Object.keys(plot.narrow || {})) setPath(layout, path, JSON.parse(JSON.stringify(plot.narrow[path])));
    layout.uirevision = layout.uirevision || "kept";
    return { traces, layout: styled(layout) };
  }
  function draw(element) {
    const id = element.dataset.plot, plot = data.plots[id];
    const select = document.querySelector(`select[data-view-of="${CSS.escape(id)}"]`);
    const { traces, layout } = specOf(id, select ? Number(select.value) : 0);
    element.style.height = (layout.height || plot.height) + "px";
    delete layout.height;
    return Plotly.react(element, traces, layout, config).then(() => {
      if (!drawn.has(element)) {
        drawn.set(element, () => draw(element));
        if (layout.scene) threeD(element);
      }
      element.dataset.drawn = "yes";
    });
  }
  const near = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) { near.unobserve(entry.target); (entry.target.sunspinDraw || draw)(entry.target); }
  }, { rootMargin: "500px" });
  document.querySelectorAll("[data-plot]").forEach((element) => near.observe(element));
  document.querySelectorAll("select[data-view-of]").forEach((select) => {
    const id = select.dataset.viewOf;
    select.addEventListener("change", () => {
      const view = data.plots[id].views[Number(select.value)];
      const text = document.querySelector(`[data-text-of="${CSS.escape(id)}"]`);
      if (text) text.textContent = view.text || "";
      draw(document.querySelector(`[data-plot="${CSS.escape(id)}"]`));
    });
  });

  // ---- 3-D by keyboard: arrow keys turn the camera about its target, + and - zoom
  function turnCamera(element, event) {
    const steps = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.12], ArrowDown: [0, -0.12] };
    const zoom = { "+": 0.88, "=": 0.88, "-": 1.14 }[event.key];
    if (!steps[event.key] && !zoom) return false;
    const camera = JSON.parse(JSON.stringify(element._fullLayout.scene.camera)), eye = camera.eye;
    let r = Math.hypot(eye.x, eye.y, eye.z), azimuth = Math.atan2(eye.y, eye.x), height = Math.asin(eye.z / r);
    if (zoom) r *= zoom;
    else { azimuth += steps[event.key][0]; height = Math.max(-1.5, Math.min(1.5, height + steps[event.key][1])); }
    camera.eye = { x: r * Math.cos(height) * Math.cos(azimuth), y: r * Math.cos(height) * Math.sin(azimuth), z: r * Math.sin(height) };
    Plotly.relayout(element, { "scene.camera": camera });
    event.preventDefault();
    return true;
  }
  function threeD(element) {
    element.classList.add("three");
    element.tabIndex = 0;
    element.addEventListener("keydown", (event) => turnCamera(element, event));
  }

  // ---- theme and width
  const themeButton = document.getElementById("theme");
  function setTheme(name) {
    root.dataset.theme = name;
    themeButton.textContent = name === "dark" ? "Light" : "Dark";
    themeButton.setAttribute("aria-pressed", String(name === "dark"));
    drawn.forEach((again) => again());
  }
  setTheme(darkSystem.matches ? "dark" : "light");
  themeButton.addEventListener("click", () => setTheme(root.dataset.theme === "dark" ? "light" : "dark"));
  darkSystem.addEventListener("change", (event) => setTheme(event.matches ? "dark" : "light"));
  narrowWindow.addEventListener("change", () => { if (!printing) drawn.forEach((again) => again()); });

  document.querySelectorAll(".enlarge").forEach((button) => button.addEventListener("click", () => {
    const large = button.closest(".drawn").classList.toggle("large");
    button.textContent = large ? "Fit the width" : "Enlarge";
    button.setAttribute("aria-pressed", String(large));
  }));

  // ---- printing: all plots drawn, in light colours, scaled to the paper; WebGL canvases, which print blank, as pictures
  function freeze(element) {
    const box = element.querySelector(".svg-container");
    if (!box || !box.offsetWidth) return;
    const whole = box.getBoundingClientRect(), part = (x, of) => `${100 * x / of}%`;
    element.style.setProperty("--ratio", `${whole.width} / ${whole.height}`);
    box.querySelectorAll(":scope > svg.main-svg").forEach((svg) => svg.setAttribute("viewBox", `0 0 ${whole.width} ${whole.height}`));
    const plot = element._fullLayout && element._fullLayout.scene && element._fullLayout.scene._scene && element._fullLayout.scene._scene.glplot;
    if (plot && plot.canvas) {
      const at = plot.canvas.getBoundingClientRect(), image = new Image();
      plot.redraw();
      image.src = plot.canvas.toDataURL();
      image.className = "print-image";
      image.alt = "";
      Object.assign(image.style, { left: part(at.left - whole.left, whole.width), top: part(at.top - whole.top, whole.height), width: part(at.width, whole.width), height: part(at.height, whole.height) });
      box.prepend(image);
    }
    element.classList.add("frozen");
  }
  function thaw(element) {
    element.classList.remove("frozen");
    element.querySelectorAll(".print-image").forEach((image) => image.remove());
    element.querySelectorAll(".svg-container > svg.main-svg").forEach((svg) => svg.removeAttribute("viewBox"));
  }
  window.addEventListener("beforeprint", () => {
    if (printing) return;
    printing = root.dataset.theme;
    setTheme("light");
    document.querySelectorAll("[data-plot], #slices-plot, #lander-stage").forEach((element) => { if (!drawn.has(element)) (element.sunspinDraw || draw)(element); });
    document.querySelectorAll(".js-plotly-plot").forEach(freeze);
  });
  window.addEventListener("afterprint", () => {
    document.querySelectorAll(".js-plotly-plot").forEach(thaw);
    const theme = printing;
    printing = "";
    setTheme(theme || "light");
  });

  // ---- rows of the comparison
  const rowFilter = { verdict: "", text: "" };
  function filterRows() {
    let shown = 0;
    document.querySelectorAll("table.rows tbody tr[data-row]").forEach((row) => {
      const note = row.nextElementSibling && row.nextElementSibling.classList.contains("note") ? row.nextElementSibling : null;
      const text = (row.textContent + (note ? note.textContent : "")).toLowerCase();
      const fits = (!rowFilter.verdict || row.dataset.verdict === rowFilter.verdict) && text.includes(rowFilter.text);
      row.hidden = !fits;
      if (note) note.hidden = !fits;
      shown += fits ? 1 : 0;
    });
    document.querySelectorAll("table.rows").forEach((table) => {
      const empty = !table.querySelector("tbody tr[data-row]:not([hidden])");
      table.hidden = empty;
      const heading = table.previousElementSibling;
      if (heading && heading.tagName === "H4") heading.hidden = empty;
    });
    document.querySelectorAll(".row-group").forEach((group) => { group.hidden = !group.querySelector("table.rows:not([hidden])"); });
    const count = document.getElementById("row-count");
    if (count) count.textContent = `${shown} rows`;
  }
  document.querySelectorAll("button[data-filter]").forEach((button) => button.addEventListener("click", () => {
    document.querySelectorAll("button[data-filter]").forEach((other) => other.setAttribute("aria-pressed", String(other === button)));
    rowFilter.verdict = button.dataset.filter;
    filterRows();
  }));
  const search = document.getElementById("row-search");
  if (search) { search.addEventListener("input", () => { rowFilter.text = search.value.trim().toLowerCase(); filterRows(); }); filterRows(); }

  // ---- slices through a volume
  function bytes(text) { const raw = atob(text), out = new Uint8Array(raw.length); for (let k = 0; k < raw.length; k++) out[k] = raw.charCodeAt(k); return out; }
  function slices() {
    const volumes = data.slices.volumes, element = document.getElementById("slices-plot");
    const select = document.getElementById("slices-volume"), slider = document.getElementById("slices-slider"), value = document.getElementById("slices-value");
    volumes.forEach((v) => { v.cells = bytes(v.values); });
    function show() {
      const v = volumes[Number(select.value)], k = Math.min(Number(slider.value), v.z.length - 1), [nx, ny] = v.shape, z = [], real = [];
      for (let j = 0; j < ny; j++) {
        const row = new Array(nx);
        for (let i = 0; i < nx; i++) { const cell = v.cells[k * nx * ny + i * ny + j]; row[i] = cell ? v.low + (cell - 1) / 254 * (v.high - v.low) : null; }
        z.push(row); real.push(row.map((x) => (x === null ? null : Math.pow(10, x))));
      }
      value.textContent = `${v.z[k].toFixed(3)} rad/s`;
      const marks = [1e-6, 1e-5, 1e-4, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1];
      const here = v.best[2] === k;
      const traces = [
        { type: "heatmap", x: v.x, y: v.y, z: z, zmin: v.low, zmax: v.high, colorscale: "Cividis", reversescale: true, colorbar: { title: { text: v.metric }, thickness: 14, tickvals: marks.map(Math.log10), ticktext: marks.map(String) },
          customdata: real, hovertemplate: `ωx %{x:.3f}<br>ωy %{y:.3f}<br>${v.metric} %{customdata:.4f}<extra></extra>` },
        { type: "scatter", mode: "markers", x: [v.x[v.best[0]]], y: [v.y[v.best[1]]], marker: { symbol: "x", size: 11, color: colour("@orange"), opacity: here ? 1 : 0.35 }, hoverinfo: "skip", showlegend: false },
      ];
      const layout = styled({ xaxis: { title: { text: "ωx (rad/s)" } }, yaxis: { title: { text: "ωy (rad/s)" } }, margin: { l: 64, r: 8, t: 8, b: 50 }, font: { size: isNarrow() ? 11 : 13 } });
      return Plotly.react(element, traces, layout, config).then(() => { element.dataset.drawn = "yes"; drawn.set(element, show); });
    }
    select.addEventListener("change", () => { const v = volumes[Number(select.value)]; slider.max = v.z.length - 1; slider.value = v.best[2]; show(); });
    slider.addEventListener("input", show);
    element.sunspinDraw = show;
    near.observe(element);
  }
  if (data.slices) slices();

  window.sunspin = { data, colour, styled, config, drawn, near, turnCamera, isNarrow, bytes };
})();
