"""The pages of reports: Jinja2 templates that need nothing from outside the file they become."""

from __future__ import annotations

STYLE = """
:root { --page:#f6f7f9; --card:#fff; --ink:#111827; --soft:#5b6472; --line:#e2e5ea; --accent:#0072b2;
  --good:#00724f; --bad:#b24a00; --on-accent:#fff; color-scheme: light dark; }
@media (prefers-color-scheme: dark) {
  :root { --page:#0f1318; --card:#181d24; --ink:#e8ebf0; --soft:#9aa4b2; --line:#2b323c; --accent:#5ab4e8;
    --good:#3fcf9f; --bad:#ff9a52; --on-accent:#0f1318; } }
* { box-sizing:border-box; }
body { margin:0; background:var(--page); color:var(--ink);
  font:16px/1.55 system-ui,-apple-system,"Segoe UI",sans-serif; }
main { max-width:960px; margin:0 auto; padding:32px 16px 64px; }
h1 { font-size:1.75rem; line-height:1.2; margin:0 0 4px; letter-spacing:-.01em; overflow-wrap:anywhere; }
h2 { font-size:1.1rem; margin:40px 0 12px; }
p { margin:0 0 12px; } .soft { color:var(--soft); font-size:.9rem; }
code { font:.85em/1.5 ui-monospace,SFMono-Regular,Menlo,Consolas,monospace; overflow-wrap:anywhere; }
pre { background:var(--card); border:1px solid var(--line); border-radius:8px; padding:10px 14px; margin:16px 0;
  white-space:pre-wrap; }
.card { background:var(--card); border:1px solid var(--line); border-radius:12px; padding:16px; margin:0 0 16px; }
.tiles { display:grid; grid-template-columns:repeat(auto-fit,minmax(150px,1fr)); gap:12px; margin:20px 0; }
.tiles .card { margin:0; }
.tiles b { display:block; font-size:1.9rem; line-height:1.2; font-variant-numeric:tabular-nums; }
.scroll { overflow-x:auto; } table { border-collapse:collapse; width:100%; font-variant-numeric:tabular-nums; }
th,td { text-align:right; padding:7px 10px; border-bottom:1px solid var(--line); white-space:nowrap; }
th { font-weight:600; color:var(--soft); font-size:.85rem; } tr:last-child td { border-bottom:0; }
th:first-child,td:first-child,td.text,th.text { text-align:left; } td.text { white-space:normal; }
.figures { display:grid; grid-template-columns:repeat(auto-fit,minmax(min(100%,540px),1fr)); gap:0 16px; }
figure { margin:0 0 16px; } figure img { display:block; width:100%; height:auto; background:#fff; border-radius:8px; }
figcaption { margin-top:8px; color:var(--soft); font-size:.9rem; }
.clips { display:grid; grid-template-columns:repeat(auto-fit,minmax(min(100%,320px),1fr)); gap:16px; }
.clips figure { margin:0; } video { display:block; width:100%; border-radius:8px; background:#000; }
.good { color:var(--good); font-weight:600; } .bad { color:var(--bad); font-weight:600; }
details summary { cursor:pointer; color:var(--accent); padding:4px 0; }
dl { display:grid; grid-template-columns:max-content 1fr; gap:4px 16px; margin:0; font-size:.9rem; }
dt { color:var(--soft); } dd { margin:0; overflow-wrap:anywhere; }
@media (max-width:800px) {
  main { padding:16px 12px 48px; } h1 { font-size:1.35rem; } h2 { margin-top:28px; } .card { padding:12px; }
  .tiles { grid-template-columns:repeat(auto-fit,minmax(130px,1fr)); } .tiles b { font-size:1.5rem; }
  th,td { padding:6px; font-size:.85rem; }
  .scroll th:first-child,.scroll td:first-child { position:sticky; left:0; background:var(--card); }
}
@media print { body { background:#fff; } video { display:none; } }
"""

HEAD = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; media-src blob: data:; \
style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{{ title }}</title>
<style>{{ style }}</style>
</head>
<body>
<main>
"""

WIDE = '<main style="max-width:1280px">'
FIGURE = """<figure class="card"><img src="{{ figure.image | image_url }}" alt="{{ figure.title }}">
<figcaption><b>{{ figure.title }}.</b> {{ figure.caption }}</figcaption></figure>
"""

PAGE = (
    """{% macro describe(outcome) -%}
{% if outcome.success %}<span class="good">✓ success</span>
{%- else %}<span class="bad">✗ {{ outcome.failure }}</span>
{%- endif %}
{%- endmacro -%}
{% set title = data.title %}
"""
    + HEAD
    + """<header>
<h1>{{ data.title }}</h1>
<p class="soft">task <b>{{ data.task }}</b> · {{ data.date }}</p>
<pre><code>{{ data.command }}</code></pre>
</header>

<section class="tiles" aria-label="Summary">
{% for report in data.reports %}
<div class="card"><span class="soft">{{ report.label }}</span><b>{{ report.total.rate | percent }}</b>
<span class="soft">{{ report.total.successes }} of {{ report.n }} attempts</span></div>
{% endfor %}
{% if data.paired %}
<div class="card"><span class="soft">paired gain</span><b>{{ data.paired.difference | points }}</b>
<span class="soft">95 % {{ data.paired.interval.low | points }} to {{ data.paired.interval.high | points }}</span></div>
{% endif %}
</section>

<section>
<h2>Demonstration generation rate</h2>
<div class="card scroll" tabindex="0"><table>
<tr><th>generator</th><th>n</th><th>success</th><th>Wilson 95 %</th><th>std over blocks</th></tr>
{% for report in data.reports %}
<tr><td>{{ report.label }}</td><td>{{ report.n }}</td><td>{{ report.total.rate | percent }}</td>
<td>{{ report.interval.low | percent }} – {{ report.interval.high | percent }}</td>
<td>{{ report.std | percent }}</td></tr>
{% endfor %}
</table></div>
{% if data.paired %}<p class="soft">{{ data.paired | gain }}</p>{% endif %}
<p class="soft">Every attempt counts: planner failures, exceptions and timeouts are failures with a reason.
{% if data.paired %}The interval of the difference is Newcombe's, for paired rates.{% endif %}</p>
{% for note in data.notes %}<p>{{ note }}</p>{% endfor %}
</section>

{% if data.figures %}
<section>
<h2>Figures</h2>
{% for figure in data.figures %}
"""
    + FIGURE
    + """{% endfor %}
</section>
{% endif %}

{% if data.clips %}
<section>
<h2>Clips</h2>
<div class="clips">
{% for clip in data.clips %}
<figure class="card"><video controls muted loop playsinline preload="metadata" src="{{ clip.mp4 | video_url }}"></video>
<figcaption>{{ describe(clip.outcome) }}
· {{ clip.caption }}<br><code>{{ clip.condition_id }}</code></figcaption></figure>
{% endfor %}
</div>
</section>
{% endif %}

<section>
<h2>Why attempts failed</h2>
<div class="card scroll" tabindex="0"><table>
<tr><th>reason</th>{% for report in data.reports %}<th>{{ report.label }}</th>{% endfor %}</tr>
{% for reason in reasons %}
<tr><td class="text">{{ reason }}</td>
{% for report in data.reports %}<td>{{ report.failures.get(reason, 0) }}</td>{% endfor %}</tr>
{% else %}
<tr><td class="text">no failures</td></tr>
{% endfor %}
</table></div>
</section>

{% if data.attempts %}
<section>
<h2>Ledger</h2>
<details class="card">
<summary>{{ data.attempts | length }} attempts
{%- if hidden %}, the first {{ shown | length }} listed{% endif %}</summary>
<div class="scroll" tabindex="0"><table>
<tr><th>condition</th><th class="text">generator</th><th>difficulty</th>
<th class="text">outcome</th><th class="text">phase</th><th>checkpoint</th><th>duration</th></tr>
{% for attempt in shown %}
<tr><td><code>{{ attempt.condition.id }}</code></td><td class="text">{{ attempt.generator }}</td>
<td>{{ "%.3g" | format(attempt.difficulty) }}</td>
<td class="text">{{ describe(attempt.outcome) }}</td>
<td class="text">{{ attempt.outcome.phase }}</td><td>{{ attempt.outcome.checkpoint }}</td>
<td>{{ "%.2f" | format(attempt.duration) }} s</td></tr>
{% endfor %}
</table></div></details>
</section>
{% endif %}

<section>
<h2>How this was made</h2>
<div class="card"><dl>
<dt>command</dt><dd><code>{{ data.command }}</code></dd>
{% for name, value in data.seeds.items() %}<dt>{{ name }}</dt><dd>{{ value }}</dd>{% endfor %}
{% for name, value in data.versions.items() %}<dt>{{ name }}</dt><dd>{{ value }}</dd>{% endfor %}
<dt>date</dt><dd>{{ data.date }}</dd>
</dl></div>
</section>
</main>
</body>
</html>
"""
)

COMPARISON = (
    HEAD.replace("<main>", WIDE)
    + """<header>
<h1>{{ title }}</h1>
<p class="soft">{{ date }}</p>
<pre><code>{{ command }}</code></pre>
</header>
<p class="soft">{{ legend }}</p>
{% for section in sections %}
<section>
<h2>{{ section.title }}</h2>
<div class="card scroll" tabindex="0"><table>
<tr><th>variant</th>{% for name in columns %}<th>{{ name }}</th>{% endfor %}</tr>
{% for name, cells in section.rows %}
<tr><td>{{ name }}</td>{% for cell in cells %}<td>{{ cell }}</td>{% endfor %}
{% for _ in columns[cells | length:] %}<td></td>{% endfor %}</tr>
{% endfor %}
</table></div>
{% if section.groups %}
<div class="card scroll" tabindex="0"><table>
<tr><th>variant</th><th>groups all failed</th><th>mixed</th><th>all succeeded</th><th>strata forgotten</th></tr>
{% for row in section.groups %}
<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}
</table></div>
{% endif %}
<div class="figures">
{% for figure in section.figures %}
"""
    + FIGURE
    + """{% endfor %}
</div>
</section>
{% endfor %}
{% if not sections %}<p>No run has been stored yet, so there is nothing to compare.</p>{% endif %}
<section>
<h2>Settings</h2>
{% for variant, values in settings.items() %}
<details class="card"><summary>{{ variant }}</summary><dl>
{% for name, value in values.items() %}<dt>{{ name }}</dt><dd>{{ value }}</dd>{% endfor %}
</dl></details>
{% else %}
<p class="soft">No settings were stored.</p>
{% endfor %}
</section>
</main>
</body>
</html>
"""
)
