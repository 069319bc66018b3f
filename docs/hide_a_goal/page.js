const data = JSON.parse(document.getElementById("data").textContent);
const ATTEMPTS = data.uniforms.length;
const FIRST = 250, MOTION = 650, PAUSE = 150; // ms: before the first attempt, of an attempt, after it
const OUTLIER = 4, KNOWN = 1e-9, WIDER = 2, LEAST_NOISE = 1e-6, TINY = 2.2250738585072014e-308; // of maesn.runtime
const UNIT = 0.0005; // metres

// ---- the recordings ---------------------------------------------------------------------------

async function unpacked(text, size) { // an Int16Array or Float32Array; see `packed` of games.py
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = planes.length / size, joined = new Uint8Array(planes.length);
  for (let at = 0; at < planes.length; at++) joined[(at % count) * size + Math.floor(at / count)] = planes[at];
  return size === 2 ? new Int16Array(joined.buffer) : new Float32Array(joined.buffer);
}

async function decode(recording) {
  const twice = await unpacked(recording.tracks, 2), times = recording.shape[4];
  for (let start = 0; start < twice.length; start += times) {
    for (let speed = 0, place = 0, at = start; at < start + times; at++) twice[at] = place += speed += twice[at];
  }
  recording.places = twice;
}

function place(recording, latent, episode, track, time) { // metres
  const [, episodes, tracks, , times] = recording.shape;
  const at = ((latent * episodes + episode) * tracks + track) * 2 * times + time;
  return [recording.places[at] * UNIT, recording.places[at + times] * UNIT];
}

function judged(robot, recording, latent, episode, goal, track) { // the return, and when the goal was reached
  const norm = ([x, y]) => (robot.order === 1 ? Math.abs(x) + Math.abs(y) : Math.sqrt(x * x + y * y));
  const far = robot.bonus - robot.scale * norm(goal), steps = recording.steps[latent][episode];
  let total = 0, reached = null;
  for (let time = 1; time <= steps; time++) {
    const [x, y] = place(recording, latent, episode, track, time), way = [x - goal[0], y - goal[1]];
    const near = Math.sqrt(way[0] * way[0] + way[1] * way[1]) <= robot.radius;
    if (near) reached ??= time;
    total += near ? robot.bonus - robot.scale * norm(way) : far;
  }
  return { return: total + recording.free[latent][episode], reached, length: steps / robot.horizon };
}

// ---- the model of returns: maesn/runtime/return_model.py -----------------------------------------

const sum = (values) => values.reduce((total, value) => total + value, 0);
const mean = (values) => sum(values) / values.length;
const dot = (a, b) => a.reduce((total, value, at) => total + value * b[at], 0);
const column = (rows, j) => rows.map((row) => row[j]);

function matern(latents, lengthScale) {
  return latents.map((a) => latents.map((b) => {
    const scaled = (Math.sqrt(5) * Math.hypot(...a.map((x, axis) => x - b[axis]))) / lengthScale;
    return (1 + scaled + (scaled * scaled) / 3) * Math.exp(-scaled);
  }));
}

function solved(gram, sides) { // gram^-1 of each side, by a Cholesky decomposition
  const lower = gram.map(() => []);
  gram.forEach((row, i) => {
    for (let j = 0; j <= i; j++) {
      let rest = row[j];
      for (let k = 0; k < j; k++) rest -= lower[i][k] * lower[j][k];
      lower[i][j] = i === j ? Math.sqrt(rest) : rest / lower[j][j];
    }
  });
  return sides.map((side) => {
    const x = [...side];
    for (let i = 0; i < x.length; i++) {
      for (let k = 0; k < i; k++) x[i] -= lower[i][k] * x[k];
      x[i] /= lower[i][i];
    }
    for (let i = x.length - 1; i >= 0; i--) {
      for (let k = i + 1; k < x.length; k++) x[i] -= lower[k][i] * x[k];
      x[i] /= lower[i][i];
    }
    return x;
  });
}

function hypotheses(prior, latents, settings) { // familiar, shifted, unlike
  const { jump, offset_mean: offsetMean, offset_std: offsetStd } = prior;
  const average = mean(prior.excess.map(mean));
  const centred = prior.excess.map((row) => row.map((value) => value - average));
  const spread = mean(centred.map((row) => dot(row, row) / row.length));
  const noise = prior.noise.map((value) => Math.max(value / prior.episodes, LEAST_NOISE * spread));
  const signal = Math.max(spread - mean(noise) - jump, LEAST_NOISE * spread);
  const kernel = matern(latents, settings.length_scale);
  const gram = kernel.map((row, i) => row.map((value, j) => signal * value + (i === j ? noise[i] + jump : 0)));
  const means = solved(gram, centred).map((weights) => kernel.map((row) => average + signal * dot(row, weights)));
  const middle = latents.map((_, j) => mean(column(means, j)));
  const variance = mean(middle.map((m, j) => sum(column(means, j).map((x) => (x - m) ** 2)) / (means.length - 1)));
  const near = kernel.map((row) => dot(row, prior.noise) / sum(row));
  const all = prior.excess.flat(), widest = Math.max(...all) - Math.min(...all);
  const covariance = (values, scale) => values.map((row, i) => row.map((value, j) => scale * value + (i === j ? jump : 0)));
  const residual = covariance(kernel, settings.residual * variance), other = (1 - settings.familiar) / 2;
  const one = { means, noise: near, offsetMean, offsetStd, covariance: residual, probability: settings.familiar };
  const shifted = { ...one, offsetStd: Math.max(offsetStd, widest), probability: other };
  const wide = covariance(matern(latents, WIDER * settings.length_scale), variance);
  return [one, shifted, { ...shifted, means: [middle], covariance: wide }];
}

// ---- the search: maesn/runtime/posterior.py, hypotheses.py, search.py --------------------------------

function normalized(logs) {
  const highest = Math.max(...logs), weights = logs.map((log) => Math.exp(log - highest)), total = sum(weights);
  return weights.map((weight) => weight / total);
}

function start(model) { // the posterior under one hypothesis, before any reading
  return {
    model, mean: model.means.map((row) => [...row]), offset: model.means.map(() => model.offsetMean),
    variance: model.covariance.map((row, j) => row[j]), rows: [], offsetRows: [],
    evidence: model.means.map(() => 0), played: new Set(),
  };
}

function isKnown(part, j) {
  return part.played.has(j) && part.model.noise[j] <= KNOWN * part.model.covariance[j][j];
}

function condition(part, { point: j, return: value, length }) {
  const { model, rows, offsetRows } = part;
  const reading = rows.map((row, k) => row[j] + length * offsetRows[k]);
  const covariance = model.covariance[j].map((prior, p) => prior - dot(reading, column(rows, p)));
  const offset = length * model.offsetStd ** 2 - dot(reading, offsetRows);
  const std = Math.sqrt(Math.max(covariance[j] + length * offset + model.noise[j], 0));
  const errors = part.mean.map((row, task) => value - row[j] - length * part.offset[task]);
  const nearest = Math.min(...errors.map(Math.abs));
  const scale = isKnown(part, j) ? Infinity : Math.max(std, nearest / OUTLIER, TINY);
  const row = covariance.map((c) => c / scale), offsetRow = offset / scale;
  errors.forEach((error, task) => {
    const innovation = error / scale;
    row.forEach((r, p) => { part.mean[task][p] += innovation * r; });
    part.offset[task] += innovation * offsetRow;
    part.evidence[task] -= innovation ** 2 / 2 + (scale < Infinity ? Math.log(scale) : 0);
  });
  row.forEach((r, p) => { part.variance[p] -= r * r; });
  rows.push(row);
  offsetRows.push(offsetRow);
  part.played.add(j);
}

function moments(means, weights, within) { // mean and standard deviation of a mixture at each point
  const average = within.map((_, p) => dot(weights, column(means, p)));
  const std = within.map((v, p) => Math.sqrt(v + sum(weights.map((w, c) => w * (means[c][p] - average[p]) ** 2))));
  return { mean: average, std };
}

function beliefs(parts) {
  const weights = normalized(parts.flatMap((part) =>
    part.evidence.map((log) => log + Math.log(part.model.probability / part.mean.length))));
  const ends = parts.map((_, h) => sum(parts.slice(0, h + 1).map((part) => part.mean.length)));
  const shares = ends.map((end, h) => sum(weights.slice(h ? ends[h - 1] : 0, end)));
  const within = parts[0].variance.map((_, p) => dot(shares, parts.map((part) => Math.max(part.variance[p], 0))));
  return { weights, familiar: shares[0], ...moments(parts.flatMap((part) => part.mean), weights, within) };
}

function proposed(parts, weights, uniform, settings) {
  let component = 0, below = weights[0], hypothesis = 0;
  while (below <= uniform && component < weights.length - 1) below += weights[++component];
  while (component >= parts[hypothesis].mean.length) component -= parts[hypothesis++].mean.length;
  const part = parts[hypothesis], within = part.variance.map((v) => Math.max(v, 0));
  const { mean: average, std } = moments(part.mean, normalized(part.evidence), within);
  let best = 0, highest = -Infinity;
  average.forEach((m, j) => {
    const bound = isKnown(parts[0], j) ? -Infinity : m + settings.exploration * std[j];
    if (bound > highest) [best, highest] = [j, bound];
  });
  return best;
}

function transcript(robot, scene, goal, track) { // all attempts, as `transcript` of games.py
  const recording = robot.scenes[scene][0], latents = recording.latents;
  robot.model ??= hypotheses(robot.prior, latents, data.settings);
  const parts = robot.model.map(start), rows = [];
  let believed = beliefs(parts);
  for (let attempt = 0; attempt < ATTEMPTS; attempt++) {
    const point = proposed(parts, believed.weights, data.uniforms[attempt], data.settings);
    const episode = attempt % recording.shape[1];
    const played = { point, episode, ...judged(robot, recording, point, episode, goal, track) };
    parts.forEach((part) => condition(part, played));
    believed = beliefs(parts);
    rows.push({ ...played, ...believed });
  }
  return rows;
}

function drawn(robot, scene, goal, track, game) { // the same number of draws of N(0, I)
  const recording = robot.scenes[scene][1], [count, episodes] = recording.shape;
  return data.uniforms.map((_, attempt) => {
    const point = (data.stride * game + attempt) % count, episode = attempt % episodes;
    return { point, episode, ...judged(robot, recording, point, episode, goal, track) };
  });
}

// ---- what is drawn ------------------------------------------------------------------------------

const $ = (selector) => document.querySelector(selector);
const WIDTH = 600; // of a floor, in units of its drawing
const ROUND = { low: [-2.9, -0.8], high: [2.9, 2.9], hint: "Tap or click the floor to hide a goal." }, PUSH = { low: [-0.12, -0.6], high: [1.13, 0.6] };
const ABOUT = {
  wheeled: { title: "Wheeled robot", ...ROUND, goal: [1.75, 0.97], body: "M14 0 L-10 9 L-5 0 L-10 -9 Z" },
  blockpush: { title: "Block pushing", ...PUSH, goal: [0.85, -0.16], hint: "Tap or click a block to give it a hidden goal.",
    body: "M-9 0 a9 9 0 1 0 18 0 a9 9 0 1 0 -18 0" },
  ant: { title: "Ant", ...ROUND, goal: [-1.73, 1], body: "M-6 0 a6 6 0 1 0 12 0 a6 6 0 1 0 -12 0 M4 4 L15 15 M4 -4 L15 -15 M-4 4 L-15 15 M-4 -4 L-15 -15" },
};
const BLOCK = 0.03, GOAL_X = [0.75, 0.95], BAND = 0.2, LOWEST = -0.5; // metres; maesn/envs/blockpush.py
const NEAREST = 1, FARTHEST = 2.8; // metres, of a goal anywhere
const now = { robot: null, scene: 0, goal: null, track: 0, anywhere: false, game: 0, frame: 0 };

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const percent = (share) => `${Math.round(100 * share)}\u00a0%`;

class Lane { // a floor, and one circle per attempt
  constructor(section, which) {
    this.svg = section.querySelector("svg");
    this.pips = section.querySelector("ol");
    this.which = which; // 0: latents of the archive, 1: draws
  }
  begin(rows) {
    const { low, high } = view();
    this.rows = rows;
    this.low = low;
    this.scale = WIDTH / (high[0] - low[0]);
    this.height = this.scale * (high[1] - low[1]);
    this.recording = now.robot.scenes[now.scene][this.which];
    this.svg.setAttribute("viewBox", `0 0 ${WIDTH} ${this.height.toFixed(1)}`);
    this.layers = ["stage", "guesses", "ways", "things", "mark"].map(() => make("g", {}));
    this.svg.replaceChildren(...this.layers);
    this.ways = rows.map(() => make("path", { class: "way" }));
    this.layers[2].append(...this.ways);
    this.pips.replaceChildren(...rows.map((_, at) => make("li", {}, String(at + 1))));
    this.drawStage();
  }
  to([x, y]) { return [(x - this.low[0]) * this.scale, this.height - (y - this.low[1]) * this.scale]; }
  from(event) {
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
    return [this.low[0] + x / this.scale, this.low[1] + (this.height - y) / this.scale];
  }
  circle(at, radius, name) {
    const [cx, cy] = this.to(at);
    return make("circle", { cx, cy, r: radius * this.scale, class: name });
  }
  path(points) { return points.map((point, at) => (at ? "L" : "M") + this.to(point).map((x) => x.toFixed(1))).join(""); }
  drawStage() {
    const [stage, , , , mark] = this.layers, { goals, radius } = now.robot;
    if (isPushing()) {
      const [x, y] = this.to([GOAL_X[0], LOWEST + BAND * (bandOf(now.goal) + 1)]);
      stage.append(make("rect", { x, y, width: (GOAL_X[1] - GOAL_X[0]) * this.scale, height: BAND * this.scale, class: "band" }));
    } else {
      const arc = [...Array(61).keys()].map((at) => (Math.PI * at) / 60);
      const away = Math.hypot(...goals[0]);
      stage.append(make("path", { class: "arc", d: this.path(arc.map((a) => [away * Math.cos(a), away * Math.sin(a)])) }));
    }
    stage.append(this.circle(now.goal, radius, "region"), this.circle(now.goal, radius, "rim"));
    mark.append(this.circle(now.goal, radius / 12, "goal"));
  }
  guess(weights) { // the area of a dot is the probability of a training task's goal
    const { goals, radius } = now.robot, count = goals.length;
    const dots = goals.map((goal, at) => this.circle(goal, 0.45 * radius * Math.sqrt(weights[at] + weights[count + at]), "guess"));
    this.layers[1].replaceChildren(...dots);
  }
  show(attempt, share) {
    this.ways.forEach((way, at) => {
      const name = at === attempt ? "way now" : this.rows[at].reached ? "way reached" : "way";
      way.setAttribute("class", name);
      const steps = at < attempt ? 1 : at === attempt ? share : 0;
      if (way.shown === name + steps) return;
      way.shown = name + steps;
      way.setAttribute("d", steps ? this.track(at, name === "way reached" ? now.track : 0, steps) : "");
    });
    const { point, episode } = this.rows[attempt], times = this.recording.steps[point][episode];
    const time = Math.round(share * times), at = (t, track = 0) => place(this.recording, point, episode, track, t);
    const [here, before] = [at(time), at(Math.max(time - 5, 0))].map((one) => this.to(one));
    const angle = (Math.atan2(here[1] - before[1], here[0] - before[0]) * 180) / Math.PI;
    const body = make("path", { d: ABOUT[now.robot.name].body, class: "robot", transform: `translate(${here}) rotate(${angle})` });
    this.blocks = [...Array(this.recording.shape[2] - 1).keys()].map((block) => at(time, block + 1));
    const blocks = this.blocks.map((middle, block) => {
      const [x, y] = this.to(middle), half = BLOCK * this.scale;
      const name = block + 1 === now.track ? "block chosen" : "block";
      return make("rect", { x: x - half, y: y - half, width: 2 * half, height: 2 * half, rx: 3, class: name });
    });
    this.layers[3].replaceChildren(...blocks, body);
    [...this.pips.children].forEach((pip, index) => {
      const done = index < attempt || (index === attempt && share === 1);
      pip.className = done ? (this.rows[index].reached ? "reached" : "missed") : index === attempt ? "now" : "";
    });
  }
  track(attempt, track, share) {
    const { point, episode } = this.rows[attempt], last = Math.round(share * this.recording.steps[point][episode]);
    return this.path([...Array(last + 1).keys()].map((time) => place(this.recording, point, episode, track, time)));
  }
  hits(count) { return this.rows.slice(0, count).filter((row) => row.reached).length; }
}

const isPushing = () => now.robot.name === "blockpush";
const view = () => {
  const { low, high } = ABOUT[now.robot.name];
  return now.anywhere && !isPushing() ? { low: [low[0], -high[1]], high } : { low, high };
};
const bandOf = ([, y]) => clamp(Math.floor((y - LOWEST) / BAND + 1e-9), 0, 4);

function showBelief(believed, attempt) {
  const { rows, prior, lane } = now.played, known = [prior, ...rows].flatMap((one) => one.mean);
  const low = Math.min(...known), high = Math.max(...known);
  const played = new Set(rows.slice(0, attempt).map((row) => row.point)), last = rows[attempt - 1]?.point;
  const latents = lane.recording.latents, edge = 1.06 * Math.max(...latents.flat().map(Math.abs));
  const dots = latents.map(([x, y], at) => {
    const share = (believed.mean[at] - low) / (high - low), is = played.has(at);
    return make("circle", {
      cx: x, cy: -y, r: ((is ? 1.5 : 1) * edge) / 32, class: at === last ? "latent now" : is ? "latent played" : "latent",
      style: `fill: color-mix(in oklab, var(--accent) ${(100 * share).toFixed(1)}%, var(--low))`,
    });
  });
  dots.sort((a, b) => a.r.baseVal.value - b.r.baseVal.value);
  $("#latents").setAttribute("viewBox", [-edge, -edge, 2 * edge, 2 * edge].join(" "));
  $("#latents").replaceChildren(...dots);
  const isLost = believed.familiar < 0.5;
  $("#familiar").className = isLost ? "lost" : "";
  $("#familiar").textContent = `The goal is like those of training with probability ${percent(believed.familiar)}`
    + (isLost ? ". The search has noticed, and relies less on what it learned." : ".");
  lane.guess(believed.weights);
}

function said(lane, count) { // after so many attempts
  const first = lane.rows.findIndex((row) => row.reached), isFound = first >= 0 && first < count;
  const open = count < ATTEMPTS ? `Attempt ${count + 1} …` : `Not found in ${ATTEMPTS} attempts.`;
  const hits = count ? `At the goal in ${lane.hits(count)} of ${count} attempts.` : "";
  return { found: isFound ? `Found in attempt ${first + 1}.` : open, hits };
}

function say(count) {
  const [search, draws] = lanes.map((lane) => said(lane, count));
  $("#said").replaceChildren(search.found, make("small", {}, search.hits));
  $("#drawn").textContent = draws.hits;
}

function show(attempt, share) {
  lanes.forEach((lane) => lane.show(attempt, share));
  const count = attempt + (share === 1);
  if (count === now.counted) return;
  now.counted = count;
  showBelief(count ? now.played.rows[count - 1] : now.played.prior, count);
  say(count);
}

function play() {
  cancelAnimationFrame(now.frame);
  const { robot, scene, goal, track } = now, rows = transcript(robot, scene, goal, track);
  lanes[0].begin(rows);
  lanes[1].begin(drawn(robot, scene, goal, track, now.game++));
  now.played = { rows, prior: beliefs(robot.model.map(start)), lane: lanes[0] };
  now.counted = -1;
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) return show(ATTEMPTS - 1, 1);
  const began = performance.now() + FIRST;
  const step = (time) => {
    const elapsed = Math.max(time - began, 0), attempt = Math.min(Math.floor(elapsed / (MOTION + PAUSE)), ATTEMPTS - 1);
    const share = Math.min((elapsed - attempt * (MOTION + PAUSE)) / MOTION, 1);
    show(attempt, share);
    if (attempt < ATTEMPTS - 1 || share < 1) now.frame = requestAnimationFrame(step);
  };
  step(began);
}

// ---- what the visitor does ----------------------------------------------------------------------

const startOf = (track) => place(now.robot.scenes[now.scene][0], 0, 0, track, 0); // of a block

function hide([x, y]) { // a goal at the nearest place where one may be
  if (isPushing()) {
    const band = bandOf([x, y]);
    const bands = [1, 2, 3, 4, 5].map((track) => bandOf(startOf(track)));
    now.track = bands.indexOf(band) + 1;
    now.goal = [clamp(x, ...GOAL_X), clamp(y, LOWEST, LOWEST + 5 * BAND)];
  } else {
    const away = Math.hypot(x, y) || 1, half = Math.hypot(...now.robot.goals[0]);
    const [dx, dy] = now.anywhere ? [x / away, y / away] : y < 0 ? [Math.sign(x) || 1, 0] : [x / away, y / away];
    const radius = now.anywhere ? clamp(away, NEAREST, FARTHEST) : half;
    now.goal = [radius * dx, radius * dy];
    now.track = 0;
  }
  play();
}

async function choose(robot, scene = 0) {
  if (typeof robot.prior.excess === "string") await open(robot);
  Object.assign(now, { robot, scene, anywhere: false });
  const index = data.robots.indexOf(robot);
  [...$("#tabs").children].forEach((tab, at) => tab.setAttribute("aria-selected", at === index));
  const layouts = robot.scenes.map((_, at) => make("button", {
    "aria-pressed": at === scene, onclick: () => choose(robot, at),
  }, `Layout ${at + 1}`));
  const box = make("input", { type: "checkbox", id: "anywhere", onchange: () => { now.anywhere = box.checked; hide(now.goal); } });
  const anywhere = make("label", {}, box, "anywhere, also where it was never trained");
  $("#options").replaceChildren(...(layouts.length > 1 ? layouts : [anywhere]));
  const { search, draws } = data.shares[index];
  $("#shares").textContent = `Of 100 goals, search finds ${percent(search.found)} by attempt 5, chance ${percent(draws.found)}. `
    + `In attempts 6 to 10 search is at the goal in ${percent(search.later)} of attempts, chance in ${percent(draws.later)}.`;
  $("#hint").textContent = ABOUT[robot.name].hint;
  $("#count").textContent = robot.scenes[0][0].latents.length;
  hide(ABOUT[robot.name].goal);
}

async function open(robot) {
  await Promise.all(robot.scenes.flat().map(decode));
  const flat = await unpacked(robot.prior.excess, 4), count = robot.prior.noise.length;
  robot.prior.excess = robot.goals.map((_, task) => [...flat.subarray(task * count, (task + 1) * count)]);
}

const lanes = [new Lane($("#search"), 0), new Lane($("#draws"), 1)];
$("#tabs").append(...data.robots.map((robot) => make("button", { role: "tab", onclick: () => choose(robot) }, ABOUT[robot.name].title)));
lanes[0].svg.addEventListener("click", (event) => {
  const at = lanes[0].from(event), hit = lanes[0].blocks.findIndex(([x, y]) => Math.hypot(x - at[0], y - at[1]) < 2 * BLOCK);
  hide(hit < 0 ? at : startOf(hit + 1));
});
lanes[0].svg.addEventListener("keydown", (event) => {
  const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
  if (!way) return;
  event.preventDefault();
  hide(now.goal.map((x, axis) => x + 0.25 * now.robot.radius * way[axis]));
});
choose(data.robots[0]).then(() => { document.body.dataset.ready = "yes"; });
