"use strict";
(async () => {
  const root = document.documentElement;
  const all = (selector, inside = document) => [...inside.querySelectorAll(selector)];
  const variable = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const translucent = (colour, share) => colour + Math.round(255 * share).toString(16).padStart(2, "0");
  const escaped = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;").replace(/%\{/g, "%&#123;");

  async function unpacked(id) {
    const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (character) => character.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  }

  async function loadNumbers() {
    const script = document.createElement("script");
    script.textContent = await unpacked("plotly");
    document.head.append(script);
    return JSON.parse(await unpacked("numbers"));
  }

  let tasks;
  try {
    tasks = await loadNumbers();
  } catch (error) {
    for (const plot of all(".plot")) plot.textContent = "This browser cannot unpack the plots; please use a newer one.";
    throw error;
  }

  function visibility(section) {
    const checked = (box) => [box.dataset.show, box.checked];
    const hidden = all(".chip[aria-pressed=false]", section).map((chip) => chip.dataset.line);
    return { ...Object.fromEntries(all("[data-show]", section).map(checked)), hidden: new Set(hidden) };
  }

  function bandTrace(x, part, base) {
    return {
      ...base, x: [...x, ...[...x].reverse()], y: [...part.high, ...[...part.low].reverse()],
      fill: "toself", mode: "lines", line: { width: 0 }, fillcolor: translucent(base.line.color, 0.16), hoverinfo: "skip",
    };
  }

  function drawn(y, size) {  // a line does not show a point between gaps
    const missing = (i) => y[i] == null;
    const sizes = y.map((_, i) => (!missing(i) && missing(i - 1) && missing(i + 1) ? size : 0));
    return sizes.some(Boolean) ? { mode: "lines+markers", marker: { size: sizes } } : { mode: "lines" };
  }

  function seedsTrace(x, part, base) {
    const gaps = (rows) => rows.flatMap((row) => [...row, null]), y = gaps(part.each);
    return {
      ...base, x: gaps(part.each.map(() => x)), y, ...drawn(y, 5), opacity: 0.5,
      line: { color: base.line.color, width: 0.8 }, hoverinfo: "skip",
    };
  }

  function publishedTraces(curve, edge, base) {
    const { final: [value, low, high, text], crossings } = curve.published;
    const traces = [{
      ...base, x: [edge], y: [value], mode: "markers", cliponaxis: false,
      marker: { symbol: "line-ew-open", size: 16, color: base.line.color, line: { width: 3, color: base.line.color } },
      hovertemplate: `${base.name}, published: ${escaped(text)}<br>95 %: ${low.toPrecision(3)} to ${high.toPrecision(3)}<extra></extra>`,
    }];
    if (crossings.length) {
      traces.push({
        ...base, x: crossings.map((pair) => pair[0]), y: crossings.map((pair) => pair[1]), mode: "markers",
        marker: { symbol: "x", size: 8, color: base.line.color, line: { width: 1, color: variable("--paper") } },
        hovertemplate: `${base.name}, published: %{y} at %{x:,} steps<extra></extra>`,
      });
    }
    return traces;
  }

  function meanTrace(x, part, base, digits) {
    const spread = part.low ? `<br>95 % of the mean: %{customdata[0]:.${digits}~g} to %{customdata[1]:.${digits}~g}` : "";
    return {
      ...base, x, y: part.mean, ...drawn(part.mean, 7),
      customdata: part.low ? part.low.map((low, i) => [low, part.high[i]]) : undefined,
      hovertemplate: `<b>${base.name}</b> %{y:.${digits}~g} at %{x:,}${spread}<extra></extra>`,
    };
  }

  function curvePlot(panel, show) {
    const visible = panel.lines.filter((curve) => !show.hidden.has(curve.line));
    const longest = Math.max(...panel.lines.map((curve) => curve.x[curve.x.length - 1]));
    const below = [], above = [];
    for (const curve of visible) {
      const part = (show.smooth && curve.smooth) || curve.plain;
      const base = { type: "scatter", name: escaped(curve.label), line: { color: variable(`--${curve.line}`), dash: curve.dash, width: 2 } };
      const named = (kind, trace) => ({ ...trace, uid: `${curve.line}-${kind}` });
      if (show.band && part.low) below.push(named("band", bandTrace(curve.x, part, base)));
      if (show.each) below.push(named("each", seedsTrace(curve.x, part, base)));
      above.push(named("mean", meanTrace(curve.x, part, base, panel.digits)));
      if (show.published && curve.published) {
        publishedTraces(curve, 1.035 * longest, base).forEach((trace, i) => above.push(named(`published${i}`, trace)));
      }
    }
    const wide = show.published && panel.lines.some((curve) => curve.published);
    const layout = baseLayout();
    Object.assign(layout.xaxis, { range: [0, (wide ? 1.06 : 1.01) * longest], tickformat: "~s", title: { text: "steps of a seed" } });
    const highest = Math.max(...panel.lines.flatMap((curve) => curve.plain.mean));
    layout.yaxis.tickformat = highest >= 1000 ? "~s" : "~g";
    if (panel.range) layout.yaxis.range = panel.range;
    else layout.yaxis.rangemode = "tozero";
    return [[...below, ...above], layout];
  }

  function baseLayout() {
    const ink = variable("--soft"), grid = variable("--hair"), sans = variable("--sans");
    const axis = { gridcolor: grid, linecolor: grid, zerolinecolor: grid, automargin: true, nticks: 6, fixedrange: coarse };
    return {
      font: { family: sans, size: 12, color: ink },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", margin: { l: 44, r: 14, t: 8, b: 40 },
      showlegend: false, hovermode: "closest", dragmode: coarse ? false : "zoom", uirevision: "kept",
      hoverlabel: { bgcolor: variable("--paper"), bordercolor: variable("--line"), font: { family: sans, color: variable("--ink"), size: 12 }, align: "left" },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: variable("--line"), activecolor: ink },
      xaxis: { ...axis }, yaxis: { ...axis },
    };
  }

  function mapPlot(visits) {
    const [[left, bottom], [right, top]] = visits.bounds;
    const bins = visits.shares.length;
    const centres = (low, high) => Array.from({ length: bins }, (_, i) => low + ((i + 0.5) * (high - low)) / bins);
    const trace = {
      type: "heatmap", x: centres(left, right), y: centres(bottom, top), showscale: false, colorscale: "Viridis", hoverongaps: false,
      z: visits.shares.map((row) => row.map((share) => (share === null ? null : Math.log10(share)))), customdata: visits.shares,
      zmin: Math.log10(visits.ends[0]), zmax: Math.log10(visits.ends[1] > visits.ends[0] ? visits.ends[1] : 10 * visits.ends[0]),
      hovertemplate: `x %{x:.2f}, y %{y:.2f} ${escaped(visits.unit)}<br>%{customdata:.2%} of visits<extra></extra>`,
    };
    const layout = baseLayout();
    Object.assign(layout.xaxis, { range: [left, right], constrain: "domain", showgrid: false, title: { text: `x, ${escaped(visits.unit)}` } });
    Object.assign(layout.yaxis, { range: [bottom, top], scaleanchor: "x", constrain: "domain", showgrid: false, title: { text: "y" } });
    return [[trace], layout];
  }

  const coarse = matchMedia("(pointer: coarse)").matches;
  // An explicit list of buttons: plotly's default has one that sends the plot to a server.
  const config = {
    responsive: true, displaylogo: false, displayModeBar: coarse ? false : "hover", plotlyServerURL: "",
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]],
  };

  function draw(plot) {
    const section = plot.closest("[data-task]"), task = tasks[section.dataset.task];
    const [traces, layout] = "map" in plot.dataset
      ? mapPlot(task.maps[plot.dataset.map])
      : curvePlot(task.panels[plot.dataset.panel], visibility(section));
    return Plotly.react(plot, traces, layout, config);
  }

  const redraw = (inside) => all(".plot[data-panel]", inside).forEach(draw);

  for (const section of all("[data-task]")) {
    const chips = all(".chip", section);
    const press = (chip, on) => chip.setAttribute("aria-pressed", String(on));
    for (const chip of chips) {
      chip.addEventListener("click", () => {
        press(chip, chip.getAttribute("aria-pressed") !== "true");
        redraw(section);
      });
      chip.addEventListener("dblclick", () => {
        const alone = chips.every((other) => (other.getAttribute("aria-pressed") === "true") === (other === chip));
        chips.forEach((other) => press(other, alone || other === chip));
        redraw(section);
      });
    }
    for (const box of all("[data-show]", section)) box.addEventListener("change", () => redraw(section));
  }

  for (const plot of all(".plot")) {
    await draw(plot);
    await new Promise((next) => setTimeout(next));
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => all(".plot").forEach(draw));
  for (const event of ["beforeprint", "afterprint"]) {
    addEventListener(event, () => {
      const printing = root.toggleAttribute("data-print", event === "beforeprint");
      for (const plot of all(".plot")) {
        draw(plot);
        Plotly.relayout(plot, printing ? { width: 320, height: plot.clientHeight } : { width: null, height: null, autosize: true });
      }
    });
  }
  root.dataset.ready = "";
})();
