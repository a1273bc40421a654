// Draws the figures of a page with uPlot. An element with the attribute data-plot contains a figure
// as JSON: curves with ascending x, or a map of colours and outlines on equal axes.
//
// The pointer reads values, dragging enlarges, a double click shows all, and a click on a name of
// the legend hides its curve. A waveform with more cycles than the screen resolves is its envelope.
"use strict";
(() => {
  const DASHES = {"--": [7, 4], ":": [2, 3], reference: [2, 4]}, PLAIN = [[], [9, 3], [4, 3], [9, 3, 2, 3]];
  const VIRIDIS = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"];
  const LEFT = 50, BELOW = 42, ABOVE = 8, RIGHT = 18; // margins in pixels
  const HALF_CYCLE = 4; // pixels; shorter ones are drawn as an envelope
  const ratio = () => window.devicePixelRatio || 1;
  const look = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const colour = (c, k) => (c.style === "reference" ? "ink" : `curve${k}`);
  const line = uPlot.paths.linear(), charts = [];

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const numbers = (text) => Array.from(new Float32Array(bytes(text)), (v) => (Number.isFinite(v) ? v : null));
  const shares = (text, low, high) => Array.from(new Uint16Array(bytes(text)), (v) => (v === 65535 ? null : low + ((high - low) * v) / 65534));
  const power = (k) => "10" + String(k).replace(/./g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]);
  const unit = (label) => (/ in (.+)$/.exec(label) || /^(mm)\b/.exec(label) || ["", ""])[1];

  function words(v, digits = 5) {
    const [mantissa, exponent] = v.toExponential(digits - 1).split("e"), size = Math.abs(v);
    const plain = v === 0 || (size >= 1e-3 && size < 1e5);
    const text = plain ? String(Number(v.toPrecision(digits))) : `${Number(mantissa)}·${power(Number(exponent))}`;
    return text.replace("-", "−");
  }
  const reading = (v, label) => (v == null ? "" : `${words(v)} ${unit(label)}`.trim());

  function logTicks(u, axis, low, high) {
    const ticks = [];
    if (high / low < 10) {
      const raw = (high - low) / 5, tens = 10 ** Math.floor(Math.log10(raw));
      const step = tens * [1, 2, 5, 10].find((k) => k * tens >= 0.999 * raw);
      for (let v = Math.ceil(low / step) * step; v <= high; v += step) ticks.push(v);
      return ticks;
    }
    for (let d = Math.floor(Math.log10(low)); d <= Math.log10(high); d++) {
      for (let k = 1; k < (high / low > 1e7 ? 2 : 10); k++) if (k * 10 ** d >= low * (1 - 1e-9) && k * 10 ** d <= high * (1 + 1e-9)) ticks.push(k * 10 ** d);
    }
    return ticks;
  }

  function logTexts(u, ticks, axis) {
    const {min, max} = u.scales[axis ? "y" : "x"], decade = (v) => Math.floor(Math.log10(v * 1.0001));
    if (max / min < 10) return ticks.map((v) => words(v));
    const room = (axis ? u.bbox.height / 26 : u.bbox.width / 60) / ratio(), decades = Math.log10(max / min);
    const every = Math.ceil(decades / room), plain = min > 9e-3 && max < 1.1e4;
    return ticks.map((v) => {
      const d = decade(v), first = Math.round(v / 10 ** d);
      if (first === 1) return d % every ? "" : plain ? words(v) : power(d);
      return (first === 2 || first === 5) && decades < 2.2 && 3 * decades < room ? words(v) : "";
    });
  }

  function traced(u, s, first, last) { // the line, or the envelope of more cycles than pixels resolve
    const [x, y] = [u.data[0], u.data[s]], {min, max} = u.scales.y, X = (v) => u.valToPos(v, "x", true);
    const path = line(u, s, first, last), swing = 0.01 * (max - min);
    let turns = 0, peak = null, up = true, gaps = false;
    for (let i = first; i <= last; i++) {
      if (y[i] === null) gaps = true;
      if (y[i] == null) continue;
      if (peak === null || (up ? y[i] > peak : y[i] < peak)) peak = y[i];
      else if (Math.abs(y[i] - peak) > swing) [peak, up, turns] = [y[i], !up, turns + 1];
    }
    if (gaps || u.scales.y.distr === 3 || turns * HALF_CYCLE * ratio() < u.bbox.width) return path && {...path, fill: null};
    const bins = new Map(), wide = Math.max(4 * ratio(), (4 * u.bbox.width) / turns);
    for (let i = first; i <= last; i++) {
      if (y[i] == null) continue;
      const bin = bins.get(Math.floor(X(x[i]) / wide));
      if (bin) [bin[1], bin[2]] = [Math.min(bin[1], y[i]), Math.max(bin[2], y[i])];
      else bins.set(Math.floor(X(x[i]) / wide), [X(x[i]), y[i], y[i]]);
    }
    const rows = [...bins.values()], shape = new Path2D(); // each limit over three bins: smooth
    const limit = (k, column, of) => of(...rows.slice(Math.max(0, k - 1), k + 2).map((row) => row[column]));
    rows[rows.length - 1][0] = X(x[last]);
    rows.forEach(([px], k) => shape.lineTo(px, u.valToPos(limit(k, 1, Math.min), "y", true)));
    for (let k = rows.length - 1; k >= 0; k--) shape.lineTo(rows[k][0], u.valToPos(limit(k, 2, Math.max), "y", true));
    shape.closePath();
    return {stroke: shape, fill: shape, clip: null, flags: 1};
  }

  function series(p, c, k) {
    const paths = {bar: uPlot.paths.bars({size: [0.9, 200]}), step: uPlot.paths.stepped({align: 1}), o: () => null};
    const dots = c.style.startsWith("o"), fill = c.style === "bar" ? "" : "66";
    return {
      label: c.label || p.y.replace(/ in .*/, ""), width: 1.6, pxAlign: 0, stroke: () => look(colour(c, k)),
      fill: () => (dots ? null : look(colour(c, k)) + fill), paths: paths[c.style] || traced,
      dash: (DASHES[c.style] || (c.style === "-" && PLAIN[k % 4]) || []).map((v) => v * ratio()),
      points: {show: dots, size: c.x.length > 300 ? 4 : 7, fill: () => look(colour(c, k))},
      value: (u, v, s, i) => (v == null ? "" : [c.names[c.x.indexOf(u.data[0][i])], reading(v, p.y)].filter(Boolean).join(" ")),
    };
  }

  function nearest(u, s, index) { // the point of this curve that is next to one of another curve
    const y = u.data[s];
    for (let k = 0; k < y.length; k++) {
      if (y[index - k] !== undefined) return index - k;
      if (y[index + k] !== undefined) return index + k;
    }
    return index;
  }

  function decorate(u, p) { // outlines, shaded ranges, levels and marks
    const {ctx, bbox: {left, top, width, height}} = u, r = ratio();
    const X = (v) => u.valToPos(v, "x", true), Y = (v) => u.valToPos(v, "y", true);
    const stroke = (x0, y0, x1, y1) => { ctx.beginPath(); ctx.moveTo(x0, y0); ctx.lineTo(x1, y1); ctx.stroke(); };
    const note = (text, x, y) => { ctx.strokeText(text, x, y); ctx.fillText(text, x, y); };
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    [ctx.lineWidth, ctx.font, ctx.textAlign, ctx.textBaseline] = [1.2 * r, `${12 * r}px system-ui, sans-serif`, "left", "alphabetic"];
    for (const c of p.outlines) {
      ctx.strokeStyle = look(p.map ? "ink" : "curve0");
      ctx.setLineDash((DASHES[c.style] || []).map((v) => v * r));
      ctx.beginPath();
      c.y.forEach((v, i) => { if (v !== null) ctx[i && c.y[i - 1] !== null ? "lineTo" : "moveTo"](X(c.x[i]), Y(v)); });
      ctx.stroke();
    }
    ctx.fillStyle = look("shade");
    for (const [low, high] of p.bands) ctx.fillRect(left, Y(high), width, Y(low) - Y(high));
    ctx.strokeStyle = look("soft");
    ctx.setLineDash([8 * r, 3 * r, 2 * r, 3 * r]);
    for (const [v] of p.levels) stroke(left, Y(v), left + width, Y(v));
    ctx.setLineDash([]);
    for (const [v] of p.marks) stroke(X(v), top, X(v), top + height);
    [ctx.fillStyle, ctx.strokeStyle, ctx.lineWidth] = [look("soft"), look("paper"), 3 * r];
    for (const [, v, label] of p.bands) note(label, left + 6 * r, Y(v) - 4 * r);
    for (const [v, label] of p.levels) note(label, left + 6 * r, Y(v) - 4 * r);
    p.marks.forEach(([v, label], k) => note(label, X(v) + 4 * r, top + (13 + 15 * (k % 3)) * r));
    ctx.restore();
  }

  const edges = (at, log) => { // of the cells about centres
    const v = log ? at.map(Math.log10) : at, n = v.length, step = n > 1 ? [v[1] - v[0], v[n - 1] - v[n - 2]] : [1, 1];
    const all = [v[0] - step[0] / 2, ...v.slice(1).map((w, k) => (w + v[k]) / 2), v[n - 1] + step[1] / 2];
    return log ? all.map((w) => 10 ** w) : all;
  };

  function cells(u, p) { // of a map; those of a body's picture are smoothed
    const {x, y, z} = p.map, rgb = VIRIDIS.map((c) => [1, 3, 5].map((k) => parseInt(c.slice(k, k + 2), 16)));
    const [X, Y] = [["x", x, p.log_x], ["y", y, p.log_y]].map(([key, at, log]) => edges(at, log).map((v) => Math.round(u.valToPos(v, key, true))));
    const picture = Object.assign(document.createElement("canvas"), {width: x.length, height: y.length});
    const pen = p.equal ? picture.getContext("2d") : u.ctx, [right, low] = [X[x.length], Y[y.length]];
    u.ctx.save();
    u.ctx.beginPath();
    u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    u.ctx.clip();
    z.forEach((v, k) => {
      if (v === null && p.equal) return;
      const at = (8 * (v - p.low)) / (p.high - p.low || 1), i = Math.min(7, Math.floor(at)), [a, b] = [k % x.length, Math.floor(k / x.length)];
      pen.fillStyle = v === null ? "#9998" : `rgb(${rgb[i].map((w, c) => w + (at - i) * (rgb[i + 1][c] - w))})`;
      if (p.equal) pen.fillRect(a, y.length - 1 - b, 1, 1);
      else pen.fillRect(X[a], Y[b + 1], X[a + 1] - X[a], Y[b] - Y[b + 1]);
    });
    if (p.equal) u.ctx.drawImage(picture, X[0], low, right - X[0], Y[0] - low);
    u.ctx.restore();
  }

  function colourBar(box, p) { // and the value under the pointer
    const bar = box.appendChild(document.createElement("div")), [low, ramp, high, value] = ["span", "i", "span", "output"].map((name) => document.createElement(name));
    bar.className = "bar";
    [low.textContent, high.textContent] = [words(p.low, 3), words(p.high, 3)];
    if (low.textContent === high.textContent) high.textContent = ""; // a constant map has one value
    ramp.style.background = `linear-gradient(to right, ${VIRIDIS})`;
    bar.append(low, ramp, high, value);
    return (u) => {
      const near = (at, v) => at.reduce((best, w, k) => (Math.abs(w - v) < Math.abs(at[best] - v) ? k : best), 0);
      const {left, top} = u.cursor, [i, j] = [near(p.map.x, u.posToVal(left, "x")), near(p.map.y, u.posToVal(top, "y"))];
      const v = p.map.z[j * p.map.x.length + i];
      value.textContent = left < 0 ? "" : `${words(p.map.x[i])}, ${words(p.map.y[j])}: ${v === null ? "none" : words(v)}`;
    };
  }

  function ranges(p) { // of both axes: the whole, what was dragged, or what is seen of the curves
    const [x0, x1] = p.range_x, whole = (u, low, high) => low <= u.data[0][0] && high >= u.data[0][u.data[0].length - 1];
    const x = (u, low, high) => { // uPlot asks for the range of x first
      p.enlarged = low < high && !whole(u, low, high);
      return p.enlarged ? [low, high] : [x0, x1];
    };
    const y = (u, low, high) => {
      if (p.range_y) return p.range_y;
      const more = p.enlarged ? [] : [...p.levels.map((l) => l[0]), ...p.bands.flatMap((b) => [b[0], b[1]])];
      if (p.curves.some((c) => c.style === "bar")) more.push(0);
      [low, high] = [Math.min(...more, low ?? Infinity), Math.max(...more, high ?? -Infinity)];
      if (!(low <= high)) return p.log_y ? [1, 10] : [0, 1];
      if (p.log_y) return low < high ? [low / (high / low) ** 0.06, high * (high / low) ** 0.06] : [low / 2, high * 2];
      const room = 0.06 * (high - low) || Math.abs(high) / 2 || 1;
      return [low - room, high + room];
    };
    return {x: {time: false, distr: p.log_x ? 3 : 1, range: x}, y: {distr: p.log_y ? 3 : 1, range: y}};
  }

  function size(p, box, shape) { // of a chart as wide as its box; on equal axes the ranges follow
    const width = box.clientWidth, height = Math.max(180, width / shape);
    if (!p.equal) return {width, height};
    const [dx, dy] = [p.whole_x[1] - p.whole_x[0], p.whole_y[1] - p.whole_y[0]], across = width - LEFT - RIGHT;
    const up = Math.min(Math.max((across * dy) / dx, 90), 420), scale = Math.max(dx / across, dy / up);
    const about = ([low, high], length) => [(low + high - length) / 2, (low + high + length) / 2];
    [p.range_x, p.range_y] = [about(p.whole_x, scale * across), about(p.whole_y, scale * up)];
    return {width, height: up + ABOVE + BELOW};
  }

  function enlarge(u) { // what was dragged, on equal axes
    const {left, top, width, height} = u.select;
    if (!width || !height) return;
    const shares = [width / u.over.clientWidth, height / u.over.clientHeight].filter((s) => s < 0.999); // 1: not dragged
    const share = Math.max(...shares, 1e-9) / 2;
    for (const [key, at] of [["x", left + width / 2], ["y", top + height / 2]]) {
      const {min, max} = u.scales[key], middle = u.posToVal(at, key);
      u.setScale(key, {min: middle - share * (max - min), max: middle + share * (max - min)});
    }
    u.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
  }

  function chart(grid, figure, p, key) {
    const box = grid.appendChild(document.createElement("div"));
    box.appendChild(document.createElement("div")).textContent = p.map ? p.map.label : p.y;
    p.curves.concat(p.outlines).forEach((c) => { [c.x, c.y] = [numbers(c.x), numbers(c.y)]; });
    if (p.map) Object.assign(p.map, {x: numbers(p.map.x), y: numbers(p.map.y), z: shares(p.map.z, p.low, p.high)});
    const shape = figure.columns > 1 ? 1.35 : figure.panels.length > 1 ? 2.6 : 1.9;
    const axis = (a, log) => ({
      stroke: () => look("soft"), font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", labelSize: 18, labelGap: 0,
      label: a || !p.last ? null : p.x, size: a ? LEFT : p.last ? BELOW - 18 : 12, space: a ? 34 : 70, gap: 4,
      grid: {show: !p.map, stroke: () => look("line"), width: 1}, ticks: {size: 4, stroke: () => look("line")},
      values: (u, at) => (!a && !p.last ? [] : log ? logTexts(u, at, a) : at.map((v) => words(v, 8))),
      ...(log ? {splits: logTicks, filter: (u, at) => at} : {}),
    });
    const read = p.map ? colourBar(box, p) : () => {};
    const named = (u) => [...u.root.querySelectorAll(".u-legend tr")].slice(1).map((row, k) => [row.firstChild, u.series[k + 1]]);
    const u = new uPlot({
      ...size(p, box, shape), padding: [ABOVE, RIGHT, 0, 0], pxAlign: 0, scales: ranges(p), axes: [axis(0, p.log_x), axis(1, p.log_y)],
      series: [{label: p.x.replace(/ in .*/, ""), value: (u, v) => reading(v, p.x)}, ...p.curves.map((c, k) => series(p, c, k))],
      legend: {show: !p.map && p.curves.length > 0, markers: {
        width: 2, stroke: (u, s) => `var(--${colour(p.curves[s - 1], s - 1)})`, fill: () => "transparent",
        dash: (u, s) => (u.series[s].dash.length ? "dashed" : "solid"),
      }},
      cursor: {
        sync: {key, scales: ["x", null]}, drag: {x: true, y: true, uni: 25, dist: 5, setScale: !p.equal}, dataIdx: nearest,
        points: {show: p.curves.length > 0}, y: Boolean(p.map),
      },
      hooks: {
        drawClear: [(u) => p.map && cells(u, p)], drawAxes: [(u) => decorate(u, p)], setCursor: [read], setSelect: [(u) => p.equal && enlarge(u)],
        setSeries: [(u) => named(u).forEach(([name, s]) => name.setAttribute("aria-pressed", s.show))],
        ready: [(u) => named(u).forEach(([name]) => {
          Object.entries({role: "button", tabindex: 0, "aria-pressed": true}).forEach((pair) => name.setAttribute(...pair));
          name.addEventListener("keydown", (e) => { if (e.key === "Enter" || e.key === " ") { e.preventDefault(); name.click(); } });
        })],
      },
    }, p.curves.length ? uPlot.join(p.curves.map((c) => [c.x, c.y])) : [p.range_x], box);
    u.root.querySelector("canvas").setAttribute("role", "img");
    u.root.querySelector("canvas").setAttribute("aria-label", p.spoken);
    charts.push(u);
    new ResizeObserver(() => {
      if (!box.clientWidth || box.clientWidth === u.width) return;
      u.setSize(size(p, box, shape));
      if (p.equal) [["x", p.range_x], ["y", p.range_y]].forEach(([axis, [min, max]]) => u.setScale(axis, {min, max}));
    }).observe(box);
  }

  document.querySelectorAll("figure[data-plot]").forEach((element, k) => {
    const figure = JSON.parse(element.querySelector("script").textContent), caption = element.querySelector("figcaption");
    const title = document.createElement("h3"), grid = document.createElement("div");
    title.textContent = figure.title;
    grid.className = figure.columns > 1 ? "panels many" : "panels";
    if (figure.columns > 1) element.style.gridColumn = "1 / -1";
    caption.before(title, grid);
    figure.panels.forEach((p, j) => chart(grid, figure, p, figure.columns > 1 ? `${k}.${j}` : String(k)));
  });
  matchMedia("screen and (prefers-color-scheme: dark)").addEventListener("change", () => charts.forEach((u) => u.redraw(false)));
  window.kc2spiceCharts = charts; // for tests and the console
})();
