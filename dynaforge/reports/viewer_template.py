"""The page of `dynaforge view`: a list with filters, a clip, plots that follow it; nothing from outside the file."""

from __future__ import annotations

from dynaforge.reports.template import HEAD, WIDE

VIEWER = (
    HEAD.replace("<main>", WIDE)
    + """<style>
.two { display:grid; grid-template-columns:minmax(260px,340px) 1fr; gap:16px; align-items:start; }
@media (max-width:800px) { .two { grid-template-columns:1fr; } }
.filters { display:flex; flex-wrap:wrap; gap:8px; margin:0 0 8px; }
select,input,button { font:inherit; color:inherit; background:var(--card); border:1px solid var(--line);
  border-radius:8px; padding:4px 8px; } input { flex:1; min-width:80px; }
#list { max-height:75vh; overflow:auto; padding:4px; }
#list button { display:block; width:100%; text-align:left; border:0; border-radius:8px; padding:6px 10px;
  cursor:pointer; }
#list button[aria-current=true] { outline:2px solid var(--accent); } #list small { color:var(--soft); }
.plots { display:grid; grid-template-columns:repeat(auto-fit,minmax(340px,1fr)); gap:12px; margin-top:16px; }
.plots svg { width:100%; height:auto; display:block; } .plots b { font-size:.9rem; }
svg text { fill:var(--soft); font-size:11px; }
.key { font-size:.8rem; color:var(--soft); }
.key i { display:inline-block; width:12px; height:3px; margin:0 4px 3px 10px; }
#clip { display:flex; flex-wrap:wrap; gap:16px; } #clip video { width:min(100%,400px); }
</style>
<h1>{{ title }}</h1>
<p class="soft">{{ task.motion }} {{ task.goal }} {{ n }} attempts; those shown come first.</p>
<div class="two">
<section aria-label="episodes">
<div class="filters">
<select id="outcome" aria-label="outcome"><option value="">all outcomes</option><option value="ok">successes</option>
<option value="bad">failures</option></select>
<select id="stratum" aria-label="difficulty"><option value="">all difficulties</option>
{% for k in range(strata) %}<option value="{{ k }}">bin {{ k + 1 }} of {{ strata }}</option>
{% endfor %}</select>
<input id="words" placeholder="reason or id" aria-label="reason or id">
</div>
<p class="soft" id="count"></p>
<div class="card" id="list"></div>
</section>
<section aria-label="episode" id="detail"></section>
</div>
</main>
<script>
"use strict";
const EPISODES = /*DATA*/null;
const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#000000"];
const get = id => document.getElementById(id);
const make = (tag, props = {}, ...inside) => {
  const node = Object.assign(document.createElement(tag), props);
  node.append(...inside);
  return node;
};
const draw = (tag, attributes, parent) => {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  parent.append(node);
  return node;
};
let current = null, cursors = [], video = null;

function visible(e) {
  const outcome = get("outcome").value, stratum = get("stratum").value, words = get("words").value.toLowerCase();
  return (!outcome || (outcome === "ok") === e.ok) && (stratum === "" || e.stratum === Number(stratum))
    && (!words || (e.id + " " + e.failure + " " + e.phase).toLowerCase().includes(words));
}

function list() {
  const shown = EPISODES.filter(visible);
  get("count").textContent = `${shown.length} of ${EPISODES.length} attempts, ` +
    `${shown.filter(e => e.ok).length} successes`;
  get("list").replaceChildren(...shown.slice(0, 1000).map(e => {
    const row = make("button", {onclick: () => show(e)},
      make("span", {className: e.ok ? "good" : "bad"}, e.ok ? "✓ success" : "✗ " + e.failure), make("br"),
      make("small", {}, `difficulty ${e.difficulty}, ${e.duration} s${e.time ? "" : ", not shown"}`));
    row.setAttribute("aria-current", e === current);
    return row;
  }));
}

function show(e) {
  current = e; cursors = []; video = null;
  const facts = make("dl");
  const told = {id: e.id, generator: e.generator, "ended in": e.phase, difficulty: e.difficulty,
    "planned contact": e.planned == null ? "–" : e.planned.toFixed(2) + " s",
    "first contact": e.contact == null ? "–" : e.contact.toFixed(2) + " s", ...(e.values || {})};
  for (const [name, value] of Object.entries(told)) facts.append(make("dt", {}, name), make("dd", {}, String(value)));
  for (const [name, path] of Object.entries(e.scenes || {}))
    facts.append(make("dt", {}, name), make("dd", {}, make("a", {href: path, target: "_blank"}, "open")));
  const top = make("div", {id: "clip", className: "card"});
  if (e.clip) {
    video = make("video", {src: "data:video/mp4;base64," + e.clip, controls: true, loop: true, muted: true,
      autoplay: true, playsInline: true});
    top.append(video);
  }
  top.append(facts);
  const plots = make("div", {className: "plots"});
  for (const plot of e.plots || []) plots.append(figure(e, plot));
  get("detail").replaceChildren(top, plots);
  list();
}

function figure(e, plot) {
  const W = 420, H = 190, L = 46, B = 22, T = 16, end = e.time[e.time.length - 1] || 1;
  const all = plot.lines.flat(), low = Math.min(...all), high = Math.max(...all), pad = (high - low || 1) * 0.05;
  const x = t => L + (W - L - 6) * t / end;
  const y = v => H - B - (H - B - T) * (v - low + pad) / (high - low + 2 * pad || 1);
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", `0 0 ${W} ${H}`);
  e.phases.forEach((phase, k) => {
    const to = k + 1 < e.phases.length ? e.phases[k + 1].from : end;
    draw("rect", {x: x(phase.from), y: T, width: Math.max(0, x(to) - x(phase.from)), height: H - B - T,
      fill: "var(--accent)", opacity: k % 2 ? 0.14 : 0.05}, svg);
    if (x(to) - x(phase.from) > 7 * phase.name.length)
      draw("text", {x: x(phase.from) + 3, y: T - 4}, svg).textContent = phase.name;
  });
  for (const value of [low, high]) draw("text", {x: 2, y: y(value) + 4}, svg).textContent = value.toPrecision(3);
  draw("text", {x: W - 40, y: H - 6}, svg).textContent = end.toFixed(1) + " s";
  plot.lines.forEach((line, k) => draw("polyline", {fill: "none", stroke: COLORS[k % 8], "stroke-width": 1.5,
    points: line.map((v, i) => `${x(e.time[i]).toFixed(1)},${y(v).toFixed(1)}`).join(" ")}, svg));
  for (const [time, dash] of [[e.planned, "5 4"], [e.contact, ""]])
    if (time != null) draw("line", {x1: x(time), x2: x(time), y1: T, y2: H - B, stroke: "var(--bad)",
      "stroke-dasharray": dash}, svg);
  const cursor = draw("line", {y1: T, y2: H - B, x1: L, x2: L, stroke: "var(--ink)", opacity: 0.6}, svg);
  cursors.push(t => { cursor.setAttribute("x1", x(t)); cursor.setAttribute("x2", x(t)); });
  svg.onclick = event => {
    const box = svg.getBoundingClientRect(), at = (event.clientX - box.left) / box.width * W;
    const t = Math.min(end, Math.max(0, (at - L) / (W - L - 6) * end));
    if (video) { video.pause(); video.currentTime = t; }
    cursors.forEach(move => move(t));
  };
  const key = make("div", {className: "key"});
  plot.labels.forEach((label, k) => key.append(make("i", {style: `background:${COLORS[k % 8]}`}), label));
  return make("div", {className: "card"}, make("b", {}, plot.title), svg, key);
}

function follow() {
  if (video && !video.paused) cursors.forEach(move => move(video.currentTime));
  requestAnimationFrame(follow);
}
for (const id of ["outcome", "stratum", "words"]) get(id).addEventListener("input", list);
list();
if (EPISODES.length && EPISODES[0].time) show(EPISODES[0]);
follow();
</script>
</body>
</html>
"""
)
