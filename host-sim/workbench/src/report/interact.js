// Hover shows the values under the pointer; a drag zooms along x, a double click shows all.
for (const svg of document.querySelectorAll("svg[data-area]")) {
  const data = JSON.parse(svg.querySelector("desc").textContent);
  const [left, right, top, bottom] = svg.dataset.area.split(" ").map(Number);
  const whole = svg.dataset.range.split(" ").map(Number);
  let [x0, x1, y0, y1] = whole, from = null;
  const make = (name, attributes, parent) => {
    const node = document.createElementNS(svg.namespaceURI, name);
    for (const key in attributes) node.setAttribute(key, attributes[key]);
    return parent.appendChild(node);
  };
  const layer = make("g", {}, svg), mark = make("g", {"pointer-events": "none"}, svg);
  const px = x => left + (x - x0) / (x1 - x0) * (right - left);
  const py = y => bottom - (y - y0) / (y1 - y0) * (bottom - top);
  const short = (v, span) => v.toFixed(Math.min(6, Math.max(0, Math.ceil(1.5 - Math.log10(span)))));
  const text = (x, y, words, anchor) => {
    const node = make("text", {x, y, "text-anchor": anchor, "font-size": 33, fill: "var(--quiet)", "font-family": "sans-serif"}, layer);
    node.textContent = words;
  };
  const draw = () => {
    layer.replaceChildren();
    const zoomed = x0 !== whole[0] || x1 !== whole[1];
    svg.classList.toggle("zoomed", zoomed);
    if (!zoomed) return;
    make("rect", {x: 0, y: top - 4, width: right + 99, height: 9999, fill: "var(--card)"}, layer);
    for (let k = 0; k <= 4; k++) {
      const x = x0 + (x1 - x0) * k / 4, y = y0 + (y1 - y0) * k / 4;
      make("path", {d: `M${px(x)} ${top}V${bottom}M${left} ${py(y)}H${right}`, stroke: "var(--grid)", "stroke-width": 3}, layer);
      text(px(x), bottom + 40, short(x, x1 - x0), "middle");
      text(left - 12, py(y) + 11, short(y, y1 - y0), "end");
    }
    for (const {c, w, x, y} of data) {
      const points = [], add = (u, v) => points.push(px(u) + "," + py(Math.min(y1, Math.max(y0, v))));
      for (let k = 0; k < x.length; k++) {
        // The curve enters and leaves the window between two points.
        for (const rim of [x0, x1])
          if (k > 0 && (x[k - 1] - rim) * (x[k] - rim) < 0) add(rim, y[k - 1] + (y[k] - y[k - 1]) * (rim - x[k - 1]) / (x[k] - x[k - 1]));
        if (x[k] >= x0 && x[k] <= x1) add(x[k], y[k]);
      }
      make("polyline", {points: points.join(" "), fill: "none", stroke: `var(${c})`, "stroke-width": w}, layer);
    }
  };
  const at = event => {
    const box = svg.getBoundingClientRect(), view = svg.viewBox.baseVal;
    const x = (event.clientX - box.left) / box.width * view.width;
    return Math.min(right, Math.max(left, x));
  };
  const value = x => x0 + (x - left) / (right - left) * (x1 - x0);
  svg.addEventListener("pointermove", event => {
    const here = at(event), x = value(here);
    mark.replaceChildren();
    if (from !== null) make("rect", {x: Math.min(from, here), y: top, width: Math.abs(here - from), height: bottom - top, fill: "var(--after)", opacity: .15}, mark);
    make("path", {d: `M${here} ${top}V${bottom}`, stroke: "var(--axis)", "stroke-width": 3}, mark);
    let line = short(x, x1 - x0);
    for (const curve of data) {
      let a = 0, b = curve.x.length - 1;
      while (b - a > 1) { const m = (a + b) >> 1; curve.x[m] <= x ? a = m : b = m; }
      const near = x - curve.x[a] < curve.x[b] - x ? a : b, y = curve.y[near];
      if (y === undefined) continue;
      make("circle", {cx: px(curve.x[near]), cy: py(y), r: 9, fill: `var(${curve.c})`}, mark);
      line += "\u2003" + y.toPrecision(4);
    }
    const words = make("text", {x: right, y: top - 8, "text-anchor": "end", "font-size": 33, fill: "var(--text)", "font-family": "sans-serif"}, mark);
    words.textContent = line;
  });
  svg.addEventListener("pointerleave", () => { mark.replaceChildren(); from = null; });
  svg.addEventListener("pointerdown", event => { from = at(event); event.preventDefault(); });
  svg.addEventListener("pointerup", event => {
    const to = at(event), ends = [value(Math.min(from ?? to, to)), value(Math.max(from ?? to, to))];
    if (from !== null && Math.abs(to - from) > 15) {
      [x0, x1] = ends;
      const seen = data.flatMap(({x, y}) => y.filter((_, k) => x[k] >= x0 && x[k] <= x1));
      if (seen.length) { const low = Math.min(...seen), high = Math.max(...seen), rim = (high - low) * .06 || 1e-9; y0 = low - rim; y1 = high + rim; }
      draw();
    }
    from = null;
  });
  svg.addEventListener("dblclick", () => { [x0, x1, y0, y1] = whole; draw(); });
}
