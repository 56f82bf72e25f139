// Draws the curves of a run: `history` as in history.rs, `last` the mean PSNR at the end and its number of views, or null.
"use strict";
const splatCurves = (() => {
  const WIDTH = 340, HEIGHT = 190, LEFT = 48, BOTTOM = 24, TOP = 8;

  // Ticks at multiples of 1, 2 or 5 times a power of ten.
  const ticks = (low, high, most) => {
    const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((times) => times * power).find((step) => step >= rough);
    const all = [];
    for (let i = Math.ceil(low / step); i * step <= high * (1 + 1e-12); i++) all.push(i * step);
    return all;
  };
  const short = (value) => {
    if (value === 0) return "0";
    if (Math.abs(value) >= 1e6) return `${+(value / 1e6).toPrecision(4)} M`;
    if (Math.abs(value) >= 1e4) return `${+(value / 1e3).toPrecision(4)} k`;
    return String(+value.toPrecision(4));
  };
  const limits = (values, fallback) => {
    const finite = values.filter(Number.isFinite);
    if (finite.length === 0) return fallback;
    const low = Math.min(...finite), high = Math.max(...finite);
    return high > low ? [low, high] : [low - (Math.abs(low) || 1) / 2, high + (Math.abs(high) || 1) / 2];
  };
  const element = (name, attributes, text) => {
    const made = document.createElementNS(document.querySelector("#svg-space").namespaceURI, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    return made;
  };

  // `points`: [x, y]; `mark`: an additional point, drawn as a ring.
  const draw = (holder, points, mark, name) => {
    const all = mark ? [...points, mark] : points;
    const x = [0, limits(all.map((point) => point[0]), [0, 1])[1]];
    const [low, high] = limits(all.map((point) => point[1]), [0, 1]);
    const y = [Math.min(low, name === "splats" ? 0 : low), high];
    const at = ([px, py]) => [
      LEFT + (px - x[0]) / (x[1] - x[0]) * (WIDTH - LEFT - 8),
      HEIGHT - BOTTOM - (py - y[0]) / (y[1] - y[0]) * (HEIGHT - BOTTOM - TOP),
    ];
    const svg = element("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": name });
    for (const value of ticks(x[0], x[1], 5)) {
      const [px] = at([value, 0]);
      svg.append(element("text", { x: px, y: HEIGHT - 6, "text-anchor": "middle" }, short(value)));
    }
    for (const value of ticks(y[0], y[1], 5)) {
      const [, py] = at([0, value]);
      svg.append(element("path", { class: "grid", d: `M${LEFT} ${py}H${WIDTH - 8}` }));
      svg.append(element("text", { x: LEFT - 6, y: py + 4, "text-anchor": "end" }, short(value)));
    }
    const places = points.filter((point) => point.every(Number.isFinite));
    svg.append(element("path", { class: "curve", d: places.map((point, i) => `${i ? "L" : "M"}${at(point).join(" ")}`).join("") }));
    if (places.length < 60) {
      for (const point of places) {
        const [cx, cy] = at(point);
        svg.append(element("circle", { class: "dot", cx, cy, r: 2 }));
      }
    }
    if (mark) {
      const [cx, cy] = at(mark);
      svg.append(element("circle", { class: "mark", cx, cy, r: 4 }));
    }
    const told = element("text", { x: WIDTH - 8, y: TOP + 6, "text-anchor": "end" });
    svg.append(told);
    svg.addEventListener("pointermove", (event) => {
      const wanted = (event.clientX - svg.getBoundingClientRect().left) / svg.clientWidth * WIDTH;
      const near = (a, b) => Math.abs(at(a)[0] - wanted) <= Math.abs(at(b)[0] - wanted) ? a : b;
      if (all.length > 0) told.textContent = all.reduce(near).map(short).join(": ");
    });
    svg.addEventListener("pointerleave", () => { told.textContent = ""; });
    holder.replaceChildren(svg);
  };

  return (history, last) => {
    const end = history.points[history.points.length - 1];
    const show = (axis) => {
      const against = (points, value) => points.map((point) => [point[axis], point[value] ?? NaN]);
      draw(document.getElementById("chart-loss"), against(history.points, "loss"), null, "loss");
      draw(document.getElementById("chart-splats"), against(history.points, "splats"), null, "splats");
      const mark = last && end ? [end[axis], last[0]] : null;
      draw(document.getElementById("chart-psnr"), against(history.scores, "psnr"), mark, "PSNR");
    };
    for (const input of document.querySelectorAll("input[name=axis]")) input.onchange = () => show(input.value);
    show(document.querySelector("input[name=axis]:checked").value);

    const ring = last ? `The ring is the mean of all ${last[1]} test views at the end. ` : "";
    document.getElementById("psnr-note").textContent = history.scores.length > 0
      ? `${ring}The curve is the mean of ${history.scores[0].views} of them.`
      : `${ring}A curve needs scores during the run: --eval-during N takes them after every N steps.`;
  };
})();
