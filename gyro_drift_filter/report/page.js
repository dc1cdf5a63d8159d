'use strict';
// Draws what `figures.py` has made. Traces over time hold more than a screen shows: of the part that
// is looked at, the least and the largest value of each of so many parts are drawn.
(() => {
  const PARTS = 900, SHADES = 300;
  const OKABE_ITO = {
    light: { raw: '#8a8a8a', methods: ['#0072b2', '#cc79a7', '#e69f00', '#6a51a3'], recorded: '#56b4e9', outlier: '#d55e00', rest: '#009e73', q: '#d55e00', r: '#0072b2', band: '#0072b2', deviation: '#0072b2', expected: '#1a1a1a', text: '#1a1a1a', grid: '#dcdcdc', back: '#ffffff' },
    dark: { raw: '#8d949c', methods: ['#56b4e9', '#cc79a7', '#e69f00', '#9e9ac8'], recorded: '#f0e442', outlier: '#ff8a3d', rest: '#009e73', q: '#ff8a3d', r: '#56b4e9', band: '#56b4e9', deviation: '#56b4e9', expected: '#f0e442', text: '#e8e8e8', grid: '#333a42', back: '#15181c' },
  };
  const element = (name) => document.getElementById(name);
  const root = document.documentElement;
  const hidden = new Set(), hiddenAxes = new Set();
  let bag = 0, printing = false;
  const bags = [...document.querySelectorAll('section.bag')].map(() => null);

  const bytes = (text) => {
    const raw = atob(text), out = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  };
  const floats = (text) => new Float32Array(bytes(text));
  const decode = (trace, scale) => {
    if (trace.decoded) return trace;
    if (trace.ticks !== undefined) {
      const ticks = new Uint32Array(bytes(trace.ticks));
      trace.x = Float64Array.from(ticks, (tick) => tick * scale);
    } else {
      trace.x = floats(trace.x);
    }
    trace.y = floats(trace.y);
    trace.middle = trace.middle && floats(trace.middle);
    trace.decoded = true;
    return trace;
  };

  const parsed = (name) => JSON.parse(element(name).textContent);
  const current = () => {
    if (!bags[bag]) {
      const data = parsed(`data-${bag}`);
      data.window = [0, data.seconds];
      bags[bag] = data;
    }
    return bags[bag];
  };
  // Each figure's panels stand in an element of their own, and are read when it is drawn.
  const figureOf = (node) => {
    const figure = current().figures[Number(node.dataset.figure)];
    if (!figure.panels) figure.panels = parsed(`data-${bag}-${node.dataset.figure}`);
    return figure;
  };

  // The first index whose x is not below a value.
  const search = (x, value) => {
    let low = 0, high = x.length;
    while (low < high) {
      const mid = (low + high) >> 1;
      if (x[mid] < value) low = mid + 1; else high = mid;
    }
    return low;
  };
  const visible = (trace, range) => {
    const { x, y } = trace;
    const first = Math.max(search(x, range[0]) - 1, 0), stop = Math.min(search(x, range[1]) + 1, x.length);
    const where = [];
    if (stop - first <= 2 * PARTS) {
      for (let i = first; i < stop; i++) where.push(i);
      return where;
    }
    for (let part = 0; part < PARTS; part++) {
      const a = first + Math.floor((stop - first) * part / PARTS), b = first + Math.floor((stop - first) * (part + 1) / PARTS);
      // What is no number breaks the line.
      let least, largest;
      const some = new Set();
      for (let i = a; i < b; i++) {
        if (Number.isNaN(y[i])) { some.add(i); continue; }
        if (!(y[i] >= y[least])) least = i;
        if (!(y[i] <= y[largest])) largest = i;
      }
      if (least !== undefined) some.add(least).add(largest);
      where.push(...[...some].sort((i, k) => i - k));
    }
    return where;
  };

  const theme = () => printing ? OKABE_ITO.light : OKABE_ITO[root.dataset.theme];
  const colour = (role) => {
    const method = current().methods.indexOf(role);
    return method >= 0 ? theme().methods[method % theme().methods.length] : theme()[role];
  };
  const soft = (hex, share) => hex + Math.round(255 * share).toString(16).padStart(2, '0');

  const shades = (data) => {
    if (hidden.has('rest')) return [];
    const [from, to] = data.window, gap = (to - from) / 1000, merged = [];
    for (const [begin, end] of data.rests) {
      if (end < from || begin > to) continue;
      const last = merged[merged.length - 1];
      if (last && begin - last[1] < gap) last[1] = end; else merged.push([begin, end]);
    }
    return merged.slice(0, SHADES).map(([begin, end]) => ({
      type: 'rect', xref: 'x', yref: 'paper', x0: begin, x1: end, y0: 0, y1: 1, layer: 'below', line: { width: 0 }, fillcolor: soft(theme().rest, 0.14),
    }));
  };

  const shown = (figure) => figure.panels.filter((panel) => !hiddenAxes.has(panel.name));
  const isShown = (trace) => !hidden.has(trace.role);

  const traces = (figure, data) => {
    const out = [];
    shown(figure).forEach((panel, k) => {
      for (const packed of panel.traces) {
        if (!isShown(packed)) continue;
        const trace = decode(packed, data.scale), tint = colour(trace.role);
        const where = figure.inTime ? visible(trace, data.window) : [...trace.x.keys()];
        const x = where.map((i) => trace.x[i]), y = where.map((i) => trace.y[i]);
        const base = { xaxis: 'x', yaxis: k ? `y${k + 1}` : 'y', showlegend: false, name: `${panel.name} ${trace.role}`, hoverlabel: { namelength: -1 } };
        if (trace.style === 'band') {
          const middle = where.map((i) => trace.middle ? trace.middle[i] : 0);
          const edge = { ...base, type: 'scatter', mode: 'lines', line: { width: 0.5, color: soft(tint, 0.5) }, hoverinfo: 'skip' };
          out.push({ ...edge, x, y: y.map((value, i) => middle[i] - value) });
          out.push({ ...edge, x, y: y.map((value, i) => middle[i] + value), fill: 'tonexty', fillcolor: soft(tint, 0.16) });
        } else if (trace.style === 'marks') {
          out.push({ ...base, type: 'scatter', mode: 'markers', marker: { symbol: 'x-thin', size: 8, color: tint, line: { width: 2, color: tint } }, x, y });
        } else if (trace.style === 'bars') {
          out.push({ ...base, type: 'bar', marker: { color: soft(tint, 0.75), line: { width: 0 } }, x, y });
        } else {
          out.push({ ...base, type: 'scatter', mode: 'lines', line: { width: trace.role === 'expected' ? 2 : 1.2, color: tint }, x, y });
        }
      }
    });
    return out;
  };

  // Whole decades, which have a label each: of less than two the library would label 2 and 5, too.
  const decades = (panel) => {
    const logs = panel.traces.filter(isShown).flatMap((trace) => [...trace.y]).filter((y) => y > 0).map(Math.log10);
    const low = Math.floor(Math.min(...logs)), high = Math.ceil(Math.max(...logs));
    return logs.length ? { range: [low, high], autorange: false, dtick: Math.ceil((high - low) / 4) } : {};
  };
  const heightOf = (figure, count) => 90 + (printing ? 100 : figure.inTime ? 150 : 125) * count;

  const layout = (figure, data, width) => {
    const panels = shown(figure), count = Math.max(panels.length, 1), gap = 0.05, colours = theme();
    const line = { gridcolor: colours.grid, zerolinecolor: colours.grid, linecolor: colours.grid, automargin: false, tickfont: { size: 11 } };
    const out = {
      height: heightOf(figure, count), width, margin: { l: 76, r: 15, t: 28, b: 45 },
      paper_bgcolor: colours.back, plot_bgcolor: colours.back, font: { color: colours.text, family: 'system-ui, Liberation Sans, Arial, sans-serif' },
      hovermode: 'closest', bargap: 0.05, dragmode: 'zoom', uirevision: figure.name,
      modebar: { bgcolor: 'rgba(0,0,0,0)', color: colours.text, activecolor: colours.text },
      xaxis: { ...line, title: { text: figure.x, font: { size: 13 } }, anchor: count > 1 ? `y${count}` : 'y', ...(figure.logarithmic.includes('x') ? { type: 'log', dtick: 1, exponentformat: 'power' } : { exponentformat: 'none' }) },
      shapes: figure.inTime ? shades(data) : [],
    };
    if (figure.inTime) out.xaxis.range = [...data.window];
    panels.forEach((panel, k) => {
      const height = (1 - gap * (count - 1)) / count, top = 1 - k * (height + gap), isLog = figure.logarithmic.includes('y');
      out[k ? `yaxis${k + 1}` : 'yaxis'] = {
        ...line, domain: [Math.max(top - height, 0), top], title: { text: `${panel.name}, ${figure.y}`, font: { size: 12 }, standoff: 6 },
        ...(figure.limits ? { range: figure.limits, autorange: false } : {}), type: isLog ? 'log' : 'linear', fixedrange: figure.inTime, nticks: 5, exponentformat: 'power', ...(figure.name === 'allan' ? decades(panel) : {}),
      };
    });
    return out;
  };

  // Named one by one: the library's own choice has a button that sends the figure to a server.
  const CONFIG = { responsive: true, displaylogo: false, plotlyServerURL: '', modeBarButtons: [['toImage'], ['zoom2d', 'pan2d', 'resetScale2d']] };
  const near = new Set();

  const draw = (node) => {
    const data = current(), figure = figureOf(node);
    const width = printing ? (node.closest('.pairs') ? 340 : 700) : undefined;
    node.stale = false;
    node.style.height = `${heightOf(figure, Math.max(shown(figure).length, 1))}px`;
    if (!node.drawn) {
      Plotly.newPlot(node, traces(figure, data), layout(figure, data, width), CONFIG);
      node.drawn = true;
      if (!document.body.dataset.drawn) performance.mark('first figure');
      if (figure.inTime) {
        node.on('plotly_relayout', (change) => {
          if (change['xaxis.autorange']) look([0, data.seconds]);
          else if (change['xaxis.range[0]'] !== undefined) look([change['xaxis.range[0]'], change['xaxis.range[1]']]);
        });
        node.on('plotly_doubleclick', () => look([0, data.seconds]));
      }
    } else {
      Plotly.react(node, traces(figure, data), layout(figure, data, width), CONFIG);
    }
    document.body.dataset.drawn = Number(document.body.dataset.drawn || 0) + 1;
  };
  const nodes = () => [...document.querySelectorAll(`#bag-${bag} .plot`)];
  const refresh = (some = nodes()) => some.forEach((node) => {
    node.stale = true;
    if (near.has(node)) draw(node);
  });

  const look = (range) => {
    const data = current();
    const width = Math.min(Math.max(range[1] - range[0], 1e-3), data.seconds);
    const begin = Math.min(Math.max(range[0], 0), data.seconds - width);
    if (begin === data.window[0] && begin + width === data.window[1]) return;
    data.window = [begin, begin + width];
    refresh(nodes().filter((node) => data.figures[Number(node.dataset.figure)].inTime));
    element('where').textContent = `${data.window[0].toFixed(1)} to ${data.window[1].toFixed(1)} s`;
  };
  const move = (shift, factor) => {
    const [from, to] = current().window, half = 0.5 * (to - from), middle = 0.5 * (from + to) + shift * (to - from);
    look([middle - factor * half, middle + factor * half]);
  };
  const ACTIONS = { left: () => move(-0.25, 1), right: () => move(0.25, 1), closer: () => move(0, 0.5), wider: () => move(0, 2), all: () => look([0, current().seconds]) };
  const KEYS = { ArrowLeft: 'left', ArrowRight: 'right', '+': 'closer', '=': 'closer', '-': 'wider', Home: 'all', 0: 'all' };

  const tint = () => document.querySelectorAll('button[data-role] i').forEach((mark) => {
    mark.style.background = colour(mark.parentNode.dataset.role) || 'transparent';
  });
  const setTheme = (name) => {
    root.dataset.theme = name;
    element('theme').textContent = name === 'dark' ? 'light' : 'dark';
    tint();
    refresh();
  };

  const toggle = (button, set, name) => {
    const on = set.has(name);
    if (on) set.delete(name); else set.add(name);
    button.setAttribute('aria-pressed', String(on));
    refresh();
  };
  document.querySelectorAll('button[data-role]').forEach((button) => button.addEventListener('click', () => toggle(button, hidden, button.dataset.role)));
  document.querySelectorAll('button[data-axis]').forEach((button) => button.addEventListener('click', () => {
    if (hiddenAxes.size < 2 || hiddenAxes.has(button.dataset.axis)) toggle(button, hiddenAxes, button.dataset.axis);
  }));
  document.querySelectorAll('button[data-action]').forEach((button) => button.addEventListener('click', ACTIONS[button.dataset.action]));
  element('theme').addEventListener('click', () => setTheme(root.dataset.theme === 'dark' ? 'light' : 'dark'));
  document.addEventListener('keydown', (event) => {
    const action = KEYS[event.key];
    if (!action || event.ctrlKey || event.altKey || event.metaKey || !event.target.closest('.plot')) return;
    event.preventDefault();
    ACTIONS[action]();
  });
  const choice = element('choice');
  if (choice) {
    choice.addEventListener('change', () => {
      element(`bag-${bag}`).hidden = true;
      bag = Number(choice.value);
      element(`bag-${bag}`).hidden = false;
      tint();
      refresh();
    });
  }

  const dark = matchMedia('(prefers-color-scheme: dark)');
  dark.addEventListener('change', () => setTheme(dark.matches ? 'dark' : 'light'));
  let closed = [];
  addEventListener('beforeprint', () => {
    printing = true;
    root.dataset.printed = root.dataset.theme;
    root.dataset.theme = 'light';
    closed = [...document.querySelectorAll('details:not([open])')];
    closed.forEach((part) => { part.open = true; });
    tint();
    nodes().forEach(draw);
  });
  addEventListener('afterprint', () => {
    printing = false;
    closed.forEach((part) => { part.open = false; });
    setTheme(root.dataset.printed);
  });

  // What comes into sight is drawn then: the first figure at once, however many there are.
  const watcher = new IntersectionObserver((entries) => entries.forEach(({ target, isIntersecting }) => {
    if (!isIntersecting) { near.delete(target); return; }
    near.add(target);
    if (!target.drawn || target.stale) draw(target);
  }), { rootMargin: '200px' });
  setTheme(dark.matches ? 'dark' : 'light');
  // The data of the others comes after this script.
  draw(nodes()[0]);
  document.addEventListener('DOMContentLoaded', () => document.querySelectorAll('.plot').forEach((node) => watcher.observe(node)));
})();
