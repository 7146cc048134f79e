"use strict";
(async () => {
  const root = document.documentElement;
  const all = (selector, inside = document) => [...inside.querySelectorAll(selector)];
  const variable = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const faint = (colour, share) => colour + Math.round(255 * share).toString(16).padStart(2, "0");
  const inert = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

  async function unpacked(id) {
    const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (letter) => letter.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  }

  async function library() {
    const script = document.createElement("script");
    script.textContent = await unpacked("plotly");
    document.head.append(script);
    return JSON.parse(await unpacked("numbers"));
  }

  let tasks;
  try {
    tasks = await library();
  } catch (error) {
    for (const plot of all(".plot")) plot.textContent = "This browser can't unpack the plots; a newer one can.";
    throw error;
  }

  function state(section) {
    const shown = (box) => [box.dataset.show, box.checked];
    const off = all(".chip[aria-pressed=false]", section).map((chip) => chip.dataset.line);
    return { ...Object.fromEntries(all("[data-show]", section).map(shown)), off: new Set(off) };
  }

  function bandOf(x, part, base) {
    return {
      ...base, x: [...x, ...[...x].reverse()], y: [...part.high, ...[...part.low].reverse()],
      fill: "toself", mode: "lines", line: { width: 0 }, fillcolor: faint(base.line.color, 0.16), hoverinfo: "skip",
    };
  }

  function eachOf(x, part, base) {
    const gaps = (rows) => rows.flatMap((row) => [...row, null]);
    return {
      ...base, x: gaps(part.each.map(() => x)), y: gaps(part.each), mode: "lines", opacity: 0.5,
      line: { color: base.line.color, width: 0.8 }, hoverinfo: "skip",
    };
  }

  function publishedOf(one, edge, base) {
    const traces = [];
    const { final, crossings } = one.published;
    if (final) {
      const [value, low, high, text] = final;
      traces.push({
        ...base, x: [edge], y: [value], mode: "markers", cliponaxis: false,
        marker: { symbol: "line-ew-open", size: 16, color: base.line.color, line: { width: 3, color: base.line.color } },
        hovertemplate: `${base.name}, published: ${inert(text)}<br>95 %: ${low.toPrecision(3)} to ${high.toPrecision(3)}<extra></extra>`,
      });
    }
    if (crossings.length) {
      traces.push({
        ...base, x: crossings.map((pair) => pair[0]), y: crossings.map((pair) => pair[1]), mode: "markers",
        marker: { symbol: "x", size: 8, color: base.line.color, line: { width: 1, color: variable("--paper") } },
        hovertemplate: `${base.name}, published: %{y} at %{x:,} steps<extra></extra>`,
      });
    }
    return traces;
  }

  function lineOf(x, part, base, digits) {
    const spread = part.low ? `<br>95 % of the IQM: %{customdata[0]:.${digits}~g} to %{customdata[1]:.${digits}~g}` : "";
    return {
      ...base, x, y: part.mean, mode: x.length > 1 ? "lines" : "markers", marker: { size: 7 },
      customdata: part.low ? part.low.map((low, i) => [low, part.high[i]]) : undefined,
      hovertemplate: `<b>${base.name}</b> %{y:.${digits}~g} at %{x:,}${spread}<extra></extra>`,
    };
  }

  function curves(panel, looks, show) {
    const visible = panel.lines.filter((one) => !show.off.has(one.line));
    const longest = Math.max(...panel.lines.map((one) => one.x[one.x.length - 1]));
    const below = [], above = [];
    for (const one of visible) {
      const { label, dash } = looks[one.line];
      const part = (show.smooth && one.smooth) || one.plain;
      const base = { type: "scatter", uid: `${one.line}-`, name: inert(label), line: { color: variable(`--${one.line}`), dash, width: 2 } };
      const named = (kind, trace) => ({ ...trace, uid: `${one.line}-${kind}` });
      if (show.band && part.low) below.push(named("band", bandOf(one.x, part, base)));
      if (show.each) below.push(named("each", eachOf(one.x, part, base)));
      above.push(named("mean", lineOf(one.x, part, base, panel.digits)));
      if (show.published && one.published) {
        publishedOf(one, 1.035 * longest, base).forEach((trace, i) => above.push(named(`published${i}`, trace)));
      }
    }
    const wide = show.published && panel.lines.some((one) => one.published && one.published.final);
    const layout = plain();
    Object.assign(layout.xaxis, { range: [0, (wide ? 1.06 : 1.01) * longest], tickformat: "~s", title: { text: "steps of a seed" } });
    const highest = Math.max(...panel.lines.flatMap((one) => one.plain.mean));
    layout.yaxis.tickformat = highest >= 1000 ? "~s" : "~g";
    if (panel.range) layout.yaxis.range = panel.range;
    else layout.yaxis.rangemode = "tozero";
    return [[...below, ...above], layout];
  }

  function plain() {
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

  function map(one) {
    const [[left, bottom], [right, top]] = one.area;
    const bins = one.shares.length;
    const centres = (low, high) => Array.from({ length: bins }, (_, i) => low + ((i + 0.5) * (high - low)) / bins);
    const trace = {
      type: "heatmap", x: centres(left, right), y: centres(bottom, top), showscale: false, colorscale: "Viridis", hoverongaps: false,
      z: one.shares.map((row) => row.map((share) => (share === null ? null : Math.log10(share)))), customdata: one.shares,
      zmin: Math.log10(one.ends[0]), zmax: Math.log10(one.ends[1] > one.ends[0] ? one.ends[1] : 10 * one.ends[0]),
      hovertemplate: `x %{x:.2f}, y %{y:.2f} ${inert(one.unit)}<br>%{customdata:.2%} of visits<extra></extra>`,
    };
    const layout = plain();
    Object.assign(layout.xaxis, { range: [left, right], constrain: "domain", showgrid: false, title: { text: `x, ${inert(one.unit)}` } });
    Object.assign(layout.yaxis, { range: [bottom, top], scaleanchor: "x", constrain: "domain", showgrid: false, title: { text: "y" } });
    return [[trace], layout];
  }

  const coarse = matchMedia("(pointer: coarse)").matches;
  // A list of buttons of our own: plotly's has one that sends the plot to a server.
  const config = {
    responsive: true, displaylogo: false, displayModeBar: coarse ? false : "hover", plotlyServerURL: "",
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]],
  };

  function draw(plot) {
    const section = plot.closest("[data-task]"), task = tasks[section.dataset.task];
    const isMap = "map" in plot.dataset;
    const [traces, layout] = isMap
      ? map(task.maps[plot.dataset.map])
      : curves(task.panels[plot.dataset.panel], task.looks, state(section));
    return Plotly.react(plot, traces, layout, config);
  }

  const redraw = (inside) => all(".plot[data-panel]", inside).forEach(draw);

  function focus(section, key) {
    for (const group of all(".scatterlayer .trace", section)) {
      const mine = !key || [...group.classList].some((name) => name.startsWith(`trace${key}-`));
      group.style.opacity = mine ? "" : "0.12";
    }
  }

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
      chip.addEventListener("pointerenter", () => focus(section, chip.dataset.line));
      chip.addEventListener("pointerleave", () => focus(section, null));
    }
    for (const box of all("[data-show]", section)) box.addEventListener("change", () => redraw(section));
  }

  for (const plot of all(".plot")) {
    await draw(plot);
    await new Promise((next) => setTimeout(next));
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => all(".plot").forEach(draw));
  addEventListener("beforeprint", () => {
    root.dataset.paper = "";
    for (const plot of all(".plot")) {
      draw(plot);
      Plotly.relayout(plot, { width: 320, height: plot.clientHeight });
    }
  });
  addEventListener("afterprint", () => {
    delete root.dataset.paper;
    for (const plot of all(".plot")) {
      draw(plot);
      Plotly.relayout(plot, { width: null, height: null, autosize: true });
    }
  });
  root.dataset.ready = "";
})();
