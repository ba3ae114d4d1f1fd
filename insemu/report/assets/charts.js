"use strict";
// Draws every chart of the page from the numbers that stand in it. Charts of one group share cursor, zoom and switched-off designs.
(() => {
  const groups = new Map(); // group -> {charts: Set of uPlot over a common x, planes: Set, hidden: Set of labels}
  const all = new Set(); // functions that draw a chart again
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const digits = (v) => (v == null ? "" : Number(v.toPrecision(4)).toString());
  const tick = (v) => { // what stands on an axis
    if (v == null || v === 0) return v == null ? "" : "0";
    const size = Math.abs(v);
    return size < 1e-3 || size >= 1e6 ? v.toExponential().replace(/(\.\d\d)\d*/, "$1").replace("e+", "e") : Number(v.toPrecision(6)).toLocaleString("en", { maximumSignificantDigits: 6 });
  };
  const metres = (v) => (v == null ? "" : Number(v.toPrecision(6)).toString());

  const dark = matchMedia("(prefers-color-scheme: dark)");
  const tone = (colour) => { // on a dark page the colours of lines are lighter
    if (!dark.matches || document.documentElement.classList.contains("printing")) return colour;
    return "#" + [1, 3, 5].map((i) => Math.round(0.62 * parseInt(colour.slice(i, i + 2), 16) + 0.38 * 255).toString(16).padStart(2, "0")).join("");
  };

  function shade(spans) { // outages, behind everything else
    return (u) => {
      const { ctx, bbox } = u;
      ctx.save();
      ctx.fillStyle = css("--shade");
      for (const [from, to] of spans) {
        const left = Math.max(u.valToPos(from, "x", true), bbox.left);
        const right = Math.min(u.valToPos(to, "x", true), bbox.left + bbox.width);
        if (right > left) ctx.fillRect(left, bbox.top, right - left, bbox.height);
      }
      ctx.restore();
    };
  }

  // words in the chart
  const words = (labels) => (u) => {
    const { ctx } = u, px = devicePixelRatio;
    ctx.save();
    ctx.fillStyle = css("--ink");
    ctx.font = `600 ${12 * px}px system-ui`;
    ctx.textAlign = "left";
    ctx.textBaseline = "bottom";
    for (const [x, y, text] of labels) ctx.fillText(text, u.valToPos(x, "x", true) + 5 * px, u.valToPos(y, "y", true) - 5 * px);
    ctx.restore();
  };

  function options(spec, view, width) {
    const paper = document.documentElement.classList.contains("printing"), font = `${paper ? 10 : 12}px system-ui`;
    const axis = (label, size) => ({
      label, size, labelSize: 22, values: (u, splits) => splits.map(tick), stroke: css("--ink"), font, labelFont: font,
      grid: { stroke: css("--line"), width: 1 }, ticks: { stroke: css("--line"), width: 1 },
    });
    const log = (on) => (on ? { distr: 3, log: 10 } : {});
    const series = [{ label: spec.x_label, value: (u, v) => digits(v) }];
    const bands = [];
    const upper = new Map(); // line -> the line up to which the space above it is filled: one interval, told together
    view.series.forEach((s, k) => { if (s.fill_to != null && s.of) upper.set(s.fill_to, k); });
    view.series.forEach((s, k) => {
      const told = (u, v, i, at) => digits(v) + (upper.has(k) && at != null && v != null ? " to " + digits(u.data[upper.get(k) + 1][at]) : "");
      series.push({
        label: s.label, of: s.of, stroke: tone(s.colour), width: s.width, dash: s.dash ? [6, 4] : undefined, spanGaps: !s.points,
        points: { show: s.points, size: 3 + s.width, fill: tone(s.colour), stroke: tone(s.colour) }, paths: s.points ? () => null : undefined,
        value: told, show: ![s.label, s.of].some((l) => groups.get(spec.group).hidden.has(l)),
      });
      if (s.fill_to != null) bands.push({ series: [series.length - 1, s.fill_to + 1], fill: tone(s.colour) + "33" });
    });
    const across = axis(spec.x_label, 44);
    if (view.ticks.length) {
      across.splits = () => view.ticks.map((t) => t[0]);
      const words = view.ticks.map((t) => t[1]), lines = words.flatMap((w) => w.split("\n"));
      const rotated = Math.max(...lines.map((w) => w.length)) * 7 > (width - 90) / words.length; // they would overlap
      across.values = () => rotated ? words.map((w) => w.replace("\n", " ")) : words;
      if (rotated) { across.rotate = -60; across.size = 30 + 6 * Math.max(...words.map((w) => w.length)); }
      else across.size = 30 + 14 * Math.max(...words.map((w) => w.split("\n").length));
      across.grid = { show: false };
    }
    const height = paper ? 190 : Math.max(240, Math.min(360, width * 0.45));
    return {
      width, height: Math.round(spec.equal ? height * 1.3 : height), series, bands,
      scales: { x: { time: false, ...log(spec.log_x) }, y: log(view.log_y) },
      axes: [across, axis(view.y_label, 62)],
      cursor: { sync: { key: spec.group, setSeries: false }, drag: { x: true, y: false }, points: { size: 6 } },
      legend: { live: true },
      hooks: {
        drawClear: [shade(spec.spans)],
        draw: [words(view.labels)],
        setSeries: [(u, index, opts) => { if (index != null && opts.show != null) spread(spec.group, u, u.series[index].label, opts.show); }],
        setCursor: [(u) => { if (u.cursor.idx != null) for (const p of groups.get(spec.group).planes) p.at(u.data[0][u.cursor.idx]); }],
      },
    };
  }

  let spreading = false;
  function spread(group, origin, label, show) { // a design that is switched off in one chart is switched off in all of its group
    if (spreading) return;
    spreading = true;
    const g = groups.get(group);
    show ? g.hidden.delete(label) : g.hidden.add(label);
    for (const u of [...g.charts, ...[...g.planes].map((p) => p.u)]) { // what belongs to it (bounds) goes with it
      u.series.forEach((s, i) => { if (i && (s.label === label || s.of === label) && s.show !== show) u.setSeries(i, { show }); });
    }
    spreading = false;
  }

  // A chart in a plane (a map, bars): every line has its own x. uPlot gives axes, zoom and legend; the lines are drawn here.
  function plane(spec, view, holder, readout) {
    const lines = view.series;
    const finite = (v) => v != null;
    const reach = (key, log) => {
      let low = Infinity, high = -Infinity;
      for (const s of lines) for (const v of s[key]) if (finite(v) && (!log || v > 0)) { low = Math.min(low, v); high = Math.max(high, v); }
      if (log) return uPlot.rangeLog(low, high, 10, true);
      if (key === "x" && view.ticks.length) return [view.ticks[0][0] - 0.6, view.ticks[view.ticks.length - 1][0] + 0.6];
      const rim = 0.05 * (high - low) || 0.5 * Math.abs(high) || 1;
      return [low - rim, high + rim];
    };
    let u;
    const fit = ([x0, x1], [y0, y1]) => { // the same scale in both directions: the shorter one is widened
      if (!spec.equal || !u) return [[x0, x1], [y0, y1]];
      const per = Math.max((x1 - x0) / u.bbox.width, (y1 - y0) / u.bbox.height);
      const wide = (a, b, n) => [(a + b - per * n) / 2, (a + b + per * n) / 2];
      return [wide(x0, x1, u.bbox.width), wide(y0, y1, u.bbox.height)];
    };
    const show = (x, y) => { [x, y] = fit(x, y); u.batch(() => { u.setScale("x", { min: x[0], max: x[1] }); u.setScale("y", { min: y[0], max: y[1] }); }); };
    const whole = () => show(reach("x", spec.log_x), reach("y", view.log_y));
    const mark = document.createElement("div");
    mark.className = "mark";
    mark.hidden = true;
    const put = (x, y) => { mark.hidden = false; mark.style.left = u.valToPos(x, "x") + "px"; mark.style.top = u.valToPos(y, "y") + "px"; };
    const draw = () => {
      const { ctx, bbox } = u, px = devicePixelRatio;
      ctx.save();
      ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
      lines.forEach((s, k) => {
        if (!u.series[k + 1].show) return;
        ctx.strokeStyle = ctx.fillStyle = tone(s.colour);
        ctx.lineWidth = s.width * px;
        ctx.setLineDash(s.dash ? [6 * px, 4 * px] : []);
        ctx.beginPath();
        let down = false;
        s.x.forEach((x, i) => {
          if (!finite(x) || !finite(s.y[i])) { down = false; return; }
          const a = u.valToPos(x, "x", true), b = u.valToPos(s.y[i], "y", true);
          if (s.points) { ctx.moveTo(a, b); ctx.arc(a, b, (1 + s.width / 2) * px, 0, 7); } else if (down) ctx.lineTo(a, b); else ctx.moveTo(a, b);
          down = true;
        });
        s.points ? ctx.fill() : ctx.stroke();
      });
      ctx.restore();
    };
    const say = (k, i) => {
      const s = lines[k];
      put(s.x[i], s.y[i]);
      const time = s.t && finite(s.t[i]) ? `, at ${digits(s.t[i])} min` : "";
      readout.textContent = s.text ? `${s.label}: ${s.text[i]}` : `${s.label}: ${metres(s.x[i])}, ${metres(s.y[i])}${time}`;
      return s.t ? s.t[i] : null;
    };
    const near = () => { // the line under the pointer: nearest segment, then its nearer end
      const { left, top } = u.cursor;
      if (left == null || left < 0) return;
      let best = 40 * 40, at = null;
      lines.forEach((s, k) => {
        if (!u.series[k + 1].show) return;
        let pa = null, pb = null;
        const half = s.points ? 0 : s.width / 2;
        s.x.forEach((x, i) => {
          if (!finite(x) || !finite(s.y[i])) { pa = null; return; }
          const a = u.valToPos(x, "x"), b = u.valToPos(s.y[i], "y");
          let d = (a - left) ** 2 + (b - top) ** 2, j = i;
          if (pa != null && !s.points) {
            const dx = a - pa, dy = b - pb, n = dx * dx + dy * dy;
            const f = n ? Math.max(0, Math.min(1, ((left - pa) * dx + (top - pb) * dy) / n)) : 0;
            d = Math.max(0, Math.hypot(pa + f * dx - left, pb + f * dy - top) - half) ** 2;
            j = f < 0.5 ? i - 1 : i;
          }
          if (d < best) { best = d; at = [k, j]; }
          pa = a; pb = b;
        });
      });
      if (!at) { mark.hidden = true; return; }
      const t = say(...at);
      if (t != null) for (const c of groups.get(spec.group).charts) c.setCursor({ left: c.valToPos(t, "x"), top: 10 }, false);
    };
    const base = options(spec, view, holder.clientWidth);
    base.cursor = { drag: { x: true, y: true, setScale: false }, points: { show: false } };
    base.legend = { live: false };
    base.scales = { x: { ...base.scales.x, auto: false }, y: { ...base.scales.y, auto: false } };
    base.hooks.draw.unshift(draw);
    base.hooks.setCursor = [near];
    base.hooks.setSelect = [(c) => {
      const { left, top, width, height } = c.select;
      if (width < 4 || height < 4) return;
      const x = [c.posToVal(left, "x"), c.posToVal(left + width, "x")], y = [c.posToVal(top + height, "y"), c.posToVal(top, "y")];
      c.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
      show(x, y);
    }];
    for (const s of base.series) { s.paths = () => null; s.points = { show: false }; }
    const ends = reach("x", spec.log_x);
    u = new uPlot(base, [ends, ...lines.map(() => [null, null])], holder);
    u.over.append(mark);
    u.over.ondblclick = whole;
    whole();
    let step = 0;
    return {
      u, whole,
      at(t) { // the time under the cursor of another chart
        const k = lines.findIndex((s, i) => s.t && u.series[i + 1].show);
        if (k < 0) return;
        let i = lines[k].t.findIndex((v) => v >= t);
        if (i >= 0 && finite(lines[k].x[i])) put(lines[k].x[i], lines[k].y[i]);
      },
      move(by) {
        const k = lines.findIndex((s, i) => u.series[i + 1].show);
        if (k < 0) return;
        step = Math.max(0, Math.min(lines[k].x.length - 1, step + by));
        if (finite(lines[k].x[step]) && finite(lines[k].y[step])) say(k, step);
      },
    };
  }

  function save(name, blob) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = name.replace(/[^\w.-]+/g, "_");
    link.click();
    URL.revokeObjectURL(link.href);
  }
  const quote = (text) => '"' + String(text).replace(/"/g, '""') + '"';

  function table(spec, view) { // the numbers of a view as CSV
    const rows = [];
    if (view.x) {
      rows.push([spec.x_label, ...view.series.map((s) => s.label)].map(quote).join(","));
      view.x.forEach((x, i) => rows.push([x, ...view.series.map((s) => s.y[i] ?? "")].join(",")));
    } else {
      rows.push(["line", spec.x_label, view.y_label, "said"].map(quote).join(","));
      for (const s of view.series) s.x.forEach((x, i) => rows.push([quote(s.label), x ?? "", s.y[i] ?? "", quote(s.text?.[i] ?? "")].join(",")));
    }
    return new Blob([rows.join("\n") + "\n"], { type: "text/csv" });
  }

  const told = (holder) => JSON.parse(holder.querySelector("script[type='application/json']").textContent);

  function chart(holder, spec) { // returns what takes it away again
    if (!groups.has(spec.group)) groups.set(spec.group, { charts: new Set(), planes: new Set(), hidden: new Set() });
    const group = groups.get(spec.group);
    const plot = holder.querySelector(".plot");
    const bar = holder.querySelector(".bar");
    const readout = document.createElement("p");
    readout.className = "readout";
    readout.setAttribute("aria-live", "polite");
    if (!spec.views[0].x) plot.after(readout);
    let view = spec.views[0], u = null, flat = null, width = 0;
    const draw = () => {
      if (!plot.clientWidth) return; // folded: drawn when it is opened
      if (u) { group.charts.delete(u); group.planes.delete(flat); u.destroy(); flat = null; }
      width = plot.clientWidth;
      if (view.x) {
        u = new uPlot(options(spec, view, width), [view.x, ...view.series.map((s) => s.y)], plot);
        group.charts.add(u);
      } else {
        flat = plane(spec, view, plot, readout);
        u = flat.u;
        group.planes.add(flat);
      }
      // the legend switches series: as buttons for the keyboard
      const names = plot.querySelectorAll(".u-legend .u-series > th");
      names.forEach((th, i) => {
        const line = view.series[i - (names.length - view.series.length)]; // a row of the x may stand in front
        if (!line) return;
        if (line.of && (!view.x || line.fill_to != null)) th.parentElement.hidden = true; // its name stands there already
        th.tabIndex = 0;
        th.setAttribute("role", "button");
        th.onkeydown = (e) => { if (e.key === "Enter" || e.key === " ") { e.preventDefault(); th.click(); } };
      });
    };
    const button = (text, action) => {
      const b = document.createElement("button");
      b.type = "button";
      b.textContent = text;
      b.onclick = action;
      bar.append(b);
    };
    if (spec.views.length > 1) {
      const label = document.createElement("label");
      const select = document.createElement("select");
      label.append("Show ", select);
      spec.views.forEach((v, i) => select.append(new Option(v.name, i)));
      select.onchange = () => { view = spec.views[select.value]; draw(); };
      bar.append(label);
    }
    button("Whole range", draw);
    button("Data (CSV)", () => save((view.name || spec.name) + ".csv", table(spec, view)));
    button("Picture (PNG)", () => plot.querySelector("canvas").toBlob((blob) => save(spec.name + ".png", blob)));
    plot.tabIndex = 0;
    plot.setAttribute("role", "img");
    plot.setAttribute("aria-label", `${spec.name}. ${spec.caption} ${spec.said}`);
    plot.onkeydown = (e) => { // arrow keys move the cursor from value to value
      const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10 }[e.key];
      if (!step || e.target !== plot) return;
      e.preventDefault();
      if (flat) { flat.move(step); return; }
      const i = Math.max(0, Math.min(view.x.length - 1, (u.cursor.idx ?? 0) + step));
      u.setCursor({ left: u.valToPos(view.x[i], "x"), top: u.bbox.height / 2 / devicePixelRatio });
    };
    draw();
    const watch = new ResizeObserver(() => { if (plot.clientWidth !== width) draw(); });
    watch.observe(plot);
    all.add(draw);
    return () => { watch.disconnect(); all.delete(draw); group.charts.delete(u); group.planes.delete(flat); if (u) u.destroy(); holder.remove(); };
  }
  document.querySelectorAll(".chart").forEach((holder) => chart(holder, told(holder)));

  const again = () => all.forEach((draw) => draw());
  dark.addEventListener("change", again);
  const printing = (on) => () => { document.documentElement.classList.toggle("printing", on); again(); };
  addEventListener("beforeprint", printing(true));
  addEventListener("afterprint", printing(false));

  document.querySelectorAll(".scroll").forEach((holder) => { // every table as CSV
    const b = document.createElement("button");
    b.type = "button";
    b.textContent = "Table (CSV)";
    const rows = () => [...holder.querySelectorAll("tr")].map((r) => [...r.cells].map((c) => quote(c.textContent)).join(","));
    b.onclick = () => save((holder.previousElementSibling?.textContent || "table").slice(0, 40) + ".csv", new Blob([rows().join("\n") + "\n"], { type: "text/csv" }));
    const bar = document.createElement("div");
    bar.className = "bar no-print";
    bar.append(b);
    holder.after(bar);
  });

  const PAGE = 25; // rows of a long table at a time
  function ledger(holder) { // a long table: sorted, filtered, and the chart of a row that is chosen
    const { header, left, rows, chart: shared, charts, of } = told(holder);
    const make = (tag, parent, set = {}) => { const e = Object.assign(document.createElement(tag), set); parent.append(e); return e; };
    const bar = make("div", holder, { className: "bar no-print" });
    const label = make("label", bar, { textContent: "Rows with " });
    const asked = make("input", label, { type: "search", size: 16 });
    const number = (text) => { const v = parseFloat(text); return Number.isNaN(v) ? null : v; };
    let order = rows.map((_, i) => i), first = 0, sorted = null, down = false, away = null, chosen = null;
    const before = make("button", bar, { type: "button", textContent: "Before", onclick: () => { first -= PAGE; draw(); } });
    const after = make("button", bar, { type: "button", textContent: "Next", onclick: () => { first += PAGE; draw(); } });
    const said = make("span", bar);
    said.setAttribute("aria-live", "polite");
    make("button", bar, { type: "button", textContent: "Table (CSV)", onclick: () => save("outages.csv",
      new Blob([[header, ...order.map((i) => rows[i])].map((r) => r.map(quote).join(",")).join("\n") + "\n"], { type: "text/csv" })) });
    const scroll = make("div", holder, { className: header.length > 11 ? "scroll dense" : "scroll", tabIndex: 0 });
    const table = make("table", scroll), head = make("tr", make("thead", table)), body = make("tbody", table);
    const side = (k) => (k < left ? "left" : "");
    const heads = header.map((name, k) => {
      const th = make("th", head, { className: side(k), scope: "col" });
      make("button", th, { type: "button", className: "plain", textContent: name, onclick: () => { down = sorted === k && !down; sorted = k; arrange(); } });
      return th;
    });
    const arrange = () => {
      const word = asked.value.trim().toLowerCase();
      order = rows.map((_, i) => i).filter((i) => !word || rows[i].some((c) => c.toLowerCase().includes(word)));
      if (sorted != null) {
        const by = (a, b) => {
          const [x, y] = [rows[a][sorted], rows[b][sorted]], [m, n] = [number(x), number(y)];
          if (m == null || n == null) return m != null ? -1 : n != null ? 1 : (down ? -1 : 1) * x.localeCompare(y);
          return (down ? -1 : 1) * (m - n);
        };
        order.sort(by);
      }
      heads.forEach((th, k) => th.setAttribute("aria-sort", k !== sorted ? "none" : down ? "descending" : "ascending"));
      first = 0;
      draw();
    };
    const show = (i) => {
      chosen = i;
      if (away) away();
      const [name, spans, x, ...y] = charts[of[i]];
      const view = { ...shared.views[0], name, x, series: shared.views[0].series.map((s, k) => ({ ...s, y: y[k] })) };
      const figure = make("figure", holder, { className: "chart" });
      make("div", figure, { className: "bar no-print" });
      make("div", figure, { className: "plot" });
      make("figcaption", figure, { textContent: `${name}. ${shared.caption}` });
      away = chart(figure, { ...shared, name, spans, views: [view], said: "" });
      draw();
    };
    const draw = () => {
      body.replaceChildren();
      for (const i of order.slice(first, first + PAGE)) {
        const tr = make("tr", body, { className: i === chosen ? "strong" : "" });
        rows[i].forEach((cell, k) => {
          const td = make("td", tr, { className: side(k) });
          if (k === left - 1 && charts) make("button", td, { type: "button", className: "plain", textContent: cell, onclick: () => show(i) });
          else td.textContent = cell;
        });
      }
      before.disabled = first === 0;
      after.disabled = first + PAGE >= order.length;
      said.textContent = order.length ? `${first + 1} to ${Math.min(first + PAGE, order.length)} of ${order.length}` : "no row";
    };
    asked.oninput = arrange;
    arrange();
    if (charts) show(order[0]);
  }
  document.querySelectorAll(".ledger").forEach(ledger);
})();
