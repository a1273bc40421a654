// What tests/gallery/test_pages.py asks of the charts of a page.
window.probe = (() => {
  const later = () => new Promise((done) => setTimeout(done));
  const chart = (k) => kc2spiceCharts[k];
  const pen = document.createElement("canvas").getContext("2d", {willReadFrequently: true});
  function area(u, left, top, width, height) { // pixels of a copy, which the browser may keep slow
    [pen.canvas.width, pen.canvas.height] = [width, height];
    pen.drawImage(u.ctx.canvas, -Math.round(left), -Math.round(top));
    return pen.getImageData(0, 0, width, height).data;
  }
  const pixels = (u) => area(u, u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
  const rgb = (ink) => (ink.length < 7 ? [...ink.slice(1)].map((c) => 17 * parseInt(c, 16))
    : [1, 3, 5].map((i) => parseInt(ink.slice(i, i + 2), 16)));

  async function count() { // pixels of each curve's colour while all others are hidden
    const counts = [];
    for (const u of kc2spiceCharts) {
      for (let k = 1; k < u.series.length; k++) {
        for (let j = 1; j < u.series.length; j++) u.setSeries(j, {show: j === k});
        await later();
        const colour = rgb(u.series[k].stroke(u, k)), seen = pixels(u);
        let found = 0;
        for (let i = 0; i < seen.length; i += 4) {
          if (colour.every((v, c) => Math.abs(v - seen[i + c]) < 40) && seen[i + 3] > 90) found++;
        }
        counts.push([u.series[k].label, found]);
      }
      for (let j = 1; j < u.series.length; j++) u.setSeries(j, {show: true});
    }
    await later();
    return counts;
  }

  const brightness = (of) => getComputedStyle(document.body)[of].match(/\d+/g).slice(0, 3)
    .reduce((sum, v) => sum + Number(v), 0);

  return {
    count,
    curves: () => kc2spiceCharts.map((u) => u.series.slice(1).map((s) => s.label)),
    opaque: () => kc2spiceCharts.map((u) => pixels(u).filter((v, i) => i % 4 === 3 && v > 200).length),
    ranges: (k) => ["x", "y"].map((key) => [chart(k).scales[key].min, chart(k).scales[key].max]),
    readings: (k) => chart(k).legend.values.map((row) => row._),
    values: (k, s) => [...chart(k).data[s]],
    shown: () => kc2spiceCharts.find((u) => u.series.length > 1).series[1].show,
    texts: (k) => chart(k).axes.map((a) => a._values.filter(Boolean)),
    brightness: () => [brightness("color"), brightness("backgroundColor")],
    zoom: (k, min, max) => chart(k).setScale("x", {min, max}),
    filled(k, y) { // share of the columns that have ink at this height
      const u = chart(k), {left, width} = u.bbox, at = Math.round(u.valToPos(y, "y", true));
      const row = area(u, left + 2, at, width - 4, 1);
      return row.filter((v, i) => i % 4 === 3 && v > 60).length / (width - 4);
    },
    colour(k, x, y) {
      const u = chart(k), place = [u.valToPos(x, "x", true), u.valToPos(y, "y", true)];
      return [...area(u, ...place, 1, 1)].slice(0, 3);
    },
  };
})();
