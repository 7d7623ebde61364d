(() => {
  const holder = document.getElementById('curves');
  const HEIGHT = 132, LEFT = 62, RIGHT = 16, TOP = 6, BOTTOM = 20, LEAST = 1e-2;
  for (const { curves, bands } of data.panels) {
    for (const one of [...curves, ...bands]) one.x = data.axes[one.x];
    for (const band of bands.filter(one => one.half)) {
      const middle = band.about === null ? band.x.map(() => 0) : curves[band.about].y;
      const side = sign => band.half.map((h, i) =>
        h === null || middle[i] === null ? null : middle[i] + sign * h);
      [band.low, band.high] = [side(-1), side(1)];
    }
  }
  const timed = data.panels.filter(panel => panel.timed);
  const ends = timed.flatMap(p => p.curves.flatMap(c => c.x.length ? [c.x[0], c.x.at(-1)] : []));
  const all = ends.length ? [Math.min(...ends), Math.max(...ends)] : [0, 1];
  if (all[0] === all[1]) all[1] += 1;
  let view = [...all], pointed = null, waiting = false;

  const later = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; for (const f of figures) f.draw(); });
  };
  const zoom = (a, b) => {
    const least = (all[1] - all[0]) / 20000, span = Math.max(b - a, least);
    if (span >= all[1] - all[0]) view = [...all];
    else {
      const low = Math.min(Math.max(a, all[0]), all[1] - span);
      view = [low, low + span];
    }
    later();
  };
  const ticks = (a, b, count) => {
    const step = niceStep((b - a) / count * 1.6), found = [];
    for (let k = Math.ceil(a / step); k * step <= b; k++) found.push(round(k * step, 12));
    return found;
  };
  // Powers of ten between 10^a and 10^b, with 2 and 5 times them where these alone are few.
  const decades = (a, b) => {
    const found = [], every = Math.max(Math.ceil((b - a) / 4), 1);
    const within = b - a < 1 ? [1, 1.5, 2, 3, 4, 5, 6, 8] : b - a < 2.2 ? [1, 2, 5] : [1];
    for (let k = Math.floor(a); k <= b; k += every) {
      for (const times of within) {
        const at = k + Math.log10(times);
        if (at >= a && at <= b) found.push(at);
      }
    }
    return found;
  };
  // Which points of a list of x, one more on either side, lie within the view.
  const within = (x, [a, b]) => [Math.max(first(x, a) - 1, 0), Math.min(first(x, b) + 1, x.length)];
  const nearest = (x, at) => {
    const i = first(x, at);
    return i > 0 && (i === x.length || at - x[i - 1] < x[i] - at) ? i - 1 : i;
  };

  class Figure {
    constructor(panel) {
      this.panel = panel;
      this.at = null;
      this.figure = document.createElement('figure');
      const caption = document.createElement('figcaption');
      caption.append(text('b', panel.title));
      this.values = [...panel.curves, ...panel.bands].map(one => {
        const name = text('span', '', 'name'), swatch = text('span', '', 'swatch');
        const value = text('span', '', 'value');
        swatch.style.background = one.colour;
        if (one.low) swatch.style.opacity = 0.35;
        name.append(swatch, one.name, value);
        caption.append(name);
        return value;
      });
      for (const lack of panel.lacks) caption.append(text('span', lack, 'lack'));
      this.unit = panel.title.match(/\[([^\]]+)\]$/)?.[1] ?? '';
      this.svg = make('svg', { class: 'curve', tabindex: 0, role: 'img', 'aria-label': panel.title });
      this.figure.append(caption, this.svg);
      holder.append(this.figure);
      this.listen();
    }
    get span() {
      if (this.panel.timed) return view;
      const x = this.panel.curves.flatMap(c => c.x);
      return [Math.min(...x) - 0.3, Math.max(...x) + 0.3];
    }
    scale(y) {
      const low = this.panel.log ? Math.log10(Math.max(y, 1e-300)) : y;
      return TOP + (HEIGHT - TOP - BOTTOM) * (1 - (low - this.low) / (this.high - this.low));
    }
    across(x) {
      const [a, b] = this.span;
      return LEFT + (this.width - LEFT - RIGHT) * (x - a) / (b - a);
    }
    time(e) {
      const r = this.svg.getBoundingClientRect(), [a, b] = this.span;
      const share = (e.clientX - r.left - LEFT) / (r.width - LEFT - RIGHT);
      return a + Math.min(Math.max(share, 0), 1) * (b - a);
    }
    limits() {
      const { panel, span } = this;
      let low = Infinity, high = -Infinity;
      for (const one of [...panel.curves, ...panel.bands]) {
        const [i, j] = within(one.x, span);
        for (const list of one.y ? [one.y] : [one.low, one.high]) {
          for (let k = i; k < j; k++) {
            const v = list[k];
            if (v === null || (panel.log && v <= 0)) continue;
            if (v < low) low = v;
            if (v > high) high = v;
          }
        }
      }
      if (!(low <= high)) [low, high] = panel.log ? [0.1, 10] : [-1, 1];
      if (panel.log) [low, high] = [Math.log10(Math.max(low, LEAST)), Math.log10(Math.max(high, 2 * LEAST))];
      const margin = 0.05 * (high - low) || Math.abs(high) * 0.1 || 1;
      [this.low, this.high] = [low - margin, high + margin];
    }
    draw() {
      const { svg, panel } = this, { width } = svg.getBoundingClientRect();
      this.width = width || 600;
      svg.setAttribute('viewBox', `0 0 ${this.width} ${HEIGHT}`);
      svg.replaceChildren();
      this.limits();
      this.axes();
      const [left, top] = [LEFT, TOP], [w, h] = [this.width - LEFT - RIGHT, HEIGHT - TOP - BOTTOM];
      const plot = make('svg', { x: left, y: top, width: w, height: h,
        viewBox: `${left} ${top} ${w} ${h}` }, svg);
      if (panel.level !== null) {
        const y = this.scale(panel.level);
        make('line', { x1: left, x2: left + w, y1: y, y2: y, class: 'level' }, plot);
      }
      for (const band of panel.bands) {
        make('path', { d: this.area(band), fill: band.colour, class: 'band' }, plot);
      }
      for (const c of panel.curves) {
        make('path', { d: this.line(c.x, c.y), stroke: c.colour, class: 'line' }, plot);
        if (c.x.length !== 1 || c.y[0] === null) continue;
        make('circle', { cx: this.across(c.x[0]), cy: this.scale(c.y[0]), r: 3, fill: c.colour }, plot);
      }
      for (const one of panel.moments) {
        const x = this.across(one.x);
        const line = make('line', { x1: x, x2: x, y1: top, y2: top + h, stroke: one.colour,
          class: 'moment' }, plot);
        make('title', {}, line).textContent = one.name;
      }
      this.cursor = make('line', { class: 'cursor', y1: TOP, y2: HEIGHT - BOTTOM, visibility: 'hidden' }, svg);
      this.brush = make('rect', { class: 'brush', y: TOP, height: h, visibility: 'hidden' }, svg);
      if (panel.timed) this.at = pointed;
      this.point(this.at);
    }
    spot(x, y) { return `${this.across(x).toFixed(1)},${this.scale(y).toFixed(1)}`; }
    line(x, y) {
      const [i, j] = within(x, this.span), parts = [];
      for (let k = i, pen = false; k < j; k++) {
        if (y[k] !== null) parts.push(`${pen ? 'L' : 'M'}${this.spot(x[k], y[k])}`);
        pen = y[k] !== null;
      }
      return parts.join('');
    }
    // What lies between low and high, in as many pieces as there are gaps between.
    area({ x, low, high }) {
      const [i, j] = within(x, this.span), parts = [];
      for (let k = i, from = i; k <= j; k++) {
        if (k < j && low[k] !== null && high[k] !== null) continue;
        const rows = Array.from({ length: k - from }, (_, n) => from + n);
        const there = rows.map(r => this.spot(x[r], high[r]));
        const back = rows.reverse().map(r => this.spot(x[r], low[r]));
        if (k > from) parts.push(`M${[...there, ...back].join('L')}Z`);
        from = k + 1;
      }
      return parts.join('');
    }
    axes() {
      const { svg, panel } = this, bottom = HEIGHT - BOTTOM, right = this.width - RIGHT;
      const marks = panel.log ? decades(this.low, this.high) : ticks(this.low, this.high, 4);
      for (const v of marks) {
        const y = this.scale(panel.log ? 10 ** v : v);
        make('line', { x1: LEFT, x2: right, y1: y, y2: y, class: 'grid' }, svg);
        const figure = panel.log ? round(10 ** v, 2) : Math.abs(v) < 1e5 ? v : v.toExponential(1);
        make('text', { x: LEFT - 6, y: y + 3.5, class: 'tick side' }, svg).textContent =
          `${figure} ${this.unit}`.trim();
      }
      const shift = panel.timed ? data.start : 0, [a, b] = this.span;
      for (const t of ticks(a + shift, b + shift, this.width / 90)) {
        const x = this.across(t - shift);
        make('line', { x1: x, x2: x, y1: TOP, y2: bottom, class: 'grid' }, svg);
        const tick = make('text', { x, y: bottom + 14, class: 'tick' }, svg);
        tick.textContent = panel.timed && !data.event ? `${t} s` : `${panel.x} ${t}`;
        const over = x + tick.getComputedTextLength() / 2 - this.width;
        if (over > 0) tick.setAttribute('x', x - over);
      }
      make('path', { d: `M${LEFT},${TOP}V${bottom}H${right}`, class: 'axis' }, svg);
    }
    point(t) {
      this.at = t;
      const { panel, cursor } = this;
      if (t === null || !cursor) return;
      const x = this.across(t), inside = x >= LEFT && x <= this.width - RIGHT;
      cursor.setAttribute('x1', x); cursor.setAttribute('x2', x);
      cursor.setAttribute('visibility', inside ? 'visible' : 'hidden');
      [...panel.curves, ...panel.bands].forEach((one, k) => {
        const i = nearest(one.x, t), shown = v => v === null ? 'none' : round(v, 3);
        if (!one.x.length) return;
        this.values[k].textContent = one.y ? shown(one.y[i])
          : one.low[i] === null || one.high[i] === null ? 'none'
          : one.half ? `± ${shown(one.half[i])}` : `${shown(one.low[i])} to ${shown(one.high[i])}`;
      });
    }
    listen() {
      const { svg, panel } = this;
      let from = null;
      svg.addEventListener('pointermove', e => {
        const t = this.time(e);
        if (!panel.timed) { this.point(Math.round(t)); return; }
        tell('time', t);
        if (from === null) return;
        const [a, b] = [this.across(from), this.across(t)];
        this.brush.setAttribute('x', Math.min(a, b));
        this.brush.setAttribute('width', Math.abs(b - a));
        this.brush.setAttribute('visibility', 'visible');
      });
      if (!panel.timed) return;
      svg.addEventListener('pointerdown', e => { from = this.time(e); svg.setPointerCapture(e.pointerId); });
      svg.addEventListener('pointerup', e => {
        const t = this.time(e), start = from;
        from = null;
        this.brush.setAttribute('visibility', 'hidden');
        if (start !== null && Math.abs(this.across(t) - this.across(start)) > 6) {
          zoom(Math.min(start, t), Math.max(start, t));
        }
      });
      svg.addEventListener('pointercancel', () => { from = null; });
      svg.addEventListener('dblclick', () => zoom(...all));
      svg.addEventListener('wheel', e => {
        const [a, b] = view, out = e.deltaY > 0;
        if (out && b - a >= all[1] - all[0]) return;  // nothing to zoom: let the page scroll
        e.preventDefault();
        const t = this.time(e), f = out ? 1.25 : 0.8;
        zoom(t - (t - a) * f, t + (b - t) * f);
      }, { passive: false });
      svg.addEventListener('keydown', e => {
        const way = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
        if (!way) return;
        e.preventDefault();
        const [a, b] = view;
        tell('time', Math.min(Math.max((pointed ?? a) + way * (b - a) / 100, a), b));
      });
    }
  }

  const figures = data.panels.map(panel => new Figure(panel));
  hear('time', t => {
    pointed = t;
    for (const f of figures) if (f.panel.timed) f.point(t);
  });
  hear('view', ([a, b]) => zoom(a, b));
  new ResizeObserver(later).observe(holder);
  for (const f of figures) f.draw();
})();
