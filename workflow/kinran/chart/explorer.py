"""The part of the page that a reader steers: any cost against any measure, drawn by the browser from the rows."""

import json
from html import escape

from kinran.chart.panel import COSTS, LEAST, MEASURES
from kinran.chart.rows import Row
from kinran.chart.scatter import FAMILIES, counts

SHOWN = [name for name in MEASURES if name != "texels_above_1"]


def markup(rows: list[Row], measure: str) -> str:
    """Two menus, a plot and its data; `measure` is chosen to begin with."""
    data = [
        {"method": row.method, "family": row.family, "fits": counts(row, "microseconds")}
        | {name: row.values[name] for name in keys if name in row.values}
        for row in rows
        if row.experiment == "all"
        for keys in [(*COSTS, *SHOWN)]
    ]
    floor = next((row["microseconds"] for row in rows if row.experiment == "floor"), None)
    text = json.dumps({"rows": data, "floor": floor, "families": FAMILIES, "least": LEAST}).replace("<", "\\u003c")
    return (
        f'<div class="explorer"><label>across: {_menu("x", COSTS, "microseconds")}</label>'
        f"<label>up: {_menu('y', {name: MEASURES[name] for name in SHOWN}, measure)}</label>"
        f'<div class="plot"></div><script type="application/json">{text}</script></div>'
    )


def _menu(name: str, choices: dict[str, str], chosen: str) -> str:
    options = "".join(
        f'<option value="{key}"{" selected" if key == chosen else ""}>{escape(title)}</option>'
        for key, title in choices.items()
    )
    return f'<select name="{name}">{options}</select>'


STYLE = """
.explorer { background: #fffdf9; border: 1px solid #e4ddd3; padding: 14px 16px; margin: 14px 0 22px; }
.explorer label { margin-right: 24px; color: #6d655c; } .explorer select { font: inherit; padding: 2px 4px; }
.explorer svg { display: block; margin-top: 8px; }
#tip { position: fixed; z-index: 9; background: #2b2723; color: #fffdf9; padding: 4px 9px; border-radius: 4px;
  font-size: 13px; pointer-events: none; display: none; max-width: 360px; }
"""
SCRIPT = """
const tip = document.body.appendChild(Object.assign(document.createElement("div"), {id: "tip"}));
function tell(mark, text) {
  mark.addEventListener("mousemove", (e) => {
    tip.textContent = text;
    tip.style.display = "block";
    tip.style.left = Math.min(e.clientX + 14, innerWidth - 370) + "px";
    tip.style.top = e.clientY + 16 + "px";
  });
  mark.addEventListener("mouseleave", () => { tip.style.display = "none"; });
}
function pick(part, mark) {
  const fade = (on) => {
    part.classList.toggle("faded", on);
    for (const m of part.querySelectorAll("[data-series]"))
      m.classList.toggle("picked", on && m.dataset.series === mark.dataset.series);
  };
  mark.addEventListener("mouseenter", () => fade(true));
  mark.addEventListener("mouseleave", () => fade(false));
}
for (const part of document.querySelectorAll("section"))
  for (const mark of part.querySelectorAll("[data-series]")) {
    const title = mark.querySelector("title");
    if (title) { tell(mark, title.textContent); title.remove(); }
    pick(part, mark);
  }
const W = 1290, H = 480, L = 64, R = 24, T = 20, B = 44;
function node(name, attributes, text) {
  const n = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const key in attributes) n.setAttribute(key, attributes[key]);
  if (text !== undefined) n.textContent = text;
  return n;
}
function ticks(low, high, log) {
  const found = [];
  if (log) {
    for (let k = Math.floor(low); k <= Math.ceil(high); k++)
      for (const m of high - low < 2.2 ? [1, 2, 5] : [1]) found.push(Math.log10(m) + k);
    return found.filter((v) => v >= low && v <= high).map((v) => [v, String(+(10 ** v).toPrecision(2))]);
  }
  const raw = (high - low) / 7, unit = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * unit).find((s) => s >= raw);
  for (let v = Math.ceil(low / step) * step; v <= high; v += step) found.push([v, String(+v.toPrecision(4))]);
  return found;
}
function plot(explorer) {
  const data = JSON.parse(explorer.querySelector("script").textContent);
  const [x, y] = ["x", "y"].map((name) => explorer.querySelector(`[name=${name}]`));
  const likeness = /^(psnr|ssim)/.test(y.value), sign = likeness ? -1 : 1;
  const rows = data.rows.filter((r) => x.value in r && y.value in r && (likeness || r[y.value] > 0));
  const up = (v) => (likeness ? v : Math.log10(v)), across = (v) => Math.log10(Math.max(v, data.least[x.value]));
  const points = rows.map((r) => [across(r[x.value]), up(r[y.value])]);
  const floor = x.value === "microseconds" && data.floor ? across(data.floor) : null;
  const range = (values) => {
    const low = Math.min(...values), high = Math.max(...values), m = 0.07 * Math.max(high - low, 0.01);
    return [low - m, high + m];
  };
  const [x0, x1] = range(points.map((p) => p[0]).concat(floor === null ? [] : [floor]));
  const [y0, y1] = range(points.map((p) => p[1]));
  const px = (v) => L + ((W - L - R) * (v - x0)) / (x1 - x0), py = (v) => H - B - ((H - T - B) * (v - y0)) / (y1 - y0);
  const svg = node("svg", {viewBox: `0 0 ${W} ${H}`, width: W, height: H, role: "img", "font-family": "system-ui"});
  for (const [v, text] of ticks(x0, x1, true)) {
    svg.append(node("line", {x1: px(v), x2: px(v), y1: T, y2: H - B, stroke: "#e4ddd3"}));
    svg.append(node("text", {x: px(v), y: H - B + 17, "text-anchor": "middle", "font-size": 12, fill: "#6d655c"},
      text));
  }
  for (const [v, text] of ticks(y0, y1, !likeness)) {
    svg.append(node("line", {x1: L, x2: W - R, y1: py(v), y2: py(v), stroke: "#e4ddd3"}));
    svg.append(node("text", {x: L - 6, y: py(v) + 4, "text-anchor": "end", "font-size": 12, fill: "#6d655c"}, text));
  }
  const label = x.selectedOptions[0].text;
  svg.append(node("text", {x: (L + W - R) / 2, y: H - 8, "text-anchor": "middle", "font-size": 13}, label));
  if (floor !== null) {
    svg.append(node("line", {x1: px(floor), x2: px(floor), y1: T, y2: H - B, stroke: "#2b2723",
      "stroke-dasharray": "5 4"}));
    svg.append(node("text", {x: px(floor) + 6, y: H - B - 8, "font-size": 12, fill: "#6d655c"},
      `floor ${data.floor.toPrecision(2)} µs: the samples read once`));
  }
  const order = points.map((p, k) => k);
  order.sort((a, b) => points[a][0] - points[b][0] || sign * (points[a][1] - points[b][1]));
  const front = [];
  for (const k of order) {
    const counts = rows[k].fits || x.value === "bytes", last = front.length ? sign * points[front.at(-1)][1] : Infinity;
    if (counts && sign * points[k][1] < last) front.push(k);
  }
  const path = front.map((k) => `${px(points[k][0])},${py(points[k][1])}`).join(" ");
  svg.append(node("polyline", {points: path, fill: "none", stroke: "#d9c69a", "stroke-width": 4}));
  const taken = points.map((p) => [px(p[0]) - 6, py(p[1]) + 5, 12]);
  rows.forEach((r, k) => {
    const ring = r.family === "default", best = front.includes(k), colour = data.families[r.family];
    const dot = node("circle", {cx: px(points[k][0]), cy: py(points[k][1]), r: ring ? 9 : 6, stroke: colour,
      "stroke-width": 2.5, fill: ring ? "none" : best ? colour : "#fffdf9", "pointer-events": "all"});
    dot.dataset.series = r.method;
    const value = (key) => (key in r ? `${+r[key].toPrecision(3)}` : "not known");
    tell(dot, `${r.method}: relative error ${value("relative_error")}, PSNR ${value("psnr_display")} dB, ` +
      `SSIM ${value("ssim_display")}; ${value("microseconds")} µs, ${value("bytes")} bytes, ${value("memory_mb")} MB` +
      (best ? "; on the front of this plot" : ""));
    pick(explorer.closest("section"), dot);
    svg.append(dot);
    if (best || ring) {
      const cx = px(points[k][0]), cy = py(points[k][1]), wide = 7 * r.method.length;
      const places = [[13, -9], [13, 20], [-13 - wide, -9], [-13 - wide, 20], [13, 36], [-13 - wide, 36]];
      const free = ([a, b]) => cx + a > L && cx + a + wide < W - 4 && !taken.some(([u, v, w]) =>
        cx + a < u + w && u < cx + a + wide && Math.abs(v - cy - b) < 14);
      const [a, b] = places.find(free) || places[0];
      taken.push([cx + a, cy + b, wide]);
      const name = node("text", {x: cx + a, y: cy + b, "font-size": 12}, r.method);
      name.dataset.series = r.method;
      svg.append(name);
    }
  });
  explorer.querySelector(".plot").replaceChildren(svg);
}
for (const explorer of document.querySelectorAll(".explorer")) {
  explorer.addEventListener("change", () => plot(explorer));
  plot(explorer);
}
"""
