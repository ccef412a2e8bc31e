"""The script of the page of `dynaforge view`: addresses, list, films. All text is inserted as text, never as HTML."""

from __future__ import annotations

from dynaforge.reports.viewer_charts import CHARTS

SCRIPT = (
    r"""
const MOST = 1000; // rows of the list
const get = id => document.getElementById(id);
const make = (tag, props = {}, ...inside) => {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(props))
    if (name in node) node[name] = value; else node.setAttribute(name, value);
  node.append(...inside);
  return node;
};
const draw = (tag, attributes, parent) => {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  parent.append(node);
  return node;
};
const BY_ID = new Map(EPISODES.map(e => [e.id, e]));
const narrow = matchMedia("(max-width:800px)"), still = matchMedia("(prefers-reduced-motion:reduce)");
const outcome = e => e.ok ? "✓ success" : "✗ " + e.failure;
const with_unit = (value, unit) => unit ? `${value} ${unit}` : String(value);
const prose = text => text.split("`").map((part, k) => k % 2 ? make("code", {}, part) : part);
const rows = new Map();
let current = null, listed = [], cursors = [], video = null, url = "", camera = "clip";

// ---- addresses: #episode=ID and #summary, so that reload, back and forward work

const address = e => "#episode=" + encodeURIComponent(e.id);
function go(hash) {
  location.hash = hash;
  route(); // at once: the event comes later, and a key may be pressed again before
}
function requested() {
  const text = location.hash.startsWith("#episode=") ? location.hash.slice(9) : "";
  try { return decodeURIComponent(text); } catch { return text; }
}
function route() {
  const summary = location.hash === "#summary", id = requested();
  for (const name of ["episodes", "summary"]) {
    const on = summary === (name === "summary"), tab = get("tab-" + name);
    get("panel-" + name).hidden = !on;
    tab.setAttribute("aria-selected", on);
    tab.tabIndex = on ? 0 : -1;
  }
  if (summary) {
    if (video) video.pause();
    document.title = "Summary · " + PAGE.title;
    return;
  }
  if (id && !BY_ID.has(id)) show_nothing(`This page contains no episode ${id}.`);
  else show(id ? BY_ID.get(id) : current && listed.includes(current) ? current : listed[0]);
  if (id && narrow.matches) get("bar").scrollIntoView({block: "start"});
}

// ---- the list

function fits(e) {
  const kind = get("outcome").value, stratum = get("stratum").value, generator = get("generator");
  const words = get("words").value.trim().toLowerCase();
  return (!kind || (kind === "shown" ? !!e.time : (kind === "ok") === e.ok))
    && (stratum === "" || e.stratum === Number(stratum)) && (!generator?.value || e.generator === generator.value)
    && (!words || `${e.id} ${e.failure} ${e.phase}`.toLowerCase().includes(words));
}
function row(e) {
  if (!rows.has(e)) {
    const details = `difficulty ${with_unit(e.difficulty, PAGE.unit)}, ${e.duration} s` +
      (e.time ? "" : ", not shown");
    const button = make("button", {onclick: () => choose(e)},
      make("span", {className: e.ok ? "good" : "bad"}, outcome(e)), make("small", {}, details));
    rows.set(e, make("li", {}, button));
  }
  return rows.get(e);
}
const button_of = e => rows.get(e)?.firstChild;
function list() {
  listed = EPISODES.filter(fits);
  get("count").textContent = `${listed.length} of ${EPISODES.length} attempts, ` +
    `${listed.filter(e => e.ok).length} successes`;
  const items = listed.slice(0, MOST).map(row);
  if (listed.length > MOST) items.push(make("li", {className: "empty"},
    `${listed.length - MOST} more; filter to see them.`));
  if (!EPISODES.length) items.push(make("li", {className: "empty"},
    "The folder contains no attempts yet. ", make("code", {}, `dynaforge collect --task ${PAGE.task} --out FOLDER`),
    " makes some."));
  else if (!listed.length) items.push(make("li", {className: "empty"}, "No attempt fits these filters.", make("br"),
    make("button", {onclick: () => { filter({}); get("words").focus(); }}, "Clear the filters")));
  get("list").replaceChildren(...items);
  mark();
}
function mark() {
  const reached = listed.includes(current) ? current : listed[0]; // the one row that Tab stops at
  for (const e of listed.slice(0, MOST)) {
    button_of(e).setAttribute("aria-current", e === current);
    button_of(e).tabIndex = e === reached ? 0 : -1;
  }
  const at = listed.indexOf(current);
  get("place").textContent = at < 0 ? "" : `${at + 1} of ${listed.length}`;
  get("previous").setAttribute("aria-disabled", at === 0 || !listed.length);
  get("next").setAttribute("aria-disabled", at === listed.length - 1);
  const button = button_of(current), box = get("list");
  if (at >= 0 && button?.isConnected) { // never by scrollIntoView, which would move the page too
    const top = button.offsetTop - box.offsetTop;
    if (top < box.scrollTop) box.scrollTop = top - 8;
    else if (top + button.offsetHeight > box.scrollTop + box.clientHeight)
      box.scrollTop = top + button.offsetHeight - box.clientHeight + 8;
  }
}
function filter(values) {
  for (const name of ["outcome", "stratum", "generator", "words"]) if (get(name)) get(name).value = values[name] ?? "";
  list();
}
function choose(e) {
  go(address(e));
  if (narrow.matches) get("heading").focus({preventScroll: true}); // the list is out of sight then
}
function step(by) {
  const at = listed.indexOf(current), to = at < 0 ? (listed.length ? 0 : -1) : at + by;
  if (to < 0 || to >= listed.length) return;
  const in_list = get("list").contains(document.activeElement);
  go(address(listed[to]));
  if (in_list) button_of(listed[to])?.focus({preventScroll: true});
}
get("list").addEventListener("keydown", event => {
  const buttons = [...get("list").querySelectorAll("button")], at = buttons.indexOf(document.activeElement);
  const to = {ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: buttons.length - 1}[event.key];
  if (to === undefined) return;
  event.preventDefault();
  buttons[to]?.focus();
});

// ---- one episode

function show_nothing(text) {
  current = null; cursors = []; video = null;
  document.title = PAGE.title;
  get("heading").textContent = EPISODES.length ? "No episode" : "No attempts yet";
  get("content").replaceChildren(make("p", {className: "note"}, text));
  mark();
}
function show(e) {
  if (!e) return show_nothing(EPISODES.length ? "Clear the filters to see one." : "There is nothing to show.");
  if (e === current) return mark();
  const focused = get("content").contains(document.activeElement) && (document.activeElement.dataset.keep || "heading");
  current = e; cursors = []; video = null;
  document.title = `${outcome(e)}, ${with_unit(e.difficulty, PAGE.unit)} · ${PAGE.title}`;
  get("heading").replaceChildren(make("span", {className: e.ok ? "good" : "bad"}, outcome(e)),
    ` at ${with_unit(e.difficulty, PAGE.unit)}`);
  const parts = [];
  if (e.note) parts.push(make("p", {className: "note"}, ...prose(e.note)));
  const top = make("div", {id: "clip", className: "card"}), player = films(e);
  if (player) top.append(player);
  top.append(facts(e));
  parts.push(top);
  if (e.plots) parts.push(make("div", {className: "plots"}, ...e.plots.map(plot => figure(e, plot))));
  get("content").replaceChildren(...parts);
  const same = focused && get("content").querySelector(`[data-keep="${CSS.escape(focused)}"]`);
  if (focused) (same || get("heading")).focus({preventScroll: true});
  mark();
}
function facts(e) {
  const seconds = time => time == null ? "–" : time.toFixed(2) + " s";
  const entries = [["id", e.id], ["generator", e.generator], ["ended in phase", e.phase || "–"],
    ["checkpoints", `${e.checkpoint} of ${PAGE.phases}`], ["length", seconds(e.duration)],
    ["difficulty", with_unit(e.difficulty, PAGE.unit)]];
  if (e.time) entries.push(["planned contact", seconds(e.planned)], ["first contact", seconds(e.contact)]);
  for (const [name, value, unit] of e.values) entries.push([name, with_unit(value, unit)]);
  const listing = make("dl", {className: "facts"});
  for (const [name, value] of entries) listing.append(make("div", {}, make("dt", {}, name), make("dd", {}, value)));
  for (const [name, path] of Object.entries(e.scenes || {})) listing.append(make("div", {}, make("dt", {}, name),
    make("dd", {}, make("a", {href: path, target: "_blank", rel: "noopener"}, "open"))));
  return listing;
}
function films(e) {
  const all = [...(e.clip ? [["clip", e.clip]] : []), ...(e.views || [])];
  if (!all.length) return null;
  const chosen = Math.max(0, all.findIndex(([name]) => name === camera));
  video = make("video", {controls: true, loop: true, muted: true, playsInline: true, autoplay: !still.matches,
    "aria-label": "film of the episode", "data-keep": "film"});
  load(all[chosen][1]);
  const box = make("div");
  if (all.length > 1) box.append(tabs(all, chosen));
  box.append(video);
  return box;
}
function tabs(all, chosen) {
  const bar = make("div", {role: "tablist", "aria-label": "camera"});
  const buttons = all.map(([name, film], k) => make("button", {role: "tab", "aria-selected": k === chosen,
    tabIndex: k === chosen ? 0 : -1, "data-keep": "camera " + name, onclick: () => take(k)}, name));
  function take(k) {
    const time = video.currentTime, paused = video.paused;
    camera = all[k][0];
    buttons.forEach((button, i) => {
      button.setAttribute("aria-selected", i === k);
      button.tabIndex = i === k ? 0 : -1;
    });
    video.autoplay = !paused;
    load(all[k][1]);
    video.currentTime = time;
  }
  bar.append(...buttons);
  return bar;
}
function load(film) { // as a blob: Safari plays no data URL
  if (url) URL.revokeObjectURL(url);
  url = URL.createObjectURL(new Blob([Uint8Array.from(atob(film), c => c.charCodeAt(0))], {type: "video/mp4"}));
  video.src = url;
}
"""
    + CHARTS
    + r"""
// ---- keys and the rest

document.addEventListener("keydown", event => { // arrows move within any row of tabs
  const bar = event.target.closest('[role="tablist"]');
  if (!bar || !["ArrowLeft", "ArrowRight"].includes(event.key)) return;
  const buttons = [...bar.children], by = event.key === "ArrowRight" ? 1 : -1;
  const to = buttons[(buttons.indexOf(event.target) + by + buttons.length) % buttons.length];
  event.preventDefault();
  to.click();
  to.focus();
});
const seek = time => {
  if (!video) return;
  video.pause();
  video.currentTime = Math.min(Math.max(time, 0), video.duration || 0);
  cursors.forEach(move => move(video.currentTime));
};
const KEYS = {
  n: () => step(1), p: () => step(-1), e: () => go(current ? address(current) : "#"), s: () => go("#summary"),
  k: () => video && (video.paused ? video.play() : video.pause()),
  ",": () => seek(video?.currentTime - PAGE.picture), ".": () => seek(video?.currentTime + PAGE.picture),
  "/": () => { if (location.hash === "#summary") KEYS.e(); route(); get("words").focus(); },
};
document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select, textarea")) return;
  const action = Object.hasOwn(KEYS, event.key) && KEYS[event.key];
  if (!action || (get("panel-episodes").hidden && !"es/".includes(event.key))) return;
  event.preventDefault();
  action();
});
get("next").onclick = () => step(1);
get("previous").onclick = () => step(-1);
get("toList").onclick = () => {
  get("panel-episodes").scrollIntoView({block: "start"});
  (button_of(current)?.isConnected ? button_of(current) : get("words")).focus({preventScroll: true});
};
get("tab-episodes").onclick = KEYS.e;
get("tab-summary").onclick = KEYS.s;
for (const name of ["outcome", "stratum", "generator", "words"]) get(name)?.addEventListener("input", list);
function follow() {
  if (video && !video.paused) cursors.forEach(move => move(video.currentTime));
  requestAnimationFrame(follow);
}
list();
summary();
addEventListener("hashchange", route);
route();
follow();
"""
)
