"use strict";
// Texts of the data are only ever set as textContent or attributes: they cannot become markup.
const data = JSON.parse(document.getElementById("data").textContent);
const main = document.getElementById("main");
const VIRIDIS = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"];
const redraws = []; // what depends on the colours of the theme

// ---- elements ---------------------------------------------------------------------------------

function make(name, attributes = {}, ...children) {
  const isSvg = make.SVG.has(name);
  const node = isSvg ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else node.setAttribute(key, value);
  }
  node.append(...children);
  return node;
}
make.SVG = new Set(["svg", "g", "path", "circle", "rect", "text"]);

function section(title, ...children) {
  const card = make("section", {}, make("h2", {}, title), ...children);
  main.append(card);
  return card;
}

function quiet(text) { // what stands between backticks is code
  const parts = text.split("`").map((part, index) => (index % 2 ? make("code", {}, part) : part));
  return make("p", { class: "quiet" }, ...parts);
}

function number(value, digits = 1) {
  if (value === null) return "–";
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}

function colour(share) { // of the viridis scale
  const place = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1);
  const low = Math.min(Math.floor(place), VIRIDIS.length - 2);
  const mix = [1, 3, 5].map((at) => {
    const [a, b] = [low, low + 1].map((index) => parseInt(VIRIDIS[index].slice(at, at + 2), 16));
    return Math.round(a + (b - a) * (place - low));
  });
  return `rgb(${mix.join(",")})`;
}

function css(name) { return getComputedStyle(document.documentElement).getPropertyValue(name).trim(); }

// ---- planes -----------------------------------------------------------------------------------

class Plane { // a square or rectangle of some coordinates, drawn to scale
  constructor(low, high, label) {
    this.low = low;
    this.size = [high[0] - low[0], high[1] - low[1]];
    this.width = 420;
    this.height = Math.min(Math.max((this.width * this.size[1]) / this.size[0], 200), 520);
    this.scale = Math.min(this.width / this.size[0], this.height / this.size[1]);
    this.left = (this.width - this.scale * this.size[0]) / 2;
    this.top = (this.height - this.scale * this.size[1]) / 2;
    this.svg = make("svg", { class: "plane", viewBox: `0 0 ${this.width} ${this.height}`, role: "img", "aria-label": label });
    this.layers = {};
  }
  layer(name) { // its content begins anew
    if (!this.layers[name]) this.svg.append((this.layers[name] = make("g")));
    this.layers[name].replaceChildren();
    return this.layers[name];
  }
  to([x, y]) {
    return [this.left + (x - this.low[0]) * this.scale, this.height - this.top - (y - this.low[1]) * this.scale];
  }
  from(event) {
    const box = this.svg.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * this.width;
    const y = ((event.clientY - box.top) / box.height) * this.height;
    return [this.low[0] + (x - this.left) / this.scale, this.low[1] + (this.height - this.top - y) / this.scale];
  }
  circle(point, radius, attributes) {
    const [cx, cy] = this.to(point);
    return make("circle", { cx, cy, r: radius, ...attributes });
  }
  path(points, kind) {
    const corners = points.map((point) => this.to(point).map((value) => value.toFixed(1)).join(" "));
    return make("path", { d: `M${corners.join("L")}`, class: kind });
  }
  text(x, y, words, attributes = {}) { return make("text", { x, y, ...attributes }, words); }
}

function bounds(points, margin) {
  const low = [0, 1].map((axis) => Math.min(...points.map((point) => point[axis])) - margin);
  const high = [0, 1].map((axis) => Math.max(...points.map((point) => point[axis])) + margin);
  return [low, high];
}

function worldPlane(paths, label) {
  const { goals, radius } = data.plane;
  const corners = goals.flatMap(([x, y]) => [[x - radius, y - radius], [x + radius, y + radius]]);
  const [low, high] = bounds(corners.concat(paths.flat().filter((point) => point[0] !== null)), 0);
  const margin = 0.04 * Math.max(high[0] - low[0], high[1] - low[1]);
  return new Plane(low.map((x) => x - margin), high.map((x) => x + margin), label);
}

function drawGoals(plane, chosen) { // all of them, or one with its region and objects
  const layer = plane.layer("goals");
  const { goals, radius, landmarks } = data.plane;
  if (chosen === null) {
    for (const goal of goals) layer.append(plane.circle(goal, 2.5, { class: "goal" }));
    return;
  }
  for (const place of landmarks ? landmarks[chosen] : []) {
    const [x, y] = plane.to(place);
    layer.append(make("rect", { x: x - 5, y: y - 5, width: 10, height: 10, class: "object" }));
  }
  layer.append(plane.circle(goals[chosen], Math.max(radius * plane.scale, 4), { class: "region" }));
  layer.append(plane.circle(goals[chosen], 4.5, { class: "goal" }));
}

function direction([x, y]) { // as a share of the directions in which goals lie
  const angles = data.plane.goals.map((goal) => Math.atan2(goal[1], goal[0]));
  const [low, high] = [Math.min(...angles), Math.max(...angles)];
  return (Math.atan2(y, x) - low) / (high - low || 1);
}

function distance(a, b) { return Math.hypot(...a.map((value, axis) => value - b[axis])); }

// Said where something is missing.
const NO_PLANE = "The family does not say where things are in a plane, so no paths can be shown.";
const NO_LATENTS = "This method has no latent.";
const NO_SEARCH = "There is no prior over returns yet: `maesn prior DIR` makes it, then report again.";

// ---- latent explorer --------------------------------------------------------------------------

function explorer(found) {
  if (!found) return section("Latent explorer", quiet(NO_LATENTS));
  const size = found.latents[0].length;
  const edge = Math.max(...found.latents.flat().map(Math.abs));
  const latents = new Plane([-edge * 1.06, -edge * 1.06], [edge * 1.06, edge * 1.06], "Plane of latents");
  const world = worldPlane(found.paths, "Where the chosen latent leads");
  const said = make("p", { class: "said", "aria-live": "polite", id: "explorer-said" });
  const z = Array(size).fill(0);
  let task = null;

  const dots = latents.layer("dots");
  found.latents.forEach((one, index) => {
    const fill = colour(direction(found.paths[index].at(-1)));
    dots.append(latents.circle([one[0], one[1] ?? 0], size > 2 ? 3 : 7, { fill, opacity: 0.45 }));
  });
  latents.svg.append(latents.circle([0, 0], latents.scale, { class: "prior" }));
  const rings = found.adapted.map((one, index) => {
    const stroke = colour(direction(data.plane.goals[index]));
    const ring = latents.circle([one[0], one[1] ?? 0], 5, { class: "ring", stroke });
    ring.addEventListener("pointerdown", (event) => { event.stopPropagation(); choose(index); });
    latents.svg.append(ring);
    return ring;
  });
  const handle = latents.circle([0, 0], 10, {
    class: "handle", tabindex: 0, role: "slider", "aria-label": "Chosen latent; move with the arrow keys",
    "aria-valuetext": "", id: "handle",
  });
  latents.svg.append(handle);
  latents.svg.append(latents.text(latents.width - 8, latents.height - 8, "z₁ →", { "text-anchor": "end" }));
  if (size > 1) latents.svg.append(latents.text(8, 18, "↑ z₂"));

  const tasks = make("select", { id: "explorer-task", onchange: () => choose(tasks.value === "" ? null : Number(tasks.value)) },
    make("option", { value: "" }, "all tasks"),
    ...found.adapted.map((_, index) => make("option", { value: index }, `task ${index}, its adapted latent`)));
  const sliders = Array.from({ length: Math.max(size - 2, 0) }, (_, extra) => {
    const axis = extra + 2;
    const slider = make("input", { type: "range", min: -edge, max: edge, step: edge / 50, value: 0,
      oninput: () => { z[axis] = Number(slider.value); task = null; show(); } });
    return { axis, slider, row: make("label", {}, `z${axis + 1}`, slider) };
  });

  function choose(index) {
    task = index;
    if (index !== null) found.adapted[index].forEach((value, axis) => { z[axis] = Math.min(Math.max(value, -edge), edge); });
    show();
  }

  function move(point) {
    [0, 1].slice(0, size).forEach((axis) => { z[axis] = Math.min(Math.max(point[axis], -edge), edge); });
    task = null;
    show();
  }

  function show() {
    const order = found.latents.map((one, index) => [distance(one, z), index]).sort((a, b) => a[0] - b[0]);
    const nearest = order[0][1];
    const [cx, cy] = latents.to([z[0], z[1] ?? 0]);
    handle.setAttribute("cx", cx);
    handle.setAttribute("cy", cy);
    rings.forEach((ring, index) => ring.classList.toggle("now", index === task));
    sliders.forEach(({ axis, slider }) => { slider.value = z[axis]; });
    tasks.value = task === null ? "" : task;
    drawGoals(world, task);
    const ways = world.layer("ways");
    for (const [, index] of order.slice(1, 9)) ways.append(world.path(found.paths[index], "way"));
    ways.append(world.path(found.paths[nearest], "way now"));
    const end = found.paths[nearest].at(-1);
    ways.append(world.circle(end, 5.5, { class: "end" }));
    const words = `z = (${z.map((value) => number(value)).join(", ")}) leads to (${number(end[0])} m, ${number(end[1])} m)` +
      (task === null ? "." : `, ${number(distance(end, data.plane.goals[task]))} m from the goal of task ${task}.`);
    said.textContent = words;
    handle.setAttribute("aria-valuetext", words);
  }

  latents.svg.addEventListener("pointerdown", (event) => {
    latents.svg.setPointerCapture(event.pointerId);
    handle.focus({ preventScroll: true });
    move(latents.from(event));
  });
  latents.svg.addEventListener("pointermove", (event) => {
    if (event.buttons) move(latents.from(event));
  });
  handle.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const step = steps[event.key];
    if (!step) return;
    event.preventDefault();
    move([z[0] + (step[0] * edge) / 20, (z[1] ?? 0) + (step[1] * edge) / 20]);
  });
  section("Latent explorer",
    quiet("Move the orange point: each latent z is one plan. The dashed circle is the prior's standard deviation; " +
      "rings are the tasks' latents after adaptation, in the colour of their goal's direction."),
    make("div", { class: "pair" }, latents.svg, world.svg), said,
    make("div", { class: "controls" }, make("label", {}, "Task", tasks), ...sliders.map(({ row }) => row)));
  show();
}

// ---- searches ---------------------------------------------------------------------------------

function searches(found) {
  if (!found) return section("Watch a search", quiet(NO_SEARCH));
  const episodes = found.returns[0].length;
  const edge = found.edge;
  const beliefs = new Plane([-edge, -edge], [edge, edge], "What the search believes of each latent");
  const world = worldPlane(found.paths.flat(), "Where the search has been");
  const said = make("p", { class: "said", "aria-live": "polite", id: "search-said" });
  const tasks = make("select", { id: "search-task", onchange: () => { slider.value = 0; show(); } },
    ...found.task.map((task, index) => make("option", { value: index }, `task ${task}`)));
  const kind = make("select", { id: "search-kind", onchange: () => show() },
    make("option", { value: "mean" }, "expected return"), make("option", { value: "std" }, "uncertainty"));
  const slider = make("input", { type: "range", id: "search-episode", min: 0, max: episodes, step: 1, value: 0, oninput: () => show() });
  const play = make("button", { type: "button", id: "search-play", onclick: toggle }, "Play");
  const cells = found.mean[0][0].length;
  const side = beliefs.width / cells;
  let timer = null;

  function toggle() {
    if (timer === null) {
      if (Number(slider.value) === episodes) slider.value = 0;
      play.textContent = "Pause";
      timer = setInterval(() => {
        slider.value = Number(slider.value) + 1;
        show();
        if (Number(slider.value) === episodes) toggle();
      }, 900);
    } else {
      clearInterval(timer);
      timer = null;
      play.textContent = "Play";
    }
    show();
  }

  function show() {
    const at = Number(tasks.value);
    const done = Number(slider.value);
    const values = found[kind.value][at];
    const [low, high] = [Math.min(...values.flat(2)), Math.max(...values.flat(2))];
    const heat = beliefs.layer("heat");
    values[done].forEach((row, y) => row.forEach((value, x) => {
      heat.append(make("rect", { x: x * side, y: beliefs.height - (y + 1) * side, width: side + 0.5, height: side + 0.5,
        fill: colour((value - low) / (high - low || 1)) }));
    }));
    const marks = beliefs.layer("marks");
    const inside = (z) => [0, 1].map((axis) => Math.min(Math.max(z[axis] ?? 0, -edge), edge));
    found.played[at].slice(0, done).forEach((z, index) => {
      const [x, y] = beliefs.to(inside(z));
      marks.append(make("circle", { cx: x, cy: y, r: 9, class: index === done - 1 ? "played now" : "played" }));
      marks.append(beliefs.text(x, y, String(index + 1), { class: "number" }));
    });
    marks.append(beliefs.circle(inside(found.deployed[at][done]), 14, { class: "star" }));
    marks.append(beliefs.circle(inside(found.deployed[at][done]), 14, { class: "star inner" }));
    drawGoals(world, found.task[at]);
    const ways = world.layer("ways");
    found.paths[at].slice(0, done).forEach((path, index) => {
      ways.append(world.path(path, index === done - 1 ? "way now" : "way"));
      if (index === done - 1) ways.append(world.circle(path.at(-1), 5.5, { class: "end" }));
    });
    const [worst, best] = found.interval[at][done];
    const expects = ` The red one returns ${worst === best ? number(best) : `${number(worst)} to ${number(best)} (90 %)`}; ` +
      `the task is like one of training with probability ${number(100 * found.familiar[at][done])} %.`;
    const next = done < episodes ? ` Next it tries z = (${found.played[at][done].map((x) => number(x)).join(", ")}).` : "";
    said.textContent = done === 0 ? `Before any episode.${expects}${next}` :
      `Episode ${done} returns ${number(found.returns[at][done - 1])} and ` +
      `${found.reached[at][done - 1] ? "reaches" : "does not reach"} the goal.${expects}${next}`;
  }

  section("Watch a search",
    quiet("The map: what the search expects of each latent, from dark (low) to yellow (high). Numbers are the episodes so far, " +
      "the red ring is the latent that it would deploy. The plane: where these episodes went."),
    make("div", { class: "controls" }, make("label", {}, "Task", tasks), make("label", {}, "Show", kind),
      make("label", {}, "Episodes", slider), play),
    make("div", { class: "pair" }, beliefs.svg, world.svg), said);
  show();
}

// ---- charts and tables ------------------------------------------------------------------------

function chart(found) {
  if (found.title) return make("div", {}, make("h3", {}, found.title), chart({ ...found, title: "" }));
  const named = found.lines.filter((line) => line.dash).length;
  const box = make("div", { class: "chart", style: `height: ${296 + 34 * Math.ceil(named / 2)}px` });
  const shift = found.log ? 1 : 0; // a logarithmic axis has no place for 0
  redraws.push(() => {
    const traces = found.lines.flatMap((line) => {
      const common = { x: line.x.map((x) => x + shift), legendgroup: line.label };
      const edge = { ...common, mode: "lines", line: { width: 0 }, showlegend: false, hoverinfo: "skip" };
      const band = line.low && line.low.some((value) => value !== null) ?
        [{ ...edge, y: line.high }, { ...edge, y: line.low, fill: "tonexty", fillcolor: faint(line.colour) }] : [];
      const colour = visible(line.colour); // published curves are circles
      const look = line.dash ? { mode: "lines", line: { color: colour, dash: line.dash, width: 2.2 } } :
        { mode: "markers", marker: { color: colour, symbol: "circle-open", size: 6 }, showlegend: false };
      const hover = found.log ? { customdata: line.x, hovertemplate: `%{y}<br>${plain(found.x)}: %{customdata}` } : {};
      return [...band, { ...common, y: line.mean, name: plain(line.label), ...look, ...hover }];
    });
    const drawn = layout(found.x, found.y);
    if (found.log) {
      const ticks = [0, 1, 10, 100, 1000, 10000];
      Object.assign(drawn.xaxis, { type: "log", tickvals: ticks.map((x) => x + shift), ticktext: ticks });
      drawn.hovermode = "closest";
    }
    Plotly.react(box, traces, drawn, { responsive: true, displaylogo: false, displayModeBar: false });
  });
  return box;
}

function layout(x, y) {
  const axis = (title) => ({ title: { text: plain(title) }, gridcolor: css("--line"), zeroline: false, automargin: true });
  return {
    xaxis: axis(x), yaxis: axis(y), margin: { l: 60, r: 12, t: 28, b: 48 }, hovermode: "x unified",
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: css("--text"), size: 13 },
    hoverlabel: { bgcolor: css("--card"), font: { color: css("--text") } },
    legend: { orientation: "h", y: 1.02, yanchor: "bottom" },
  };
}

function plain(text) { return text.replace(/&/g, "&amp;").replace(/</g, "&lt;"); } // plotly reads some tags

function isDark() { return document.documentElement.dataset.theme === "dark"; }

function visible(hex) { // black and dark grey cannot be seen on a dark page
  const light = [1, 3, 5].reduce((sum, at) => sum + parseInt(hex.slice(at, at + 2), 16), 0) / 765;
  return isDark() && light < 0.3 ? "#d8d7d0" : hex;
}

function faint(hex) {
  const parts = [1, 3, 5].map((at) => parseInt(visible(hex).slice(at, at + 2), 16));
  return `rgba(${parts.join(",")},0.16)`;
}

function table(columns, rows, isDifferent = () => false) {
  const body = make("tbody");
  let order = null;
  function fill(sorted) {
    body.replaceChildren(...sorted.map((row) =>
      make("tr", isDifferent(row) ? { class: "differs" } : {}, ...row.map((cell) => make("td", {}, cell)))));
  }
  function sort(column) {
    const direction = order && order[0] === column ? -order[1] : 1;
    order = [column, direction];
    const key = (row) => { const value = parseFloat(row[column].replace(/,/g, "")); return Number.isNaN(value) ? row[column] : value; };
    fill([...rows].sort((a, b) => direction * (key(a) < key(b) ? -1 : key(a) > key(b) ? 1 : 0)));
    head.querySelectorAll("th").forEach((cell, index) =>
      cell.setAttribute("aria-sort", index !== column ? "none" : direction > 0 ? "ascending" : "descending"));
  }
  const head = make("tr", {}, ...columns.map((name, column) =>
    make("th", { scope: "col" }, make("button", { type: "button", onclick: () => sort(column) }, name))));
  fill(rows);
  return make("div", { class: "scroll" }, make("table", {}, make("thead", {}, head), body));
}

function details(title, content) { return make("details", {}, make("summary", {}, title), content); }

// ---- comparisons ------------------------------------------------------------------------------

function scatter(lines) {
  const box = make("div", { class: "chart" });
  const options = () => lines.map((line, index) => make("option", { value: index }, line.label));
  const [across, up] = [0, Math.min(1, lines.length - 1)].map((index, axis) => {
    const select = make("select", { class: axis ? "scatter-up" : "scatter-across", onchange: () => draw() }, ...options());
    select.value = index;
    return select;
  });
  function draw() {
    const [x, y] = [across, up].map((select) => lines[Number(select.value)]);
    const count = Math.min(x.returns.length, y.returns.length);
    const ends = [...x.returns.slice(0, count), ...y.returns.slice(0, count)];
    const [low, high] = [Math.min(...ends), Math.max(...ends)];
    Plotly.react(box, [
      { x: x.returns.slice(0, count), y: y.returns.slice(0, count), mode: "markers", showlegend: false,
        text: Array.from({ length: count }, (_, task) => `task ${task}`), marker: { color: css("--accent"), size: 7, opacity: 0.75 } },
      { x: [low, high], y: [low, high], mode: "lines", showlegend: false, hoverinfo: "skip", line: { color: css("--quiet"), dash: "dot", width: 1 } },
    ], { ...layout(x.label, y.label), hovermode: "closest" }, { responsive: true, displaylogo: false, displayModeBar: false });
  }
  redraws.push(draw);
  return [make("div", { class: "controls" }, make("label", {}, "Across", across), make("label", {}, "Up", up)), box];
}

function comparison(one) {
  const ends = [make("div", {}, make("h3", {}, "Performance profiles"), chart(one.profiles))];
  if (one.scatter.length > 1) {
    ends.push(make("div", {}, make("h3", {}, "Task by task: mean return of two lines"), ...scatter(one.scatter)));
  }
  section(one.name, quiet(one.about), make("div", { class: "many" }, ...one.charts.map(chart)),
    ...one.tables.flatMap((found) => [make("h3", {}, found.title), table(found.headings, found.rows), quiet(found.notes.join(" "))]),
    make("div", { class: "many" }, ...ends),
    details("Settings of each line; those that differ come first", settings(one.settings)));
}

function settings(found) { // first those that differ
  const differs = (row) => new Set(row.slice(1)).size > 1;
  const rows = [...found.rows.filter(differs), ...found.rows.filter((row) => !differs(row))];
  return table(found.columns, rows, differs);
}

// ---- runs -------------------------------------------------------------------------------------

function exploration(panels) {
  const paths = panels.flatMap((panel) => panel.paths);
  const planes = panels.map((panel) => {
    const plane = worldPlane(paths, panel.title);
    drawGoals(plane, null);
    const ways = plane.layer("ways");
    for (const path of panel.paths) ways.append(plane.path(path.filter((point) => point[0] !== null), "way"));
    for (const path of panel.paths) ways.append(plane.circle(path.at(-1), 2.5, { class: "end" }));
    return make("div", {}, make("h3", {}, panel.title), plane.svg);
  });
  section("Before any adaptation", quiet("Paths of episodes; dots are the goals of the test tasks."), make("div", { class: "many" }, ...planes));
}

// ---- the page ---------------------------------------------------------------------------------

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  redraws.forEach((redraw) => redraw());
}

document.title = data.title;
document.getElementById("title").textContent = data.title;
document.getElementById("subtitle").textContent = data.subtitle;
document.getElementById("theme").addEventListener("click", () => setTheme(isDark() ? "light" : "dark"));
if (data.plane) {
  explorer(data.plane.explorer);
  if (data.plane.explorer) searches(data.plane.search);
} else if (data.plane === null) section("Latent explorer", quiet(NO_PLANE));
data.comparisons.forEach(comparison);
if (!data.comparisons.length) section("Nothing compared yet", quiet("`maesn study run` goes on with a study, `maesn adapt DIR` tries a run in new tasks."));
if (data.learning?.length) section("Meta-training", make("div", { class: "many" }, ...data.learning.map(chart)));
if (data.plane) exploration(data.plane.panels);
section("Provenance", details("Versions and settings, or jobs with their digests", settings(data.provenance)));
setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
