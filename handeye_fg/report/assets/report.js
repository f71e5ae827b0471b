"use strict";
// Copy buttons, and the 3D view in the page's own colours.
(function () {
  const status = document.getElementById("copied");

  async function copy(button) {
    const text = document.getElementById(button.dataset.copy).textContent;
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      // A page without a secure origin has no clipboard; the selection has.
      const area = document.createElement("textarea");
      area.value = text;
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    status.textContent = button.dataset.what + " copied";
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  }

  for (const button of document.querySelectorAll("button[data-copy]")) {
    button.addEventListener("click", () => copy(button));
  }

  const place = document.getElementById("view");
  if (!place) return;
  const content = JSON.parse(document.getElementById("view-data").textContent);
  const picture = document.getElementById("picture");
  const pictureName = document.getElementById("picture-name");
  const scheme = window.matchMedia("(prefers-color-scheme: dark)");

  function colour(name) {
    return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  }

  function coloured(trace) {
    const copied = { ...trace };
    if (trace.line) copied.line = { ...trace.line, color: colour(trace.line.color) };
    if (trace.marker) {
      const names = trace.marker.color;
      copied.marker = {
        ...trace.marker,
        color: Array.isArray(names) ? names.map(colour) : colour(names),
      };
    }
    return copied;
  }

  function layout() {
    const axis = (title) => ({
      title: { text: title }, color: colour("muted"), gridcolor: colour("line"),
      zerolinecolor: colour("line"), showbackground: false,
    });
    return {
      paper_bgcolor: "rgba(0,0,0,0)", font: { color: colour("ink") }, uirevision: "kept",
      margin: { l: 0, r: 0, t: 0, b: 0 }, legend: { x: 0, y: 1, bgcolor: "rgba(0,0,0,0)" },
      scene: {
        aspectmode: "data", xaxis: axis("x, m"), yaxis: axis("y, m"), zaxis: axis("z, m"),
      },
    };
  }

  function draw() {
    const options = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["toImage"] };
    return Plotly.react(place, content.traces.map(coloured), layout(), options);
  }

  function show(index) {
    const data = content.pictures[index];
    picture.hidden = !data;
    if (data) picture.src = "data:image/jpeg;base64," + data;
    picture.alt = content.names[index];
    pictureName.textContent = content.names[index];
  }

  const eyes = {
    oblique: { x: 1.25, y: 1.25, z: 1.25 }, above: { x: 0.01, y: 0, z: 2.2 },
    front: { x: 2.2, y: 0, z: 0.2 }, side: { x: 0, y: 2.2, z: 0.2 },
  };
  draw().then(() => {
    place.on("plotly_hover", (event) => {
      const point = event.points[0];
      if (point.data.mode === "markers" && point.data.text) show(point.pointNumber);
    });
    place.dataset.drawn = "yes";
  });
  for (const button of document.querySelectorAll("button[data-eye]")) {
    button.addEventListener("click", () =>
      Plotly.relayout(place, { "scene.camera.eye": eyes[button.dataset.eye] }));
  }
  scheme.addEventListener("change", draw);
})();
