'use strict';
// Draws the histories of the sensors as small multiples, each as it comes into sight.
(() => {
  // Okabe and Ito's colours, and a shape for each axis, for who does not tell colours.
  const THEMES = {
    light: { x: '#0072b2', y: '#d55e00', z: '#009e73', all: '#0072b2', since: '#1a1a1a', text: '#1a1a1a', grid: '#dcdcdc', back: '#ffffff' },
    dark: { x: '#56b4e9', y: '#ff8a3d', z: '#3fc99f', all: '#56b4e9', since: '#e8e8e8', text: '#e8e8e8', grid: '#333a42', back: '#15181c' },
  };
  const SHAPES = { x: 'circle', y: 'square', z: 'diamond', all: 'circle' };
  const root = document.documentElement;
  const sensors = JSON.parse(document.getElementById('sensors').textContent);
  const nodes = [...document.querySelectorAll('.plot')];
  const near = new Set();
  let printing = false;
  const theme = () => THEMES[printing ? 'light' : root.dataset.theme];

  const figure = (sensor) => {
    const colours = theme(), traces = [], shapes = [], annotations = [], layout = {};
    const count = sensor.quantities.length, narrow = window.innerWidth < 700, columns = narrow ? 1 : Math.min(count, 4), rows = Math.ceil(count / columns);
    // The same time in all, with half a day about bags that begin at once: it would be milliseconds.
    const [first, last] = [sensor.times[0], sensor.times[sensor.times.length - 1]].map((time) => Date.parse(`${time.replace(' ', 'T')}Z`));
    const beside = 0.05 * (last - first) || 43.2e6, range = [first - beside, last + beside];
    sensor.quantities.forEach((quantity, k) => {
      const suffix = k ? String(k + 1) : '', column = k % columns, row = Math.floor(k / columns);
      const left = (column + 0.13) / columns, right = (column + 0.98) / columns, top = 1 - row / rows, bottom = 1 - (row + 0.72) / rows;
      for (const [axis, history] of Object.entries(quantity.axes)) {
        const name = axis || 'all';
        traces.push({
          type: 'scatter', mode: 'lines+markers', name: axis, legendgroup: axis, showlegend: k === 0 && axis !== '', xaxis: `x${suffix}`, yaxis: `y${suffix}`,
          x: history.bags.map((bag) => sensor.times[bag]), y: history.values, customdata: history.bags,
          line: { width: 1, color: colours[name] }, marker: { size: 6, color: colours[name], symbol: SHAPES[name] },
          hovertemplate: history.bags.map((bag) => `%{y:.4g} ${quantity.unit}<br>${sensor.labels[bag]}<extra>${axis}</extra>`),
        });
      }
      if (quantity.since !== null) {
        shapes.push({ type: 'line', xref: `x${suffix}`, yref: `y${suffix} domain`, x0: sensor.times[quantity.since], x1: sensor.times[quantity.since], y0: 0, y1: 1, line: { width: 2, dash: 'dash', color: colours.since } });
      }
      const line = { gridcolor: colours.grid, zerolinecolor: colours.grid, linecolor: colours.grid, tickfont: { size: 10 } };
      layout[`xaxis${suffix}`] = { ...line, domain: [left, right], anchor: `y${suffix}`, type: 'date', range, nticks: 4 };
      layout[`yaxis${suffix}`] = { ...line, domain: [bottom, top - 0.1 / rows], anchor: `x${suffix}`, nticks: 5, rangemode: quantity.name === 'bias' ? 'normal' : 'tozero' };
      annotations.push({ xref: 'paper', yref: 'paper', x: left, y: top - 0.1 / rows, xanchor: 'left', yanchor: 'bottom', showarrow: false, text: `${quantity.name} (${quantity.unit})${Object.values(quantity.axes).some((history) => history.bags.length) ? '' : ': not known'}`, font: { size: 12, color: colours.text } });
    });
    return [traces, {
      ...layout, shapes, annotations, height: 190 * rows + 46, margin: { l: 8, r: 8, t: 24, b: 8 }, hovermode: 'closest', dragmode: 'zoom',
      paper_bgcolor: colours.back, plot_bgcolor: colours.back, font: { color: colours.text, family: 'system-ui, Liberation Sans, Arial, sans-serif' },
      legend: { orientation: 'h', x: 0, xanchor: 'left', y: 1, yanchor: 'bottom', font: { size: 11 } }, modebar: { bgcolor: 'rgba(0,0,0,0)', color: colours.text, activecolor: colours.text },
    }];
  };
  // Named one by one: the library's own choice has a button that sends the figure to a server.
  const CONFIG = { responsive: true, displaylogo: false, plotlyServerURL: '', modeBarButtons: [['toImage'], ['zoom2d', 'pan2d', 'resetScale2d']] };

  const draw = (node) => {
    const sensor = sensors[Number(node.dataset.sensor)], [traces, layout] = figure(sensor);
    node.stale = false;
    node.style.height = node.style.minHeight = `${layout.height}px`;
    if (node.drawn) {
      Plotly.react(node, traces, layout, CONFIG);
    } else {
      Plotly.newPlot(node, traces, layout, CONFIG);
      node.drawn = true;
      node.on('plotly_click', (event) => {
        const link = sensor.links[event.points[0].customdata];
        if (link) location.href = link;
      });
    }
    document.body.dataset.drawn = Number(document.body.dataset.drawn || 0) + 1;
  };
  const refresh = () => nodes.forEach((node) => {
    node.stale = true;
    if (near.has(node)) draw(node);
  });
  const setTheme = (name) => {
    root.dataset.theme = name;
    document.getElementById('theme').textContent = name === 'dark' ? 'light' : 'dark';
    refresh();
  };
  document.getElementById('theme').addEventListener('click', () => setTheme(root.dataset.theme === 'dark' ? 'light' : 'dark'));
  const dark = matchMedia('(prefers-color-scheme: dark)');
  dark.addEventListener('change', () => setTheme(dark.matches ? 'dark' : 'light'));
  addEventListener('beforeprint', () => { printing = true; nodes.forEach(draw); });
  addEventListener('afterprint', () => { printing = false; refresh(); });

  const watcher = new IntersectionObserver((entries) => entries.forEach(({ target, isIntersecting }) => {
    if (!isIntersecting) { near.delete(target); return; }
    near.add(target);
    if (!target.drawn || target.stale) draw(target);
  }), { rootMargin: '300px' });
  setTheme(dark.matches ? 'dark' : 'light');
  nodes.forEach((node) => watcher.observe(node));
  document.body.dataset.ready = 'yes';
})();
