// Draws the curves of every figure: moving the pointer reads values, dragging shows a part of x,
// a double click shows all. Without scripts the picture stays.
"use strict";
(() => {
  const COLOURS = ["#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#222222"];
  const LEFT = 64, RIGHT = 12, TOP = 10, BOTTOM = 36, DASHES = {":": [2, 4], "--": [6, 4]};
  const numbers = (text) =>
    new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const short = (v) => {
    const text = String(Number(v.toPrecision(4)));
    return text.length > 6 ? v.toExponential(3).replace(/\.?0*e\+?/, "e") : text;
  };

  function ticks(low, high, log) {
    if (log) {
      const found = [];
      for (let d = Math.ceil(low - 1e-9); d <= high + 1e-9; d++) found.push(d);
      if (found.length > 2) return found;
      for (let d = Math.floor(low); d <= high; d++) {
        for (const k of [2, 5]) if (d + Math.log10(k) > low && d + Math.log10(k) < high) found.push(d + Math.log10(k));
      }
      if (found.length > 1) return found;
    }
    const raw = (high - low) / 6, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find((k) => k * power >= raw);
    const found = [];
    for (let v = Math.ceil(low / step); v * step <= high * (1 + 1e-12); v++) found.push(v * step);
    return found;
  }

  function extent(values, keep) {
    let low = Infinity, high = -Infinity;
    values.forEach((v, i) => {
      if (Number.isFinite(v) && keep(i)) { low = Math.min(low, v); high = Math.max(high, v); }
    });
    return [low, high];
  }

  function join(ranges) {
    let low = Math.min(...ranges.map((r) => r[0])), high = Math.max(...ranges.map((r) => r[1]));
    if (!(low <= high)) return [0, 1];
    if (low === high) { low -= Math.abs(low) || 1; high += Math.abs(high) || 1; }
    return [low, high];
  }

  class Plot {
    constructor(figure, data) {
      this.panels = data.panels;
      const logged = (log, values) => (log ? values.map((v) => Math.log10(v)) : values);
      for (const p of this.panels) {
        for (const c of p.curves) {
          c.x = logged(p.log_x, numbers(c.x)); c.y = logged(p.log_y, numbers(c.y));
        }
        p.canvas = document.createElement("canvas");
        p.canvas.style.cssText = "width:100%;touch-action:pan-y;cursor:crosshair";
        p.canvas.style.aspectRatio = this.panels.length > 1 ? "2.6" : "1.75";
        p.legend = document.createElement("div");
        p.legend.className = "legend";
        figure.insertBefore(p.canvas, figure.querySelector("figcaption"));
        figure.insertBefore(p.legend, p.canvas);
        p.names = p.curves.map((c, k) => {
          const span = p.legend.appendChild(document.createElement("span"));
          span.style.color = COLOURS[k % COLOURS.length];
          return span;
        });
        this.listen(p);
      }
      const first = this.panels[0];
      const span = this.panels.map((p) => p.span).find((s) => s);
      this.all = span ? logged(first.log_x, span)
        : join(this.panels.flatMap((p) => p.curves.map((c) => extent(c.x, () => true))));
      this.range = this.all;
      figure.querySelector("img").remove();
      new ResizeObserver(() => this.draw()).observe(figure);
      this.read(null);
    }

    place(p, event) {  // of the pointer on the x axis
      const width = p.canvas.clientWidth - LEFT - RIGHT;
      const share = (event.offsetX - LEFT) / width;
      return this.range[0] + Math.min(1, Math.max(0, share)) * (this.range[1] - this.range[0]);
    }

    listen(p) {
      let start = null;
      p.canvas.addEventListener("pointerdown", (e) => { start = this.place(p, e); });
      p.canvas.addEventListener("pointermove", (e) => {
        this.pointer = this.place(p, e); this.from = start; this.draw(); this.read(this.pointer);
      });
      p.canvas.addEventListener("pointerup", (e) => {
        const ends = [start, this.place(p, e)].sort((a, b) => a - b);
        const moved = ends[1] - ends[0] > 0.01 * (this.range[1] - this.range[0]);
        if (start !== null && moved) this.range = ends;
        start = this.from = null; this.draw();
      });
      p.canvas.addEventListener("pointerleave", () => {
        start = this.from = this.pointer = null; this.draw(); this.read(null);
      });
      p.canvas.addEventListener("dblclick", () => { this.range = this.all; this.draw(); });
    }

    read(x) {
      for (const p of this.panels) {
        p.curves.forEach((c, k) => {
          let best = -1;
          if (x !== null) {
            c.x.forEach((v, i) => {
              if (best < 0 || Math.abs(v - x) < Math.abs(c.x[best] - x)) best = i;
            });
          }
          const y = best < 0 ? "" : short(p.log_y ? 10 ** c.y[best] : c.y[best]);
          const at = best < 0 || k ? "" : ` at ${short(p.log_x ? 10 ** c.x[best] : c.x[best])}`;
          p.names[k].textContent = [c.label, y + at].filter(Boolean).join("  ") || "\u00a0";
        });
      }
    }

    draw() {
      this.panels.forEach((p) => this.panel(p));
    }

    panel(p) {
      const [width, height] = [p.canvas.clientWidth, p.canvas.clientHeight];
      if (!width) return;
      p.canvas.width = width * devicePixelRatio; p.canvas.height = height * devicePixelRatio;
      const g = p.canvas.getContext("2d");
      g.scale(devicePixelRatio, devicePixelRatio);
      g.font = "12px system-ui, 'DejaVu Sans', sans-serif";
      const whole = this.range === this.all, [x0, x1] = this.range;
      const inside = (c) => (i) => c.x[i] >= x0 && c.x[i] <= x1;
      let [y0, y1] = join(p.curves.map((c) => extent(c.y, inside(c))));
      if (whole) {
        const at = (v) => (p.log_y ? Math.log10(v) : v);
        const more = [...p.levels.map((l) => l[0]), ...p.bands.flatMap((b) => b.slice(0, 2))];
        [y0, y1] = join([[y0, y1], ...more.map((v) => [at(v), at(v)])]);
      }
      const pad = 0.05 * (y1 - y0);
      y0 -= pad; y1 += pad;
      const across = width - LEFT - RIGHT, up = height - TOP - BOTTOM;
      let [kx, ky] = [across / (x1 - x0), up / (y1 - y0)];
      if (p.equal) kx = ky = Math.min(kx, ky);
      const X = (v) => LEFT + (v - x0) * kx, Y = (v) => height - BOTTOM - (v - y0) * ky;
      g.strokeStyle = "#E3E3E3"; g.fillStyle = "#555"; g.lineWidth = 1;
      g.textAlign = "center";
      for (const v of ticks(x0, x1, p.log_x)) {
        g.beginPath(); g.moveTo(X(v), TOP); g.lineTo(X(v), height - BOTTOM); g.stroke();
        g.fillText(short(p.log_x ? 10 ** v : v), X(v), height - BOTTOM + 15);
      }
      g.textAlign = "right";
      for (const v of ticks(y0, y1, p.log_y)) {
        g.beginPath(); g.moveTo(LEFT, Y(v)); g.lineTo(width - RIGHT, Y(v)); g.stroke();
        g.fillText(short(p.log_y ? 10 ** v : v), LEFT - 6, Y(v) + 4);
      }
      g.fillStyle = "#222"; g.textAlign = "center";
      g.fillText(p.x, LEFT + across / 2, height - 4);
      g.save(); g.translate(12, TOP + up / 2); g.rotate(-Math.PI / 2); g.fillText(p.y, 0, 0); g.restore();
      g.save();
      g.beginPath(); g.rect(LEFT, TOP, across, up); g.clip();
      const line = (points, colour, dashes) => {
        g.strokeStyle = colour; g.setLineDash(dashes || []); g.beginPath();
        let open = false;
        for (const [a, b] of points) {
          if (Number.isFinite(a) && Number.isFinite(b)) {
            if (open) g.lineTo(X(a), Y(b)); else g.moveTo(X(a), Y(b));
            open = true;
          } else open = false;
        }
        g.stroke(); g.setLineDash([]);
      };
      const note = (text, x, y) => { g.fillStyle = "#555"; g.textAlign = "left"; g.fillText(text, x, y); };
      const logy = (v) => (p.log_y ? Math.log10(v) : v);
      for (const [a, b, label] of p.bands) {
        g.fillStyle = "rgba(0,158,115,.15)"; g.fillRect(LEFT, Y(logy(b)), across, Y(logy(a)) - Y(logy(b)));
        note(label, LEFT + 6, Y(logy(b)) - 4);
      }
      for (const [v, label] of p.levels) {
        line([[x0, logy(v)], [x1, logy(v)]], "#8A8A8A", [2, 3]); note(label, LEFT + 6, Y(logy(v)) - 4);
      }
      for (const [v, label] of p.marks) {
        const x = p.log_x ? Math.log10(v) : v;
        line([[x, y0], [x, y1]], "#009E73"); note(label, X(x) + 4, TOP + 12);
      }
      g.lineWidth = 1.6;
      p.curves.forEach((c, k) => {
        const colour = COLOURS[k % COLOURS.length];
        if (c.style === "o") {
          g.fillStyle = colour;
          c.x.forEach((v, i) => { g.beginPath(); g.arc(X(v), Y(c.y[i]), 3, 0, 7); g.fill(); });
        } else line([...c.x].map((v, i) => [v, c.y[i]]), colour, DASHES[c.style]);
      });
      g.lineWidth = 1;
      if (this.pointer !== null && this.pointer !== undefined) {
        line([[this.pointer, y0], [this.pointer, y1]], "#8A8A8A");
        if (this.from !== null && this.from !== undefined) {
          g.fillStyle = "rgba(0,114,178,.12)"; g.fillRect(X(this.from), TOP, X(this.pointer) - X(this.from), up);
        }
      }
      g.restore();
    }
  }

  for (const figure of document.querySelectorAll("figure[data-plot]")) {
    new Plot(figure, JSON.parse(figure.querySelector("script").textContent));
  }
})();
