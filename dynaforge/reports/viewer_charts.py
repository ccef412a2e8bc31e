"""The drawings of the page of `dynaforge view`: plots that follow the film, and the charts of the summary."""

from __future__ import annotations

CHARTS = r"""
// ---- plots of an episode

const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f"];
const svg_of = (width, height, label) => {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", label);
  return svg;
};
function figure(e, plot) {
  const W = 420, H = 190, L = 46, B = 22, T = 16, end = e.time[e.time.length - 1] || 1;
  const all = plot.lines.flat(), low = all.reduce((a, b) => Math.min(a, b), Infinity);
  const high = all.reduce((a, b) => Math.max(a, b), -Infinity), pad = (high - low || 1) * 0.05;
  const x = t => L + (W - L - 6) * t / end;
  const y = v => H - B - (H - B - T) * (v - low + pad) / (high - low + 2 * pad || 1);
  const svg = svg_of(W, H, `${plot.title}, from ${low.toPrecision(3)} to ${high.toPrecision(3)}, over time`);
  e.phases.forEach((phase, k) => {
    const to = k + 1 < e.phases.length ? e.phases[k + 1].from : end;
    draw("rect", {x: x(phase.from), y: T, width: Math.max(0, x(to) - x(phase.from)), height: H - B - T,
      fill: "var(--accent)", opacity: k % 2 ? 0.14 : 0.05}, svg);
    if (x(to) - x(phase.from) > 7 * phase.name.length)
      draw("text", {x: x(phase.from) + 3, y: T - 4}, svg).textContent = phase.name;
  });
  for (const value of high > low ? [low, high] : [low])
    draw("text", {x: L - 5, y: y(value) + 4, "text-anchor": "end"}, svg).textContent = value.toPrecision(3);
  draw("text", {x: L, y: H - 6}, svg).textContent = "0 s";
  draw("text", {x: W - 6, y: H - 6, "text-anchor": "end"}, svg).textContent = end.toFixed(1) + " s";
  plot.lines.forEach((line, k) => draw("polyline", {fill: "none", stroke: COLORS[k % COLORS.length],
    "stroke-width": 1.5, points: line.map((v, i) => `${x(e.time[i]).toFixed(1)},${y(v).toFixed(1)}`).join(" ")}, svg));
  for (const [time, dash] of [[e.planned, "5 4"], [e.contact, "none"]])
    if (time != null) draw("line", {x1: x(time), x2: x(time), y1: T, y2: H - B, stroke: "var(--bad)",
      "stroke-dasharray": dash}, svg);
  const cursor = draw("line", {y1: T, y2: H - B, x1: L, x2: L, stroke: "var(--ink)", opacity: 0.6}, svg);
  cursors.push(t => { const at = x(Math.min(t, end)); cursor.setAttribute("x1", at); cursor.setAttribute("x2", at); });
  svg.onclick = event => {
    const box = svg.getBoundingClientRect(), at = (event.clientX - box.left) / box.width * W;
    const t = Math.min(end, Math.max(0, (at - L) / (W - L - 6) * end));
    seek(t);
    cursors.forEach(move => move(t));
  };
  const key = make("div", {className: "key"});
  plot.labels.forEach((label, k) => key.append(make("i", {style: `background:${COLORS[k % COLORS.length]}`}), label));
  return make("div", {className: "card"}, make("b", {}, plot.title), svg, key);
}

// ---- the summary

const percent = share => (100 * share).toFixed(share === 0 || share === 1 ? 0 : 1) + " %";
const card = (title, ...inside) => make("section", {className: "card"}, make("h2", {}, title), ...inside);
const word = text => make("p", {className: "soft"}, text);

const width = () => narrow.matches ? 360 : 520; // so that letters keep their size
function success_by_difficulty(bins) {
  const W = width(), H = 220, L = 40, T = 18, B = 32, step = (W - L - 8) / bins.length;
  const y = v => H - B - (H - B - T) * v;
  const text = bins.map(([name, n, successes]) => `${name}: ${successes} of ${n}`).join("; ");
  const svg = svg_of(W, H, "success by difficulty: " + text);
  for (const v of [0, 0.5, 1]) {
    draw("line", {x1: L, x2: W - 8, y1: y(v), y2: y(v), stroke: "var(--line)"}, svg);
    draw("text", {x: L - 5, y: y(v) + 4, "text-anchor": "end"}, svg).textContent = 100 * v + " %";
  }
  bins.forEach(([name, n, successes, low, high], k) => {
    const middle = L + (k + 0.5) * step, put = (at, text) =>
      draw("text", {x: middle, y: at, "text-anchor": "middle"}, svg).textContent = text;
    put(H - B + 15, name.split(" to ")[0]);
    put(H - B + 28, n ? `${successes}/${n}` : "none");
    if (!n) return;
    const top = y(successes / n);
    const bar = draw("rect", {x: middle - step * 0.36, width: step * 0.72, y: top, height: y(0) - top,
      fill: "var(--accent)", opacity: 0.85}, svg);
    draw("title", {}, bar).textContent = `${name}: ${successes} of ${n}`;
    draw("line", {x1: middle, x2: middle, y1: y(low), y2: y(high), stroke: "var(--ink)", "stroke-width": 1.3}, svg);
  });
  return svg;
}
function lengths(all) {
  const W = width(), H = 220, L = 40, T = 18, B = 20;
  const most = Math.max(1, ...all.successes.map((n, k) => n + all.failures[k]));
  const step = (W - L - 8) / all.successes.length, y = n => H - B - (H - B - T) * n / most;
  const svg = svg_of(W, H, `lengths of attempts, from 0 to ${all.longest} s`);
  for (const n of [0, most]) draw("text", {x: L - 5, y: y(n) + 4, "text-anchor": "end"}, svg).textContent = n;
  draw("line", {x1: L, x2: W - 8, y1: y(0), y2: y(0), stroke: "var(--line)"}, svg);
  all.successes.forEach((n, k) => {
    const both = n + all.failures[k], box = {x: L + (k + 0.08) * step, width: step * 0.84};
    draw("rect", {...box, y: y(n), height: y(0) - y(n), fill: "var(--good)"}, svg);
    draw("rect", {...box, y: y(both), height: y(n) - y(both), fill: "var(--bad)"}, svg);
  });
  for (const share of [0, 0.5, 1]) draw("text", {x: L + (W - L - 8) * share, y: H - B + 16,
    "text-anchor": ["start", "middle", "end"][2 * share]}, svg).textContent = (all.longest * share).toFixed(1) + " s";
  return svg;
}
function reasons(failures) {
  const most = failures[0][1];
  return failures.map(([reason, n]) => make("button", {className: "reason", title: "show these",
    onclick: () => {
      filter({outcome: "bad", words: reason});
      current = null;
      go(listed.length ? address(listed[0]) : "#");
      get("heading").focus({preventScroll: true});
    }}, make("span", {}, reason), make("i", {style: `width:${100 * n / most}%`}), make("b", {}, n)));
}
function summary() {
  const {bins, lengths: spans, failures, generators} = PAGE.summary;
  if (!EPISODES.length) return get("panel-summary").append(card("Success by difficulty", word("No attempts yet.")),
    card("Lengths", word("No attempts yet.")), card("Why attempts failed", word("No attempts yet.")));
  const key = make("div", {className: "key"}, make("i", {style: "background:var(--good)"}), "successes",
    make("i", {style: "background:var(--bad)"}), "failures");
  const table = make("table", {}, make("tr", {}, ...["generator", "successes", "rate", "95 %"]
    .map(name => make("th", {}, name))));
  for (const [name, n, successes, low, high] of generators) table.append(make("tr", {}, ...[name,
    `${successes} of ${n}`, percent(successes / n), `${percent(low)} – ${percent(high)}`]
    .map(text => make("td", {}, text))));
  const measured = spans.successes.concat(spans.failures).some(n => n);
  const rate = card("Success", make("div", {className: "scroll"}, table));
  const why = card("Why attempts failed", ...(failures.length ? reasons(failures) : [word("No failures.")]));
  rate.classList.add("wide");
  why.classList.add("wide");
  const unit = PAGE.unit && ` (${PAGE.unit})`;
  get("panel-summary").append(rate, card("Success by difficulty", success_by_difficulty(bins),
    word(`Below a bar: where its part of the range begins${unit}, successes of attempts. Lines: Wilson's 95 %.`)),
    card("Lengths", ...(measured ? [lengths(spans), key] : [word("No attempt got far enough to have one.")])), why);
}
"""
