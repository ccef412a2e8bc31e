"""The page of `dynaforge view`: a list with filters, films, plots that follow, a summary; nothing from outside."""

from __future__ import annotations

from dynaforge.reports.template import HEAD, WIDE
from dynaforge.reports.viewer_script import SCRIPT

VIEWER_STYLE = """
.two { display:grid; grid-template-columns:minmax(260px,340px) minmax(0,1fr); gap:16px; align-items:start; }
.side { position:sticky; top:16px; }
[hidden] { display:none !important; }
select,input,button { font:inherit; color:inherit; background:var(--card); border:1px solid var(--line);
  border-radius:8px; padding:5px 10px; max-width:100%; }
button { cursor:pointer; } button[aria-disabled=true] { opacity:.45; cursor:default; }
:focus-visible { outline:2px solid var(--accent); outline-offset:1px; }
kbd { font:.8rem ui-monospace,Menlo,Consolas,monospace; border:1px solid var(--line); border-radius:4px;
  padding:0 5px; background:var(--card); color:var(--ink); }
.keys { display:flex; flex-wrap:wrap; gap:2px 14px; }
[role=tablist] { display:flex; flex-wrap:wrap; gap:4px; }
[role=tab][aria-selected=true] { background:var(--accent); border-color:var(--accent); color:var(--on-accent); }
.filters { display:flex; flex-wrap:wrap; gap:8px; margin:0 0 8px; }
.filters > * { flex:1 1 130px; min-width:0; } .filters input { flex-basis:100%; }
#list { list-style:none; margin:0; max-height:max(220px,100vh - 250px); overflow:auto; padding:4px; }
#list button { display:block; width:100%; text-align:left; border:0; padding:6px 10px; background:none; }
#list button:hover { background:var(--page); }
#list button:focus-visible { outline-offset:-2px; }
#list button[aria-current=true] { background:var(--page); box-shadow:inset 3px 0 var(--accent); }
#list small { color:var(--soft); display:block; } #list span { display:-webkit-box; overflow:hidden;
  -webkit-box-orient:vertical; -webkit-line-clamp:2; overflow-wrap:anywhere; }
.empty { color:var(--soft); padding:12px; } .empty button { display:inline-block !important; width:auto !important;
  border:1px solid var(--line) !important; margin-top:8px; }
.bar { display:flex; align-items:center; gap:8px; margin:0 0 12px; }
.bar h2 { flex:1; margin:0; min-width:0; overflow-wrap:anywhere; } .bar h2:focus { outline:none; }
#toList { display:none; } #place { white-space:nowrap; } .keys { margin:10px 0 14px; } #views { margin-bottom:10px; }
.note { border-left:3px solid var(--accent); padding:2px 0 2px 12px; }
#clip { display:grid; grid-template-columns:repeat(auto-fit,minmax(min(100%,300px),1fr)); gap:16px; }
#clip video { aspect-ratio:4/3; object-fit:contain; margin-top:8px; } #clip [role=tablist] + video { margin-top:8px; }
#clip > div:first-child > video:first-child { margin-top:0; }
.facts { columns:2 250px; column-gap:24px; } .facts div { display:flex; gap:12px; break-inside:avoid; padding:2px 0;
  font-size:.9rem; } .facts dt { flex:0 0 8.5em; } dl.facts { display:block; }
.plots { display:grid; grid-template-columns:repeat(auto-fit,minmax(min(100%,340px),1fr)); gap:16px; }
.plots .card, .charts .card { margin:0; } .plots svg, .charts svg { width:100%; height:auto; display:block; }
.plots b { font-size:.9rem; } svg text { fill:var(--soft); font-size:11px; } .plots svg { cursor:crosshair; }
.key { font-size:.8rem; color:var(--soft); }
.key i { display:inline-block; width:12px; height:3px; margin:0 4px 3px 10px; } .key i:first-child { margin-left:0; }
.charts { display:grid; grid-template-columns:repeat(auto-fit,minmax(min(100%,480px),1fr)); gap:16px; }
.charts h2 { margin:0 0 10px; } .charts p { margin:8px 0 0; } .wide { grid-column:1/-1; }
.reason { display:grid; grid-template-columns:minmax(0,16em) 1fr 3.5em; gap:10px; align-items:center; width:100%;
  text-align:left; border:0; padding:5px 6px; } .reason span { overflow-wrap:anywhere; }
.reason:hover { background:var(--page); } .reason i { display:block; height:14px; min-width:2px; border-radius:3px;
  background:var(--bad); } .reason b { text-align:right; font-variant-numeric:tabular-nums; }
@media (max-width:800px) {
  .two { grid-template-columns:minmax(0,1fr); } .side { position:static; } #list { max-height:45vh; }
  #detail { min-height:100vh; }
  .bar { position:sticky; top:0; z-index:2; background:var(--page); padding:8px 0; } #toList { display:block; }
  .keys, #place { display:none; } .bar h2 { font-size:1rem; } .bar button { padding:5px 8px; }
  .reason { grid-template-columns:minmax(0,9em) 1fr 3em; }
  .charts th, .charts td { padding:6px 4px; }
}
"""

VIEWER = (
    HEAD.replace("<main>", WIDE)
    + "<style>"
    + VIEWER_STYLE
    + """</style>
<h1>{{ title }}</h1>
<p class="soft">{{ task.motion }} {{ task.goal }} {{ n }} attempt{{ "" if n == 1 else "s" }}.</p>
<div role="tablist" aria-label="what to look at" id="views">
<button role="tab" id="tab-episodes" aria-controls="panel-episodes" aria-keyshortcuts="e">Episodes</button>
<button role="tab" id="tab-summary" aria-controls="panel-summary" aria-keyshortcuts="s">Summary</button>
</div>
<p class="soft keys" aria-label="keys">
<span><kbd>n</kbd> next</span><span><kbd>p</kbd> previous</span><span><kbd>k</kbd> play or pause</span>
<span><kbd>,</kbd> <kbd>.</kbd> a picture back or ahead</span><span><kbd>/</kbd> search</span>
<span><kbd>e</kbd> episodes</span><span><kbd>s</kbd> summary</span>
<span><kbd>↑</kbd> <kbd>↓</kbd> within the list</span>
</p>
<div class="two" id="panel-episodes" role="tabpanel" aria-labelledby="tab-episodes">
<section class="side" aria-label="list of episodes">
<div class="filters">
<select id="outcome" aria-label="outcome"><option value="">all outcomes</option><option value="ok">successes</option>
<option value="bad">failures</option><option value="shown">with a recording here</option></select>
<select id="stratum" aria-label="difficulty"><option value="">all difficulties</option>
{% for name in strata %}<option value="{{ loop.index0 }}">{{ name }}</option>
{% endfor %}</select>
{% if generators | length > 1 %}<select id="generator" aria-label="generator"><option value="">all generators</option>
{% for name in generators %}<option value="{{ name }}">{{ name }}</option>
{% endfor %}</select>
{% endif %}
<input id="words" type="search" placeholder="reason, phase or id" aria-label="reason, phase or id"
aria-keyshortcuts="/">
</div>
<p class="soft" id="count" role="status"></p>
<ul class="card" id="list" aria-label="episodes"></ul>
</section>
<section aria-label="episode" id="detail">
<div class="bar" id="bar">
<h2 id="heading" tabindex="-1" aria-live="polite"></h2>
<span class="soft" id="place"></span>
<button id="toList" title="back to the list">List</button>
<button id="previous" aria-keyshortcuts="p" title="previous (p)" aria-label="previous episode">‹ Previous</button>
<button id="next" aria-keyshortcuts="n" title="next (n)" aria-label="next episode">Next ›</button>
</div>
<div id="content"></div>
</section>
</div>
<div id="panel-summary" role="tabpanel" aria-labelledby="tab-summary" class="charts" hidden></div>
<noscript><p>This page needs JavaScript to show its {{ n }} attempts; it loads nothing from elsewhere.</p></noscript>
</main>
<script>
"use strict";
const PAGE = {{ page }};
const EPISODES = {{ episodes }};
"""
    + SCRIPT
    + """</script>
</body>
</html>
"""
)
