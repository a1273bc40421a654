// The few parts of a browser that the report's script uses; records what it draws as JSON.
const fs = require("fs"), vm = require("vm");
const page = fs.readFileSync(process.argv[2], "utf8");
const found = {panels: 0, strokes: 0, fills: 0};
let texts = [];
const observers = [];

class Element {
  constructor(name) {
    Object.assign(this, {name, style: {}, children: [], listeners: {}, attributes: {}});
    Object.assign(this, {className: "", textContent: "", clientWidth: 500, clientHeight: 250});
  }
  appendChild(child) { this.children.push(child); return child; }
  insertBefore(child, before) {
    if (!this.children.includes(before)) throw new Error("no such child");
    this.children.splice(this.children.indexOf(before), 0, child);
  }
  querySelector(name) { return this.children.find((child) => child.name === name) ?? null; }
  addEventListener(kind, call) { this.listeners[kind] = call; }
  setAttribute(key, value) { this.attributes[key] = value; }
  all(test) { return [...this.children.filter(test), ...this.children.flatMap((c) => c.all(test))]; }
  getContext() {
    return new Proxy({}, {get: (own, key) => own[key] ?? ((...words) => {
      if (key === "stroke") found.strokes++;
      if (key === "fillRect") found.fills++;
      if (key === "fillText") texts.push(words[0]);
      if (words.some((w) => typeof w === "number" && !Number.isFinite(w))) throw new Error(`${words}: ${key}`);
      if (key === "measureText") return {width: 6 * words[0].length};
    }), set: (own, key, value) => { own[key] = value; return true; }});
  }
}

const figures = [...page.matchAll(/<figure data-plot><script type="application\/json">(.*?)<\/script>/gs)]
  .map((match) => {
    const figure = new Element("figure");
    for (const name of ["script", "figcaption"]) figure.appendChild(new Element(name));
    figure.children[0].textContent = match[1];
    return figure;
  });
const script = [...page.matchAll(/<script>(.*?)<\/script>/gs)].map((match) => match[1]).join("\n");
vm.runInNewContext(script, {
  document: {querySelectorAll: () => figures, createElement: (name) => new Element(name)},
  ResizeObserver: class { constructor(call) { this.call = call; } observe() { observers.push(this.call); } },
  atob: (text) => Buffer.from(text, "base64").toString("binary"), window: {devicePixelRatio: 1},
  Uint8Array, Float32Array,
});
const drawn = () => { texts = []; observers.forEach((call) => call()); return texts; };
found.texts = drawn();
const canvases = figures.flatMap((f) => f.all((c) => c.attributes.role === "img"));
const buttons = figures.flatMap((f) => f.all((c) => c.name === "button"));
found.panels = canvases.length;
found.titles = figures.map((f) => f.querySelector("h3").textContent);
found.labels = buttons.map((b) => b.querySelector("span").textContent);
found.spoken = canvases.map((c) => c.attributes["aria-label"]);

const moved = (place) => { texts = []; canvases[0].listeners.pointermove({offsetX: place, offsetY: 100}); return texts; };
const widest = () => {  // the largest number that the first figure shows
  texts = [];
  observers[0]();
  const numbers = texts.filter((t) => /^−?[\d.]+$/.test(t)).map((t) => Number(t.replace("−", "-")));
  return Math.max(...numbers);
};
found.read = moved(480);
canvases[0].listeners.pointerleave();
found.whole = widest();
canvases[0].listeners.pointerdown({offsetX: 64, offsetY: 100});
canvases[0].listeners.pointermove({offsetX: 200, offsetY: 100});
canvases[0].listeners.pointerup({offsetX: 260, offsetY: 100});
canvases[0].listeners.pointerleave();
found.zoomed = widest();
canvases[0].listeners.dblclick();
found.reset = widest();
if (buttons.length) {
  const before = [found.strokes, drawn(), found.strokes];
  buttons[0].listeners.click();
  const after = [found.strokes, drawn(), found.strokes];
  found.hidden = before[2] - before[0] - (after[2] - after[0]);
}
console.log(JSON.stringify(found));
