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
      button.focus();
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
  const told = document.getElementById("told");
  const strip = document.getElementById("strip");
  const MOST_GRID = 60000;  // points of the grids of all images
  const scheme = window.matchMedia("(prefers-color-scheme: dark)");
  const chosen = content.traces.length;  // the trace after these
  let current = -1;
  let planes = [];  // the trace of the images, once they are read
  let owners = [];  // which image a point of theirs is of

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

  // Each picture as a grid of coloured points before its camera: the view has no images, but colours between points.
  async function images() {
    const read = (await Promise.all([...strip.children].map(grid))).filter((one) => one);
    const x = [], y = [], z = [], i = [], j = [], k = [], vertexcolor = [], text = [];
    for (const { index, columns, rows, pixels } of read) {
      const [topLeft, topRight, , bottomLeft] = content.corners[index];
      const first = x.length;
      for (let row = 0; row < rows; row += 1) {
        for (let column = 0; column < columns; column += 1) {
          const right = column / (columns - 1), down = row / (rows - 1), pixel = 4 * (row * columns + column);
          const at = topLeft.map((from, n) => from + right * (topRight[n] - from) + down * (bottomLeft[n] - from));
          x.push(at[0]); y.push(at[1]); z.push(at[2]);
          vertexcolor.push("rgb(" + pixels.subarray(pixel, pixel + 3).join() + ")");
          text.push(content.hover[index]);
          owners.push(index);
          if (row + 1 === rows || column + 1 === columns) continue;
          const corner = first + row * columns + column;
          i.push(corner, corner + 1);
          j.push(corner + 1, corner + columns + 1);
          k.push(corner + columns, corner + columns);
        }
      }
    }
    if (!read.length) return [];
    return [{
      type: "mesh3d", name: "images", showlegend: true, hoverinfo: "text",
      x, y, z, i, j, k, vertexcolor, text,
      lighting: { ambient: 1, diffuse: 0, specular: 0, fresnel: 0 },
    }];
  }

  async function grid(button, index) {
    const picture = button.querySelector("img");
    if (!picture) return null;
    try {
      await picture.decode();
    } catch {
      return null;  // damaged
    }
    const { naturalWidth: width, naturalHeight: height } = picture;
    const shrink = Math.min(1, Math.sqrt(MOST_GRID / strip.querySelectorAll("img").length / (width * height)));
    const canvas = document.createElement("canvas");
    const columns = canvas.width = Math.max(2, Math.round(shrink * width));
    const rows = canvas.height = Math.max(2, Math.round(shrink * height));
    const brush = canvas.getContext("2d", { willReadFrequently: true });
    brush.imageSmoothingQuality = "high";
    brush.drawImage(picture, 0, 0, columns, rows);
    return { index, columns, rows, pixels: brush.getImageData(0, 0, columns, rows).data };
  }

  function ring() {
    const at = current < 0 ? [] : [content.centres[current]];
    return {
      type: "scatter3d", mode: "markers", name: "chosen image", hoverinfo: "skip", showlegend: false,
      x: at.map((p) => p[0]), y: at.map((p) => p[1]), z: at.map((p) => p[2]),
      marker: { color: colour("ink"), size: 16, symbol: "circle-open", line: { width: 3 } },
    };
  }

  function layout() {
    const axis = (title) => ({
      title: { text: title }, color: colour("muted"), gridcolor: colour("line"),
      zerolinecolor: colour("line"), showbackground: false, showspikes: false, nticks: 6,
    });
    const narrow = place.clientWidth < 600;
    return {
      paper_bgcolor: "rgba(0,0,0,0)", font: { color: colour("ink") }, uirevision: "kept",
      margin: { l: 0, r: 0, t: 0, b: narrow ? 90 : 0 },
      legend: narrow
        ? { orientation: "h", x: 0, y: 0, yanchor: "top", bgcolor: "rgba(0,0,0,0)", font: { size: 11 } }
        : { x: 0, y: 1, bgcolor: colour("page") },
      hoverlabel: { bgcolor: colour("card"), bordercolor: colour("muted"), font: { color: colour("ink") } },
      scene: {
        aspectmode: "data", camera: { eye: eyes.oblique },
        xaxis: axis("x, m"), yaxis: axis("y, m"), zaxis: axis("z, m"),
      },
    };
  }

  const eyes = {
    oblique: { x: 1.0, y: 1.0, z: 0.9 }, above: { x: 0.01, y: 0, z: 1.8 },
    front: { x: 1.7, y: 0, z: 0.2 }, side: { x: 0, y: 1.7, z: 0.2 },
  };

  function draw() {
    const options = { responsive: true, displayModeBar: false };
    return Plotly.react(place, [...content.traces.map(coloured), ring(), ...planes], layout(), options);
  }

  function look(eye) {
    Plotly.relayout(place, { "scene.camera.eye": eye });
  }

  function show(index) {
    if (index === current) return;
    current = index;
    told.textContent = content.told[index];
    for (const [i, button] of [...strip.children].entries()) {
      button.setAttribute("aria-pressed", String(i === index));
    }
    const button = strip.children[index];
    strip.scrollTo({ left: button.offsetLeft - strip.offsetLeft - strip.clientWidth / 2 + button.clientWidth / 2 });
    const one = ring();
    Plotly.restyle(place, { x: [one.x], y: [one.y], z: [one.z] }, [chosen]);
  }

  for (const [index, name] of content.names.entries()) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = content.bad[index] ? "bad" : "";
    button.setAttribute("aria-pressed", "false");
    if (content.pictures[index]) {
      const picture = document.createElement("img");
      picture.src = "data:image/jpeg;base64," + content.pictures[index];
      picture.alt = "";
      button.append(picture);
    }
    button.append(name);
    button.addEventListener("click", () => show(index));
    strip.append(button);
  }

  // Turns by a tenth of a right angle, or comes closer.
  function turned(eye, key) {
    const far = Math.hypot(eye.x, eye.y, eye.z);
    const step = Math.PI / 20;
    let around = Math.atan2(eye.y, eye.x), up = Math.asin(eye.z / far), reach = far;
    if (key === "ArrowLeft") around -= step;
    else if (key === "ArrowRight") around += step;
    else if (key === "ArrowUp") up = Math.min(up + step, 1.55);
    else if (key === "ArrowDown") up = Math.max(up - step, -1.55);
    else if (key === "+" || key === "=") reach /= 1.2;
    else if (key === "-") reach *= 1.2;
    else return null;
    return {
      x: reach * Math.cos(up) * Math.cos(around), y: reach * Math.cos(up) * Math.sin(around), z: reach * Math.sin(up),
    };
  }

  place.addEventListener("keydown", (event) => {
    const camera = place.layout.scene.camera || {};
    const eye = turned(camera.eye || eyes.oblique, event.key);
    if (!eye) return;
    event.preventDefault();
    look(eye);
  });

  draw().then(images).then((read) => {
    planes = read;
    return draw();
  }).then(() => {
    place.on("plotly_hover", (event) => {
      const point = event.points[0];
      if (point.data.type === "mesh3d") show(owners[point.pointNumber]);
      else if (point.data.mode === "markers" && point.data.text) show(point.pointNumber);
    });
    place.dataset.drawn = "yes";
  });
  for (const button of document.querySelectorAll("button[data-eye]")) {
    button.addEventListener("click", () => look(eyes[button.dataset.eye]));
  }
  scheme.addEventListener("change", draw);
})();
