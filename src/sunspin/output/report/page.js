// Draws the interactive views when they come near the window, switches the theme, filters the rows of the comparison.
"use strict";
(function () {
  const data = JSON.parse(document.getElementById("data").textContent);
  const root = document.documentElement;
  const config = { displaylogo: false, displayModeBar: false, responsive: true, plotlyServerURL: "" };
  const ink = () => getComputedStyle(root).getPropertyValue("--ink").trim();

  // ---- interactive views
  const drawn = new Set();
  function draw(element) {
    const spec = data[element.dataset.plot];
    if (drawn.has(element) || !spec) return;
    drawn.add(element);
    const narrow = window.innerWidth < 640;
    spec.layout.font = { family: "system-ui, sans-serif", size: narrow ? 11 : 13, color: ink() };
    // from farther away the titles of the axes stay inside a narrow window
    const eye = ((spec.layout.scene || {}).camera || {}).eye;
    if (narrow && eye) for (const axis of "xyz") eye[axis] *= 1.3;
    Plotly.newPlot(element, spec.data, spec.layout, config)
      .then(() => (spec.frames && spec.frames.length ? Plotly.addFrames(element, spec.frames) : null))
      .then(() => { element.dataset.drawn = "yes"; });
    element.tabIndex = 0;
    element.addEventListener("keydown", (event) => turnCamera(element, event));
  }
  const near = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) draw(entry.target);
  }, { rootMargin: "300px" });
  document.querySelectorAll("[data-plot]").forEach((element) => near.observe(element));

  // arrow keys turn the camera about its target, + and - zoom
  function turnCamera(element, event) {
    const steps = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.12], ArrowDown: [0, -0.12] };
    const zoom = { "+": 0.88, "=": 0.88, "-": 1.14 }[event.key];
    if (!steps[event.key] && !zoom) return;
    const camera = JSON.parse(JSON.stringify(element._fullLayout.scene.camera)), eye = camera.eye;
    const r = Math.hypot(eye.x, eye.y, eye.z) * (zoom || 1), [dx, dy] = steps[event.key] || [0, 0];
    const azimuth = Math.atan2(eye.y, eye.x) + dx;
    const height = Math.max(-1.5, Math.min(1.5, Math.asin(eye.z / Math.hypot(eye.x, eye.y, eye.z)) + dy));
    camera.eye = { x: r * Math.cos(height) * Math.cos(azimuth), y: r * Math.cos(height) * Math.sin(azimuth), z: r * Math.sin(height) };
    Plotly.relayout(element, { "scene.camera": camera });
    event.preventDefault();
  }

  // ---- theme
  const themeButton = document.getElementById("theme");
  function setTheme(name) {
    root.dataset.theme = name;
    themeButton.textContent = name === "dark" ? "Light" : "Dark";
    themeButton.setAttribute("aria-pressed", String(name === "dark"));
    drawn.forEach((element) => { if (element.dataset.drawn) Plotly.relayout(element, { "font.color": ink() }); });
  }
  const darkSystem = window.matchMedia("(prefers-color-scheme: dark)");
  setTheme(darkSystem.matches ? "dark" : "light");
  themeButton.addEventListener("click", () => setTheme(root.dataset.theme === "dark" ? "light" : "dark"));
  darkSystem.addEventListener("change", (event) => setTheme(event.matches ? "dark" : "light"));

  document.querySelectorAll(".enlarge").forEach((button) => button.addEventListener("click", () => {
    const large = button.closest(".drawn").classList.toggle("large");
    button.textContent = large ? "Fit the width" : "Enlarge";
    button.setAttribute("aria-pressed", String(large));
  }));

  // ---- rows of the comparison
  const search = document.getElementById("row-search");
  let verdict = "";
  function filterRows() {
    let shown = 0;
    document.querySelectorAll("table.rows tbody tr[data-row]").forEach((row) => {
      const note = row.nextElementSibling && row.nextElementSibling.classList.contains("note") ? row.nextElementSibling : null;
      const text = (row.textContent + (note ? note.textContent : "")).toLowerCase();
      const fits = (!verdict || row.dataset.verdict === verdict) && text.includes(search.value.trim().toLowerCase());
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
    document.getElementById("row-count").textContent = `${shown} rows`;
  }
  document.querySelectorAll("button[data-filter]").forEach((button) => button.addEventListener("click", () => {
    document.querySelectorAll("button[data-filter]").forEach((each) => each.setAttribute("aria-pressed", String(each === button)));
    verdict = button.dataset.filter;
    filterRows();
  }));
  if (search) { search.addEventListener("input", filterRows); filterRows(); }
})();
