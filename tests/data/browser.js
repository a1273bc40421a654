// The few parts of a browser that the report's script uses; records what it draws as JSON.
const fs = require("fs"), vm = require("vm");
const page = fs.readFileSync(process.argv[2], "utf8");
const found = {panels: 0, strokes: 0, images: 0, labels: [], observers: []};
let texts = [];

class Element {
  constructor(name) {
    Object.assign(this, {name, style: {}, children: [], listeners: {}, textContent: ""});
    this.clientWidth = 500; this.clientHeight = 250;
  }
  appendChild(child) { this.children.push(child); return child; }
  insertBefore(child, before) {
    if (!this.children.includes(before)) throw new Error("no such child");
    this.children.splice(this.children.indexOf(before), 0, child);
  }
  querySelector(name) {
    const element = this.children.find((child) => child.name === name);
    if (element) element.remove = () => this.children.splice(this.children.indexOf(element), 1);
    return element;
  }
  addEventListener(kind, call) { this.listeners[kind] = call; }
  getContext() {
    return new Proxy({}, {get: (own, key) => own[key] ?? ((...words) => {
      if (key === "stroke") found.strokes++;
      if (key === "fillText") texts.push(words[0]);
      if (words.some((w) => typeof w === "number" && Number.isNaN(w))) throw new Error(`NaN: ${key}`);
    }), set: (own, key, value) => { own[key] = value; return true; }});
  }
}

const figures = [...page.matchAll(/<figure data-plot>\s*<script type="application\/json">(.*?)<\/script>/gs)]
  .map((match) => {
    const figure = new Element("figure");
    for (const name of ["script", "img", "figcaption"]) figure.appendChild(new Element(name));
    figure.children[0].textContent = match[1];
    return figure;
  });
const script = [...page.matchAll(/<script>(.*?)<\/script>/gs)].map((match) => match[1]).join("\n");
vm.runInNewContext(script, {
  document: {querySelectorAll: () => figures, createElement: (name) => new Element(name)},
  ResizeObserver: class { constructor(call) { this.call = call; } observe() { found.observers.push(this.call); } },
  atob: (text) => Buffer.from(text, "base64").toString("binary"), devicePixelRatio: 2,
  Uint8Array, Float32Array,
});
found.observers.forEach((call) => call());
const canvases = figures.flatMap((f) => f.children.filter((c) => c.name === "canvas"));
const legends = figures.flatMap((f) => f.children.filter((c) => c.className === "legend"));
found.panels = canvases.length;
found.images = figures.flatMap((f) => f.children).filter((c) => c.name === "img").length;
found.labels = legends[0].children.map((span) => span.textContent);

const wide = () => {  // the largest number on the x axis of the first panel's last drawing
  texts = [];
  canvases[0].listeners.pointermove({offsetX: 480});
  return Math.max(...texts.filter((t) => /^-?[\d.]+$/.test(t)).map(Number));
};
found.whole = wide();
found.read = legends[0].children[0].textContent;
canvases[0].listeners.pointerdown({offsetX: 64});
canvases[0].listeners.pointermove({offsetX: 200});
canvases[0].listeners.pointerup({offsetX: 260});
found.zoomed = wide();
canvases[0].listeners.dblclick();
found.reset = wide();
delete found.observers;
console.log(JSON.stringify(found));
