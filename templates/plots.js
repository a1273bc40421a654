// Draws the figures of a page: elements with the attribute data-plot that hold panels as JSON.
//
// The pointer reads values; dragging shows the chosen range of x (dragging across both ways, of y
// too), a double click shows all; a click on a name of the legend hides its curve. Panels above
// each other share x. Curves differ by colour (Okabe and Ito) and by the shape of sparse marks, so
// that prints and colour-blind readers can tell them apart.
"use strict";
(() => {
  const COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#222222"];
  const DASHES = {"--": [7, 4], ":": [2, 3], reference: [1.5, 4]};
  const VIRIDIS = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962",
    "#addc30", "#fde725"].map((c) => [1, 3, 5].map((k) => parseInt(c.slice(k, k + 2), 16)));
  const INK = "#222", SOFT = "#5c6670", GRID = "#e4e8ec", FAINT = "#f1f3f5";
  const FONT = "12px system-ui, 'DejaVu Sans', sans-serif";
  const LEFT = 64, RIGHT = 14, TOP = 16, BOTTOM = 40, BAR = 84; // margins; BAR: of a colour bar
  const MARK_STEP = 90; // pixels between marks on a line
  const SNAP = 4; // pixels within which the pointer reads a point and not the line

  // --- numbers and their words -------------------------------------------------------------------

  const numbers = (text) =>
    new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const transformed = (log, values) => (log ? values.map((v) => Math.log10(v)) : values);
  const plain = (log, v) => (log ? 10 ** v : v);
  const raised = (k) => String(k).replace(/./g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]);
  const signed = (text) => text.replace("-", "−");

  function words(v) { // five digits
    if (v === 0 || !Number.isFinite(v)) return String(v);
    const size = Math.abs(v);
    if (size >= 1e-3 && size < 1e5) return signed(String(Number(v.toPrecision(5))));
    const [digits, power] = v.toExponential(4).split("e");
    return signed(`${Number(digits)}`) + `×10${raised(Number(power))}`;
  }

  function unit(label) { // of "force in N" or "force [N]"
    const found = /(?: in | \[)([^\]]+)\]?$/.exec(label);
    return found ? ` ${found[1]}` : "";
  }

  // --- ticks: {at, text} in the axis' own numbers, and what all texts are to be multiplied by ----

  function linearTicks(low, high, count) {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 2.5, 5, 10].find((k) => k * power >= raw * 0.999);
    const largest = Math.max(Math.abs(low), Math.abs(high));
    const third = 3 * Math.floor(Math.log10(largest) / 3);
    const factor = third >= 6 || third <= -6 ? third : 0;
    const shown = step / 10 ** factor;
    let decimals = 0;
    while (decimals < 10 && Math.abs(shown * 10 ** decimals - Math.round(shown * 10 ** decimals)) > 1e-6) {
      decimals++;
    }
    const ticks = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) {
      ticks.push({at: k * step, text: signed((k * shown).toFixed(decimals))});
    }
    return {ticks, minor: [], note: factor ? `×10${raised(factor)}` : ""};
  }

  function logTicks(low, high, count) {
    const named = (at, text) => ({at, text});
    const decade = (d) => named(d, d >= -3 && d <= 4 ? String(Number((10 ** d).toPrecision(1))) : `10${raised(d)}`);
    const first = Math.ceil(low - 1e-9), last = Math.floor(high + 1e-9);
    const minor = [], few = [];
    for (let d = first - 1; d <= last; d++) {
      for (let k = 2; k < 10; k++) {
        const at = d + Math.log10(k);
        if (at < low || at > high) continue;
        minor.push(at);
        if (k === 2 || k === 5) few.push(named(at, words(Number((k * 10 ** d).toPrecision(1)))));
      }
    }
    if (last - first >= 2) {
      const every = Math.ceil((last - first + 1) / count), ticks = [];
      for (let d = first; d <= last; d += every) ticks.push(decade(d));
      return {ticks, minor: every > 1 ? [] : minor, note: ""};
    }
    for (let d = first; d <= last; d++) few.push(decade(d));
    if (few.length > 2) return {ticks: few, minor, note: ""};
    const {ticks} = linearTicks(10 ** low, 10 ** high, count);
    const inside = ticks.filter((t) => t.at > 0);
    return {ticks: inside.map((t) => named(Math.log10(t.at), words(t.at))), minor: [], note: ""};
  }

  // --- ranges --------------------------------------------------------------------------------

  function extent(values, keep = () => true) {
    let low = Infinity, high = -Infinity;
    for (let i = 0; i < values.length; i++) {
      if (Number.isFinite(values[i]) && keep(i)) {
        low = Math.min(low, values[i]);
        high = Math.max(high, values[i]);
      }
    }
    return [low, high];
  }

  function union(ranges) {
    const low = Math.min(...ranges.map((r) => r[0])), high = Math.max(...ranges.map((r) => r[1]));
    if (!(low <= high)) return [0, 1];
    if (low < high) return [low, high];
    const half = Math.abs(low) / 2 || 1;
    return [low - half, high + half];
  }

  const wider = ([low, high], share) => [low - share * (high - low), high + share * (high - low)];

  function stretched([low, high], length) { // to a length about its middle
    const middle = (low + high) / 2;
    return [middle - length / 2, middle + length / 2];
  }

  // --- marks: how curves differ without colour ----------------------------------------------------

  const polygon = (...points) => (g, x, y) => {
    points.forEach(([a, b], k) => (k ? g.lineTo(x + a, y + b) : g.moveTo(x + a, y + b)));
    g.closePath();
  };
  const MARKS = [
    (g, x, y) => g.arc(x, y, 3.2, 0, 7),
    polygon([-3, -3], [3, -3], [3, 3], [-3, 3]),
    polygon([0, -4.2], [4, 3], [-4, 3]),
    polygon([0, -4.6], [4.6, 0], [0, 4.6], [-4.6, 0]),
    polygon([0, 4.2], [4, -3], [-4, -3]),
    polygon([-1.3, -4.2], [1.3, -4.2], [1.3, -1.3], [4.2, -1.3], [4.2, 1.3], [1.3, 1.3], [1.3, 4.2],
      [-1.3, 4.2], [-1.3, 1.3], [-4.2, 1.3], [-4.2, -1.3], [-1.3, -1.3]),
  ];

  function mark(g, k, x, y, open = false) {
    g.beginPath();
    MARKS[k % MARKS.length](g, x, y);
    if (open) {
      g.save();
      g.fillStyle = "#fff";
      g.fill();
      g.restore();
      g.stroke();
    } else g.fill();
  }

  const colour = (k, style) => (style === "reference" ? INK : COLOURS[k % COLOURS.length]);

  function viridis(share) {
    const at = Math.min(1, Math.max(0, share)) * (VIRIDIS.length - 1);
    const k = Math.min(Math.floor(at), VIRIDIS.length - 2), rest = at - k;
    const mixed = VIRIDIS[k].map((v, i) => Math.round(v + rest * (VIRIDIS[k + 1][i] - v)));
    return `rgb(${mixed.join(",")})`;
  }

  function make(name, parent, kind = "") {
    const element = document.createElement(name);
    if (kind) element.className = kind;
    parent.appendChild(element);
    return element;
  }

  function pen(canvas, width, height) { // of a canvas in pixels of the page, crisp in print
    const ratio = Math.max(2, window.devicePixelRatio || 1);
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const g = canvas.getContext("2d");
    g.scale(ratio, ratio);
    g.font = FONT;
    g.lineJoin = "round";
    return g;
  }

  // --- one figure ----------------------------------------------------------------------------------

  class Plot {
    constructor(figure, data) {
      const caption = figure.querySelector("figcaption");
      const title = document.createElement("h3");
      title.textContent = data.title;
      const grid = document.createElement("div");
      grid.className = "panels";
      grid.style.gridTemplateColumns = `repeat(${data.columns}, minmax(0, 1fr))`;
      figure.insertBefore(title, caption);
      figure.insertBefore(grid, caption);
      this.shared = data.columns === 1; // one x axis for all panels
      if (data.columns > 1) figure.style.gridColumn = "1 / -1";
      this.panels = data.panels.map((p) => this.prepare(p, grid, data));
      const ranges = this.panels.map((p) => this.whole(p));
      const span = this.panels.map((p) => p.span).find((s) => s);
      this.panels.forEach((p, k) => {
        p.all = !this.shared ? ranges[k] : span ? transformed(p.log_x, span) : union(ranges);
        p.range = p.all;
      });
      new ResizeObserver(() => this.draw()).observe(figure);
    }

    prepare(p, grid, data) {
      const box = make("div", grid);
      p.legend = make("div", box, "legend");
      p.canvas = make("canvas", box);
      p.canvas.style.aspectRatio = data.columns > 1 ? "1.35" : data.panels.length > 1 ? "2.6" : "1.75";
      p.canvas.setAttribute("role", "img");
      p.canvas.setAttribute("aria-label", [data.title, p.y, p.x].filter(Boolean).join(", "));
      p.last = !this.shared || p === data.panels[data.panels.length - 1];
      p.rangeY = null; // chosen by the pointer
      for (const c of p.curves) {
        c.x = transformed(p.log_x, numbers(c.x));
        c.y = transformed(p.log_y, numbers(c.y));
        c.ascending = c.x.every((v, i) => i === 0 || v >= c.x[i - 1]);
        if (p.curves.length > 1 || c.label) this.name(p, c);
      }
      if (p.map) for (const key of ["x", "y", "z"]) p.map[key] = numbers(p.map[key]);
      this.listen(p);
      return p;
    }

    name(p, c) { // in the legend
      const button = make("button", p.legend), sample = make("canvas", button);
      const k = p.curves.indexOf(c), g = pen(sample, 34, 12);
      this.stroke(g, c, k, [[1, 6], [33, 6]], () => [17]);
      if (c.style === "bar") g.fillRect(8, 1, 18, 10);
      make("span", button).textContent = c.label;
      button.setAttribute("type", "button");
      button.setAttribute("aria-pressed", "true");
      button.addEventListener("click", () => {
        c.hidden = !c.hidden;
        button.setAttribute("aria-pressed", String(!c.hidden));
        this.draw();
      });
    }

    whole(p) { // range of x
      if (p.map) return union([this.edges(transformed(p.log_x, p.map.x))].map((e) => [e[0], e[e.length - 1]]));
      return union(p.curves.map((c) => {
        const [low, high] = extent(c.x);
        const half = c.style === "bar" && c.x.length > 1 ? (high - low) / (c.x.length - 1) / 2 : 0;
        return [low - half, high + half];
      }));
    }

    edges(centres) { // of the cells of a map
      const n = centres.length;
      if (n === 1) return [centres[0] - 0.5, centres[0] + 0.5];
      const inner = Array.from({length: n - 1}, (_, k) => (centres[k] + centres[k + 1]) / 2);
      return [2 * centres[0] - inner[0], ...inner, 2 * centres[n - 1] - inner[n - 2]];
    }

    // --- the pointer ---

    listen(p) {
      const at = (e) => [e.offsetX, e.offsetY];
      const others = () => (this.shared ? this.panels : [p]);
      p.canvas.addEventListener("pointerdown", (e) => { this.from = at(e); });
      p.canvas.addEventListener("pointermove", (e) => {
        others().forEach((o) => { o.pointer = p.toX ? p.toX(e.offsetX) : null; });
        this.at = {panel: p, place: at(e)};
        this.draw();
      });
      p.canvas.addEventListener("pointerup", (e) => {
        if (this.from) this.zoom(p, others(), this.from, at(e));
        this.from = null;
        this.draw();
      });
      p.canvas.addEventListener("pointerleave", () => {
        others().forEach((o) => { o.pointer = null; });
        this.from = this.at = null;
        this.draw();
      });
      p.canvas.addEventListener("dblclick", () => {
        others().forEach((o) => { o.range = o.all; o.rangeY = null; });
        this.draw();
      });
    }

    zoom(p, others, [x0, y0], [x1, y1]) {
      const wide = Math.abs(x1 - x0) > 5, high = Math.abs(y1 - y0) > 25;
      if (!wide) return;
      const ends = [p.toX(x0), p.toX(x1)].sort((a, b) => a - b);
      if (high) p.rangeY = [p.toY(y0), p.toY(y1)].sort((a, b) => a - b);
      others.forEach((o) => { o.range = ends; });
    }

    // --- drawing ---

    draw() {
      this.panels.forEach((p) => this.panel(p));
    }

    panel(p) {
      const width = p.canvas.clientWidth, height = p.canvas.clientHeight;
      if (!width) return;
      const g = pen(p.canvas, width, height);
      const right = width - (p.map ? BAR : RIGHT), low = height - (p.last ? BOTTOM : 14);
      const across = right - LEFT, up = low - TOP;
      let [x0, x1] = p.range, [y0, y1] = p.rangeY || this.rangeY(p);
      if (p.equal) {
        const scale = Math.max((x1 - x0) / across, (y1 - y0) / up); // data in a pixel
        [x0, x1] = stretched([x0, x1], scale * across);
        [y0, y1] = stretched([y0, y1], scale * up);
      }
      const X = (v) => LEFT + ((v - x0) * across) / (x1 - x0);
      const Y = (v) => low - ((v - y0) * up) / (y1 - y0);
      p.toX = (px) => x0 + (Math.min(right, Math.max(LEFT, px)) - LEFT) * (x1 - x0) / across;
      p.toY = (py) => y0 + (low - Math.min(low, Math.max(TOP, py))) * (y1 - y0) / up;
      const area = {g, p, X, Y, x0, x1, y0, y1, right, low, across, up};
      this.axes(area);
      g.save();
      g.beginPath();
      g.rect(LEFT, TOP, across, up);
      g.clip();
      if (p.map) this.cells(area);
      this.lines(area);
      p.curves.forEach((c, k) => { if (!c.hidden) this.curve(area, c, k); });
      this.dragged(area);
      g.restore();
      if (p.map) this.colourBar(area);
      this.readout(area);
    }

    rangeY(p) {
      if (p.map) {
        const edges = this.edges(transformed(p.log_y, p.map.y));
        return [edges[0], edges[edges.length - 1]];
      }
      const [x0, x1] = p.range, whole = p.range === p.all;
      const ranges = p.curves.filter((c) => !c.hidden).map((c) => {
        const found = extent(c.y, (i) => c.x[i] >= x0 && c.x[i] <= x1);
        return c.style === "bar" ? [Math.min(0, found[0]), found[1]] : found;
      });
      if (whole) {
        const more = [...p.levels.map((l) => l[0]), ...p.bands.flatMap((b) => [b[0], b[1]])];
        ranges.push(extent(transformed(p.log_y, more)));
      }
      return wider(union(ranges), 0.06);
    }

    axes({g, p, X, Y, x0, x1, y0, y1, right, low, across, up}) {
      const ticksOf = (log, a, b, n) => (log ? logTicks : linearTicks)(a, b, Math.max(2, n));
      const xs = ticksOf(p.log_x, x0, x1, Math.floor(across / 80));
      const ys = ticksOf(p.log_y, y0, y1, Math.min(7, Math.floor(up / 34)));
      const line = (a, b, c, d, look) => {
        g.strokeStyle = look;
        g.beginPath();
        g.moveTo(a, b);
        g.lineTo(c, d);
        g.stroke();
      };
      g.lineWidth = 1;
      for (const v of xs.minor) line(X(v), TOP, X(v), low, FAINT);
      for (const v of ys.minor) line(LEFT, Y(v), right, Y(v), FAINT);
      for (const {at} of xs.ticks) line(X(at), TOP, X(at), low, GRID);
      for (const {at} of ys.ticks) line(LEFT, Y(at), right, Y(at), GRID);
      line(LEFT, TOP, LEFT, low, SOFT);
      line(LEFT, low, right, low, SOFT);
      g.fillStyle = SOFT;
      g.textAlign = "center";
      if (p.last) for (const {at, text} of xs.ticks) g.fillText(text, X(at), low + 16);
      g.textAlign = "right";
      for (const {at, text} of ys.ticks) g.fillText(text, LEFT - 7, Y(at) + 4);
      if (p.last && xs.note) g.fillText(xs.note, right, low + 31);
      g.textAlign = "left";
      if (ys.note) g.fillText(ys.note, LEFT + 4, TOP - 5);
      g.fillStyle = INK;
      g.textAlign = "center";
      if (p.last) g.fillText(p.x, LEFT + across / 2, low + 34);
      g.save();
      g.translate(13, TOP + up / 2);
      g.rotate(-Math.PI / 2);
      g.fillText(this.cut(g, p.y, up + 24), 0, 0);
      g.restore();
    }

    cut(g, text, length) { // what fits
      if (g.measureText(text).width <= length) return text;
      let kept = text;
      while (kept && g.measureText(`${kept}…`).width > length) kept = kept.slice(0, -1);
      return `${kept}…`;
    }

    note(g, text, x, y) { // on a white rim, over whatever is there
      if (!text) return;
      g.textAlign = "left";
      g.lineWidth = 3;
      g.strokeStyle = "rgba(255,255,255,.85)";
      g.strokeText(text, x, y);
      g.fillStyle = SOFT;
      g.fillText(text, x, y);
    }

    lines({g, p, X, Y, right, low, across}) { // bands, levels and marks
      const high = (v) => Y(p.log_y ? Math.log10(v) : v);
      for (const [a, b, label] of p.bands) {
        g.fillStyle = "rgba(0,158,115,.14)";
        g.fillRect(LEFT, high(b), across, high(a) - high(b));
        this.note(g, label, LEFT + 6, high(b) - 4);
      }
      for (const [v, label] of p.levels) {
        g.strokeStyle = "#7d868e";
        g.lineWidth = 1.2;
        g.setLineDash([8, 3, 2, 3]);
        g.beginPath();
        g.moveTo(LEFT, high(v));
        g.lineTo(right, high(v));
        g.stroke();
        g.setLineDash([]);
        this.note(g, label, LEFT + 6, high(v) - 4);
      }
      for (const [v, label] of p.marks) {
        const x = X(p.log_x ? Math.log10(v) : v);
        g.strokeStyle = "#009E73";
        g.lineWidth = 1.2;
        g.beginPath();
        g.moveTo(x, TOP);
        g.lineTo(x, low);
        g.stroke();
        this.note(g, label, x + 4, TOP + 12);
      }
    }

    curve(area, c, k) {
      const {g, p, X, Y, x0, x1, low} = area;
      const points = Array.from(c.x, (v, i) => [X(v), Y(c.y[i])]);
      if (c.style === "bar") {
        const wide = c.x.length > 1 ? Math.abs(points[1][0] - points[0][0]) : 40;
        g.fillStyle = colour(k, c.style);
        const foot = p.log_y ? low : Y(0);
        for (const [x, y] of points) {
          if (Number.isFinite(y)) g.fillRect(x - 0.45 * wide, Math.min(y, foot), 0.9 * wide, Math.abs(foot - y));
        }
        return;
      }
      const sparse = () => { // where a line gets its marks
        const places = [];
        for (let x = LEFT + 0.35 * MARK_STEP + (k * MARK_STEP) / 6; x < area.right; x += MARK_STEP) places.push(x);
        return places;
      };
      this.stroke(g, c, k, points, p.curves.length > 1 && x0 < x1 ? sparse : () => []);
    }

    stroke(g, c, k, points, places) { // the line through pixels, marks at some places on it
      g.strokeStyle = g.fillStyle = colour(k, c.style);
      g.lineWidth = 1.8;
      if (c.style === "o") {
        g.globalAlpha = points.length > 300 ? 0.45 : 1;
        points.forEach(([x, y]) => { if (Number.isFinite(y)) mark(g, k, x, y); });
        g.globalAlpha = 1;
        return;
      }
      g.setLineDash(DASHES[c.style] || []);
      g.beginPath();
      let open = false, before = 0;
      for (const [x, y] of points) {
        if (Number.isFinite(x) && Number.isFinite(y)) {
          if (open && c.style === "step") g.lineTo(x, before);
          if (open) g.lineTo(x, y);
          else g.moveTo(x, y);
          open = true;
          before = y;
        } else open = false;
      }
      g.stroke();
      g.setLineDash([]);
      g.lineWidth = 1.4;
      if (c.style === "o-") points.forEach(([x, y]) => { if (Number.isFinite(y)) mark(g, k, x, y); });
      else if (k > 0 && c.style === "-" && c.ascending !== false) {
        for (const x of places()) {
          const y = this.between(points, x);
          if (Number.isFinite(y)) mark(g, k - 1, x, y, true);
        }
      }
    }

    between(points, x) { // y of the line through ascending points
      let low = 0, high = points.length - 1;
      if (high < 1 || x < points[0][0] || x > points[high][0]) return NaN;
      while (high - low > 1) {
        const middle = (low + high) >> 1;
        if (points[middle][0] <= x) low = middle;
        else high = middle;
      }
      const [[a, ya], [b, yb]] = [points[low], points[high]];
      return b > a ? ya + ((yb - ya) * (x - a)) / (b - a) : ya;
    }

    cells({g, p, X, Y}) {
      const x = this.edges(transformed(p.log_x, p.map.x)).map(X);
      const y = this.edges(transformed(p.log_y, p.map.y)).map(Y);
      const [low, high] = union([extent(p.map.z)]), columns = x.length - 1;
      p.map.z.forEach((z, k) => {
        const i = k % columns, j = Math.floor(k / columns);
        g.fillStyle = Number.isFinite(z) ? viridis((z - low) / (high - low)) : "#d8d8d8";
        g.fillRect(x[i], y[j + 1], x[i + 1] - x[i] + 0.6, y[j] - y[j + 1] + 0.6);
      });
    }

    colourBar({g, p, right, low, up}) {
      const [a, b] = union([extent(p.map.z)]), x = right + 12;
      for (let k = 0; k < up; k++) {
        g.fillStyle = viridis(k / up);
        g.fillRect(x, low - k - 1, 12, 1.6);
      }
      const {ticks, note} = linearTicks(a, b, 5);
      g.fillStyle = SOFT;
      g.textAlign = "left";
      for (const {at, text} of ticks) g.fillText(text, x + 16, low - (up * (at - a)) / (b - a) + 4);
      if (note) g.fillText(note, x, TOP - 5);
      g.fillStyle = INK;
      g.textAlign = "center";
      g.save();
      g.translate(x + 66, TOP + up / 2);
      g.rotate(-Math.PI / 2);
      g.fillText(this.cut(g, p.map.label, up + 24), 0, 0);
      g.restore();
    }

    // --- what the pointer shows ---

    dragged({g, p, low, up}) {
      if (!this.from || !this.at || this.at.panel !== p && !this.shared) return;
      const [x0, y0] = this.from, [x1, y1] = this.at.place;
      const box = this.at.panel === p && Math.abs(y1 - y0) > 25;
      g.fillStyle = "rgba(0,114,178,.13)";
      g.fillRect(x0, box ? y0 : TOP, x1 - x0, box ? y1 - y0 : low - TOP || up);
    }

    read(area, c) { // the point of a curve at the pointer: {x, y} in the axes' numbers, or null
      const {p, X, Y} = area, x = p.pointer;
      const free = !c.ascending || c.style === "o";
      if (free && (!this.at || this.at.panel !== p)) return null;
      let best = -1, least = free ? 20 : SNAP;
      for (let i = 0; i < c.x.length; i++) {
        if (!Number.isFinite(c.y[i])) continue;
        const [px, py] = [X(c.x[i]), Y(c.y[i])];
        const away = free ? Math.hypot(px - this.at.place[0], py - this.at.place[1]) : Math.abs(px - X(x));
        if (away < least) [least, best] = [away, i];
      }
      if (best >= 0) return {x: c.x[best], y: c.y[best], name: c.names[best]};
      if (free || c.style === "bar") return null;
      const y = this.between(Array.from(c.x, (v, i) => [v, c.y[i]]), x);
      return Number.isFinite(y) ? {x, y} : null;
    }

    readout(area) {
      const {g, p, X, Y, right, low} = area;
      if (p.pointer === null || p.pointer === undefined || this.from) return;
      const number = (log, v, label) => words(plain(log, v)) + unit(label);
      const rows = [];
      let x = p.pointer;
      p.curves.forEach((c, k) => {
        const found = c.hidden ? null : this.read(area, c);
        if (!found) return;
        if (!rows.length) x = found.x;
        rows.push([colour(k, c.style), [found.name || c.label, number(p.log_y, found.y, p.y)].filter(Boolean).join("  ")]);
        g.fillStyle = colour(k, c.style);
        g.beginPath();
        g.arc(X(found.x), Y(found.y), 3.5, 0, 7);
        g.fill();
      });
      if (p.map && this.at && this.at.panel === p) rows.push(...this.cell(area));
      rows.unshift([INK, number(p.log_x, x, this.panels[this.panels.length - 1].x || p.x)]);
      g.strokeStyle = "#9aa3ab";
      g.lineWidth = 1;
      g.beginPath();
      g.moveTo(X(x), TOP);
      g.lineTo(X(x), low);
      g.stroke();
      const wide = Math.max(...rows.map(([, text]) => g.measureText(text).width)) + 16;
      const left = X(x) + wide + 14 < right ? X(x) + 10 : Math.max(LEFT, X(x) - wide - 10);
      g.fillStyle = "rgba(255,255,255,.93)";
      g.strokeStyle = "#c3cad1";
      g.beginPath();
      g.rect(left, TOP + 4, wide, 17 * rows.length + 6);
      g.fill();
      g.stroke();
      g.textAlign = "left";
      rows.forEach(([look, text], k) => {
        g.fillStyle = look;
        g.fillText(text, left + 8, TOP + 20 + 17 * k);
      });
    }

    cell({p}) { // of the map under the pointer
      const near = (values, v) => values.reduce((best, w, k) => (Math.abs(w - v) < Math.abs(values[best] - v) ? k : best), 0);
      const i = near(transformed(p.log_x, p.map.x), p.pointer);
      const j = near(transformed(p.log_y, p.map.y), p.toY(this.at.place[1]));
      const z = p.map.z[j * p.map.x.length + i];
      return [
        [INK, words(p.map.y[j]) + unit(p.y)],
        [INK, `${p.map.label}: ${Number.isFinite(z) ? words(z) : "none"}`],
      ];
    }
  }

  for (const figure of document.querySelectorAll("figure[data-plot]")) {
    new Plot(figure, JSON.parse(figure.querySelector("script").textContent));
  }
})();
