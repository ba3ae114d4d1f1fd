"use strict";
// Draws every chart of the page from the numbers that stand in it. Charts of one group share cursor, zoom and switched-off designs.
(() => {
  const groups = new Map(); // group -> {charts: Set of uPlot, hidden: Set of labels}
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const digits = (v) => (v == null ? "" : Number(v.toPrecision(4)).toString());

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

  function options(spec, view, width) {
    const axis = (label, size) => ({
      label, size, labelSize: 22, stroke: css("--ink"), font: "12px system-ui", labelFont: "12px system-ui",
      grid: { stroke: css("--line"), width: 1 }, ticks: { stroke: css("--line"), width: 1 },
    });
    const log = (on) => (on ? { distr: 3, log: 10 } : {});
    const series = [{ label: spec.x_label, value: (u, v) => digits(v) }];
    const bands = [];
    for (const s of view.series) {
      series.push({
        label: s.label, of: s.of, stroke: s.colour, width: s.width, dash: s.dash ? [6, 4] : undefined, spanGaps: true,
        points: { show: s.points, size: 6, fill: s.colour, stroke: s.colour }, paths: s.points ? () => null : undefined,
        value: (u, v) => digits(v), show: ![s.label, s.of].some((l) => groups.get(spec.group).hidden.has(l)),
      });
      if (s.fill_to != null) bands.push({ series: [view.series.length && series.length - 1, s.fill_to + 1], fill: s.colour + "33" });
    }
    return {
      width, height: Math.round(Math.max(240, Math.min(360, width * 0.45))), series, bands,
      scales: { x: { time: false, ...log(spec.log_x) }, y: log(view.log_y) },
      axes: [axis(spec.x_label, 44), axis(view.y_label, 62)],
      cursor: { sync: { key: spec.group, setSeries: false }, drag: { x: true, y: false }, points: { size: 6 } },
      legend: { live: true },
      hooks: {
        drawClear: [shade(spec.spans)],
        setSeries: [(u, index, opts) => { if (index != null && opts.show != null) spread(spec.group, u, u.series[index].label, opts.show); }],
      },
    };
  }

  let spreading = false;
  function spread(group, origin, label, show) { // a design that is switched off in one chart is switched off in all of its group
    if (spreading) return;
    spreading = true;
    const g = groups.get(group);
    show ? g.hidden.delete(label) : g.hidden.add(label);
    for (const u of g.charts) { // what belongs to it (bounds) goes with it
      u.series.forEach((s, i) => { if (i && (s.label === label || s.of === label) && s.show !== show) u.setSeries(i, { show }); });
    }
    spreading = false;
  }

  function download(spec, view) {
    const quote = (text) => '"' + text.replace(/"/g, '""') + '"';
    const rows = [[spec.x_label, ...view.series.map((s) => s.label)].map(quote).join(",")];
    spec.x.forEach((x, i) => rows.push([x, ...view.series.map((s) => s.y[i] ?? "")].join(",")));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([rows.join("\n") + "\n"], { type: "text/csv" }));
    link.download = (view.name || spec.name).replace(/[^\w-]+/g, "_") + ".csv";
    link.click();
    URL.revokeObjectURL(link.href);
  }

  function chart(holder) {
    const spec = JSON.parse(holder.querySelector("script[type='application/json']").textContent);
    if (!groups.has(spec.group)) groups.set(spec.group, { charts: new Set(), hidden: new Set() });
    const plot = holder.querySelector(".plot");
    const bar = holder.querySelector(".bar");
    let view = spec.views[0];
    let u = null;
    const draw = () => {
      if (u) { groups.get(spec.group).charts.delete(u); u.destroy(); }
      u = new uPlot(options(spec, view, plot.clientWidth), [spec.x, ...view.series.map((s) => s.y)], plot);
      groups.get(spec.group).charts.add(u);
      // the legend switches series: as buttons for the keyboard
      plot.querySelectorAll(".u-legend .u-series > th").forEach((th, i) => {
        if (!i) return;
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
    button("Whole range", () => draw());
    button("Data (CSV)", () => download(spec, view));
    plot.tabIndex = 0;
    plot.setAttribute("role", "img");
    plot.setAttribute("aria-label", spec.name + ". " + spec.caption);
    plot.onkeydown = (e) => { // arrow keys move the cursor from value to value
      const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10 }[e.key];
      if (!step || e.target !== plot) return;
      e.preventDefault();
      const i = Math.max(0, Math.min(spec.x.length - 1, (u.cursor.idx ?? 0) + step));
      u.setCursor({ left: u.valToPos(spec.x[i], "x"), top: u.bbox.height / 2 / devicePixelRatio });
    };
    draw();
    let width = plot.clientWidth;
    new ResizeObserver(() => { if (plot.clientWidth && plot.clientWidth !== width) { width = plot.clientWidth; draw(); } }).observe(plot);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  }
  document.querySelectorAll(".chart").forEach(chart);
})();
