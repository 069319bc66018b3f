const data = JSON.parse(document.getElementById("data").textContent);
const main = document.getElementById("main");
const VIRIDIS = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"];
const PHONE = innerWidth < 720; // planes stand below one another

// ---- elements ---------------------------------------------------------------------------------

function text(x, y, words, attributes) { return make("text", { x, y, ...attributes }, words); }

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

function hue([x, y]) { // of a direction: cyclic, and equally light all around
  return `oklch(0.7 0.15 ${((Math.atan2(y, x) * 180) / Math.PI).toFixed(0)})`;
}

// ---- planes -----------------------------------------------------------------------------------

class Plane { // of some coordinates, drawn to scale between axes
  constructor(low, high, label, names, width = null) { // as wide as said, or of the height of those beside it
    const size = [0, 1].map((axis) => high[axis] - low[axis]);
    const wanted = [size[1] / 2, size[0] / 3]; // no plane is much longer than wide
    size.forEach((one, axis) => { size[axis] = Math.max(one, wanted[axis]); });
    this.low = [0, 1].map((axis) => (low[axis] + high[axis] - size[axis]) / 2);
    this.high = this.low.map((one, axis) => one + size[axis]);
    this.width = width ?? (PHONE ? 300 : (330 * size[0]) / size[1]);
    this.scale = this.width / size[0];
    this.height = this.scale * size[1];
    const whole = [this.width + MARGIN.left + MARGIN.right, this.height + MARGIN.top + MARGIN.bottom];
    this.svg = make("svg", { class: "plane", viewBox: [-MARGIN.left, -MARGIN.top, ...whole].join(" "),
      style: `flex-grow: ${whole[0] / whole[1]}`, role: "img", "aria-label": label });
    this.svg.append(make("rect", { width: this.width, height: this.height, class: "frame" }));
    this.layers = {};
    this.drawAxes(names);
  }
  drawAxes([across, up]) {
    const middle = { "text-anchor": "middle" };
    this.svg.append(
      ...ticks(this.low[0], this.high[0]).map((x) => text(this.to([x, 0])[0], this.height + 16, short(x), middle)),
      ...ticks(this.low[1], this.high[1]).map((y) => text(-7, this.to([0, y])[1] + 4, short(y), { "text-anchor": "end" })),
      text(this.width / 2, this.height + 34, across, middle),
      text(0, 0, up, { ...middle, transform: `translate(${12 - MARGIN.left} ${this.height / 2}) rotate(-90)` }));
  }
  layer(name) { // its content begins anew
    if (!this.layers[name]) this.svg.append((this.layers[name] = make("g")));
    this.layers[name].replaceChildren();
    return this.layers[name];
  }
  to([x, y]) {
    return [(x - this.low[0]) * this.scale, this.height - (y - this.low[1]) * this.scale];
  }
  from(event) {
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
    return [this.low[0] + point.x / this.scale, this.low[1] + (this.height - point.y) / this.scale];
  }
  circle(point, radius, attributes) {
    const [cx, cy] = this.to(point);
    return make("circle", { cx, cy, r: radius, ...attributes });
  }
  path(points, kind) {
    const corners = points.map((point) => this.to(point).map((value) => value.toFixed(1)).join(" "));
    return make("path", { d: `M${corners.join("L")}`, class: kind });
  }
  heat(values, [least, most], [low, high]) { // rows of numbers over a rectangle
    const layer = this.layer("heat");
    const [[left, bottom], [right, top]] = [this.to(low), this.to(high)];
    const [width, height] = [(right - left) / values[0].length, (bottom - top) / values.length];
    values.forEach((row, y) => row.forEach((value, x) => {
      layer.append(make("rect", { x: left + x * width, y: bottom - (y + 1) * height, width: width + 0.5, height: height + 0.5,
        fill: colour((value - least) / (most - least || 1)) }));
    }));
  }
}
const MARGIN = { left: 56, right: 8, top: 8, bottom: 42 };

function ticks(low, high) {
  const rough = (high - low) / 4;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((one) => one * power >= rough);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, index) => (first + index) * step);
}

function short(value) { return String(Number(value.toPrecision(6))).replace("-", "−"); }

function extremes(values) { // Math.min has no room for some hundred thousand arguments
  return values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
}

function box(points) { // their corners, and a margin
  const ends = [0, 1].map((axis) => extremes(points.map((point) => point[axis])));
  const margin = 0.04 * Math.max(...ends.map(([low, high]) => high - low));
  return [ends.map(([low]) => low - margin), ends.map(([, high]) => high + margin)];
}

function worldPlane(paths, label, width = null) {
  const { goals, radius } = data.plane;
  const corners = goals.flatMap(([x, y]) => [[x - radius, y - radius], [x + radius, y + radius]]);
  const points = corners.concat(paths.flat().filter((point) => point[0] !== null));
  return new Plane(...box(points), label, ["x (m)", "y (m)"], width);
}

function drawGoals(plane, chosen) { // all of them, or one with its region and objects
  const layer = plane.layer("goals");
  const { goals, radius, landmarks } = data.plane;
  if (chosen === null) {
    for (const goal of goals) layer.append(plane.circle(goal, 3, { fill: hue(goal) }));
    return;
  }
  for (const place of landmarks ? landmarks[chosen] : []) {
    const [x, y] = plane.to(place);
    layer.append(make("rect", { x: x - 5, y: y - 5, width: 10, height: 10, class: "object" }));
  }
  layer.append(plane.circle(goals[chosen], Math.max(radius * plane.scale, 4), { class: "region" }));
  layer.append(plane.circle(goals[chosen], 4.5, { class: "goal" }));
}

function distance(a, b) { return Math.hypot(...a.map((value, axis) => value - b[axis])); }

// Steps through moments: a slider, and a button that moves it.
function player(name, most, label, pause, show) {
  let timer = null;
  let isFresh = true; // nobody has moved it, so playing begins at the start
  const slider = make("input", { type: "range", id: `${name}-slider`, min: 0, max: most, step: 1, value: 0,
    oninput: () => { isFresh = false; show(); } });
  const button = make("button", { type: "button", id: `${name}-play`, onclick: toggle }, "Play");
  function toggle() {
    if (timer === null) {
      if (isFresh || Number(slider.value) === most) slider.value = 0;
      isFresh = false;
      timer = setInterval(() => {
        slider.value = Number(slider.value) + 1;
        show();
        if (Number(slider.value) === most) toggle();
      }, pause);
    } else {
      clearInterval(timer);
      timer = null;
    }
    button.textContent = timer === null ? "Play" : "Pause";
    show();
  }
  const open = (moment) => { slider.value = moment; show(); };
  return { controls: [make("label", {}, label, slider), button], now: () => Number(slider.value), open };
}

// ---- latent explorer --------------------------------------------------------------------------

function explorer(found) {
  const size = found.latents[0].length;
  const edge = extremes(found.latents.flat().map(Math.abs))[1];
  const latents = new Plane([-edge * 1.06, -edge * 1.06], [edge * 1.06, edge * 1.06], "Plane of latents", ["z₁", size > 1 ? "z₂" : ""]);
  const world = worldPlane(found.paths, "Where the chosen latent leads");
  const said = make("p", { class: "said", "aria-live": "polite", id: "explorer-said" });
  const z = Array(size).fill(0);
  let task = null;

  const dots = latents.layer("dots");
  found.latents.forEach((one, index) => {
    const fill = hue(found.paths[index].at(-1));
    dots.append(latents.circle([one[0], one[1] ?? 0], size > 2 ? 3 : 6, { fill, opacity: 0.5 }));
  });
  latents.svg.append(latents.circle([0, 0], latents.scale, { class: "prior" }));
  const rings = found.adapted.map((one, index) => {
    const stroke = hue(data.plane.goals[index]);
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
    quiet("Move the orange point: each latent z is one plan, and its colour is the direction in which that plan ends. The dashed " +
      "circle is the prior's standard deviation; rings are the latents of test tasks after adaptation, in the colours of their goals."),
    make("div", { class: "pair" }, latents.svg, world.svg), said,
    make("div", { class: "controls" }, make("label", {}, "Task", tasks), ...sliders.map(({ row }) => row)));
  show();
}

// ---- searches ---------------------------------------------------------------------------------

function searches(found) {
  if (!found) return section("Watch a search", quiet("There is no prior over returns yet: `maesn prior DIR` makes it, then report again."));
  const episodes = found.returns[0].length;
  const edge = found.edge;
  const corners = [[-edge, -edge], [edge, edge]];
  const beliefs = new Plane(...corners, "What the search believes of each latent", ["z₁", found.played[0][0].length > 1 ? "z₂" : ""]);
  const world = worldPlane(found.paths.flat(), "Where the search has been");
  const said = make("p", { class: "said", "aria-live": "polite", id: "search-said" });
  const tasks = make("select", { id: "search-task", onchange: () => begin() },
    ...found.task.map((task, index) => make("option", { value: index }, `task ${task}`)));
  const kind = make("select", { id: "search-kind", onchange: () => show() },
    make("option", { value: "mean" }, "expected return"), make("option", { value: "std" }, "uncertainty"));
  const steps = player("search", episodes, "Episodes", 900, () => show());

  function begin() { // with the first episode that finds the goal, else with the last
    steps.open((found.reached?.[Number(tasks.value)].indexOf(1) ?? -1) + 1 || episodes);
  }

  function show() {
    const at = Number(tasks.value);
    const done = steps.now();
    const values = found[kind.value][at];
    beliefs.heat(values[done], extremes(values.flat(2)), corners);
    const marks = beliefs.layer("marks");
    const inside = (z) => [0, 1].map((axis) => Math.min(Math.max(z[axis] ?? 0, -edge), edge));
    found.played[at].slice(0, done).forEach((z, index) => {
      const [x, y] = beliefs.to(inside(z));
      marks.append(make("circle", { cx: x, cy: y, r: 9, class: index === done - 1 ? "played now" : "played" }));
      marks.append(text(x, y, String(index + 1), { class: "number" }));
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
    const expects = ` With 90 % probability the latent in the red ring returns ` +
      `${worst === best ? number(best) : `${number(worst)} to ${number(best)}`}; the task is like one of training with probability ${number(100 * found.familiar[at][done])} %.`;
    const next = done < episodes ? ` Next it tries z = (${found.played[at][done].map((x) => number(x)).join(", ")}).` : "";
    const reached = found.reached ? ` and ${found.reached[at][done - 1] ? "reaches" : "does not reach"} the goal` : "";
    said.textContent = done === 0 ? `Before any episode.${expects}${next}` :
      `Episode ${done} returns ${number(found.returns[at][done - 1])}${reached}.${expects}${next}`;
  }

  section("Watch a search",
    quiet("The map: what the search expects of each latent, from dark (low) to yellow (high). Numbers are the episodes so far, " +
      "the red ring is the latent that it would deploy. The plane: where these episodes went."),
    make("div", { class: "controls" }, make("label", {}, "Task", tasks), make("label", {}, "Show", kind), ...steps.controls),
    make("div", { class: "pair" }, beliefs.svg, world.svg), said);
  beliefs.svg.id = "search-plane";
  begin();
}

// ---- beliefs ----------------------------------------------------------------------------------

function beliefOf(found) {
  const world = worldPlane(found.paths, "The rewards that the belief predicts");
  const said = make("p", { class: "said", "aria-live": "polite", id: "belief-said" });
  const duration = found.paths[0].length - 1;
  const steps = player("belief", found.step.length - 1, "Steps", 150, () => show());
  const all = extremes(found.predicted.flat(2));
  world.layer("heat"); // under the goal
  drawGoals(world, found.task);

  function show() {
    const moment = steps.now();
    const done = found.step[moment];
    world.heat(found.predicted[moment], all, found.corners);
    const ways = world.layer("ways");
    const episode = Math.max(Math.ceil(done / duration) - 1, 0); // the one under way
    found.paths.slice(0, episode + 1).forEach((path, index) => {
      const shown = index < episode ? path : path.slice(0, done - episode * duration + 1);
      ways.append(world.path(shown, index < episode ? "way" : "way now"));
      if (index === episode) ways.append(world.circle(shown.at(-1), 5.5, { class: "end" }));
    });
    const spread = found.std[moment].reduce((sum, one) => sum + one, 0) / found.std[moment].length;
    const [least, most] = extremes(found.predicted[moment].flat());
    said.textContent = `${done === 0 ? "Before any step" : `Step ${done - episode * duration} of episode ${episode + 1}`}: ` +
      `the belief predicts ${number(least, 2)} to ${number(most, 2)}, and its spread is ${number(spread, 2)}.`;
  }

  section(`The belief in test task ${found.task}`,
    quiet("The map: the reward, or the chance of one, that the belief predicts of each place, from dark (low) to yellow (high). " +
      "The lines: the belief after each step, its mean and around it its spread."),
    make("div", { class: "controls" }, ...steps.controls),
    make("div", { class: "pair" }, world.svg, make("div", { class: "beside" }, chart(found.chart))), said);
  steps.open(found.step.length - 1);
}

// ---- charts and tables ------------------------------------------------------------------------

function chart(found) { // as an image, an SVG can do nothing
  return make("img", { class: "chart", src: `data:image/svg+xml,${encodeURIComponent(found.svg)}`, alt: found.about });
}

function grid(items) { return make("div", { class: items.length % 2 ? "threes" : "twos" }, ...items); }

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
  const place = make("div");
  const [across, up] = [0, Math.min(1, lines.length - 1)].map((index, axis) => {
    const options = lines.map((line, value) => make("option", { value }, line.label));
    const select = make("select", { class: axis ? "scatter-up" : "scatter-across", onchange: () => draw() }, ...options);
    select.value = index;
    return select;
  });
  function draw() {
    const [x, y] = [across, up].map((select) => lines[Number(select.value)]);
    const points = x.returns.slice(0, y.returns.length).map((value, task) => [value, y.returns[task]]);
    const [low, high] = box(extremes(points.flat()).map((value) => [value, value]));
    const plane = new Plane(low, high, "Mean returns, task by task", [x.label, y.label], 330);
    plane.layer("same").append(plane.path([low, high], "prior"));
    const dots = plane.layer("dots");
    points.forEach((point, task) => {
      const dot = plane.circle(point, 4, { class: "dot" });
      dot.append(make("title", {}, `task ${task}: ${point.map((value) => number(value)).join(", ")}`));
      dots.append(dot);
    });
    place.replaceChildren(plane.svg);
  }
  draw();
  return make("div", { class: "narrow" },
    make("div", { class: "controls" }, make("label", {}, "Across", across), make("label", {}, "Up", up)), place);
}

function comparison(one) {
  const [first, ...others] = one.tables.map((found) =>
    make("div", {}, make("h3", {}, found.title), table(found.headings, found.rows), quiet(found.notes.join(" "))));
  const more = one.scatter.length > 1 ? [...others, scatter(one.scatter)] : others;
  section(one.name, quiet(one.about), first, grid(one.charts.map(chart)),
    details("Episode by episode, and method against method", make("div", {}, ...more)),
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
    const plane = worldPlane(paths, panel.title, 300);
    drawGoals(plane, null);
    const ways = plane.layer("ways");
    for (const path of panel.paths) ways.append(plane.path(path.filter((point) => point[0] !== null), "way"));
    for (const path of panel.paths) ways.append(plane.circle(path.at(-1), 2.5, { class: "end" }));
    return make("div", {}, make("h3", {}, panel.title), plane.svg);
  });
  section("Before any adaptation", quiet("Paths of episodes; coloured dots are the goals of the test tasks."), grid(planes));
}

// ---- the page ---------------------------------------------------------------------------------

function setTheme(isDark) { document.documentElement.dataset.theme = isDark ? "dark" : "light"; }

document.title = data.title;
document.getElementById("title").textContent = data.title;
document.getElementById("subtitle").textContent = data.subtitle;
document.getElementById("theme").addEventListener("click", () => setTheme(document.documentElement.dataset.theme !== "dark"));
main.append(make("div", { class: "headlines" }, ...data.headlines.map((one) =>
  make("div", {}, make("h3", {}, one.name), make("strong", {}, one.number), make("p", { class: "quiet" }, one.text.replace(/-(?=\d)/g, "−"))))));
if (data.plane?.explorer) {
  explorer(data.plane.explorer);
  searches(data.plane.search);
}
if (data.plane?.belief) beliefOf(data.plane.belief);
data.comparisons.forEach(comparison);
if (!data.comparisons.length) section("Nothing compared yet", quiet("`maesn study run` goes on with a study, `maesn adapt DIR` tries a run in new tasks."));
if (data.learning?.length) section("Meta-training", grid(data.learning.map(chart)));
if (data.plane) exploration(data.plane.panels);
section("Provenance", details("Versions and settings, or jobs with their digests", settings(data.provenance)));
setTheme(matchMedia("(prefers-color-scheme: dark)").matches);
