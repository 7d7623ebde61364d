(() => {
  const map = document.getElementById('map'), world = document.getElementById('world');
  const box = map.viewBox.baseVal, whole = [box.x, box.y, box.width, box.height];
  const metres = Number(map.dataset.metres), chosen = document.getElementById('chosen');
  const marks = [...map.querySelectorAll('circle[data-key]')];
  const names = make('g', { class: 'layer names', 'data-name': 'landmark names',
    stroke: 'var(--ink)', fill: 'var(--ink)' });
  const called = new Map([...Object.entries(data.names),
    ...[...document.querySelectorAll('#landmarks tr[data-key]')]
      .map(row => [row.dataset.key, row.cells[0].textContent])]);
  for (const c of new Map(marks.map(mark => [mark.dataset.key, mark])).values()) {
    const name = make('text', { x: c.cx.baseVal.value, y: c.cy.baseVal.value }, names);
    name.textContent = called.get(c.dataset.key) ?? c.dataset.key;
  }
  if (marks.length) world.append(names);
  const ring = make('circle', { class: 'ring', visibility: 'hidden' }, world);
  const pixels = () => map.getScreenCTM()?.a || 1;

  // Metres to the east and to the north, on the map's lower and left edge.
  const ruler = make('svg', { id: 'ruler' }, document.getElementById('frame'));
  const [west, north] = [Number(map.dataset.west), Number(map.dataset.north)];
  const ruled = () => {
    const edge = map.getBoundingClientRect(), at = map.getScreenCTM();
    ruler.replaceChildren();
    if (!at?.a) return;
    const marked = (start, end, place) => {
      const step = niceStep(Math.abs(end - start) / Math.abs(place(end) - place(start)) * 130);
      for (let k = Math.ceil(Math.min(start, end) / step); k * step <= Math.max(start, end); k++) {
        const value = round(k * step, 9), p = place(value), side = place === across;
        const end = side ? edge.height : edge.width;
        if (p < 45 || p > (side ? edge.width : edge.height) - 30) continue;
        make('path', { d: side ? `M${p},${end}v-6` : `M0,${p}h6` }, ruler);
        const label = make('text', side ? { x: p, y: end - 9, 'text-anchor': 'middle' }
          : { x: 9, y: p + 3.5 }, ruler);
        label.textContent = `${value} m`;
      }
    };
    const across = east => (east - west) / metres * at.a + at.e - edge.left;
    const down = y => (north - y) / metres * at.d + at.f - edge.top;
    const left = west + (edge.left - at.e) / at.a * metres;
    const top = north - (edge.top - at.f) / at.d * metres;
    marked(left, left + edge.width / at.a * metres, across);
    marked(top - edge.height / at.d * metres, top, down);
  };

  const sized = () => {
    ruled();
    const unit = 1 / pixels();
    for (const c of marks) c.setAttribute('r', (c.hasAttribute('fill') ? 5.5 : 2.6) * unit);
    for (const c of world.querySelectorAll('.now')) c.setAttribute('r', 7 * unit);
    ring.setAttribute('r', 12 * unit);
    // Of names that would cover each other the first one stays.
    const taken = [];
    names.setAttribute('font-size', 11 * unit);
    for (const name of names.children) {
      const [x, y] = ['x', 'y'].map(k => Number(name.getAttribute(k)) / unit);
      const end = x + 7 * name.textContent.length + 3;
      const free = !taken.some(other =>
        x < other.end && other.x < end && Math.abs(y - other.y) < 13);
      name.setAttribute('visibility', free ? 'inherit' : 'hidden');
      name.setAttribute('dx', 6 * unit);
      if (free) taken.push({ x, y, end });
    }
    const length = niceStep(130 * unit * metres), bar = document.getElementById('scale');
    bar.style.width = `${length / metres / unit}px`;
    bar.textContent = length < 1000 ? `${round(length, 3)} m` : `${round(length / 1000, 3)} km`;
  };
  const show = (x, y, width) => {
    box.height *= width / box.width; box.width = width;
    box.x = x - width / 2; box.y = y - box.height / 2;
    sized();
  };
  const reset = () => { [box.x, box.y, box.width, box.height] = whole; sized(); };
  const place = e => new DOMPoint(e.clientX, e.clientY).matrixTransform(map.getScreenCTM().inverse());

  const zoomed = (p, factor) => {
    const width = Math.min(Math.max(box.width * factor, whole[2] / 2000), whole[2] * 3);
    const f = width / box.width;
    show(p.x - (p.x - box.x - box.width / 2) * f, p.y - (p.y - box.y - box.height / 2) * f, width);
  };
  map.addEventListener('wheel', e => {
    if (e.deltaY > 0 && box.width >= whole[2]) return;  // all is seen: let the page scroll
    e.preventDefault();
    zoomed(place(e), e.deltaY > 0 ? 1.2 : 1 / 1.2);
  }, { passive: false });

  // Of one finger or the mouse, what lies below it is moved along; of two, what lies between them
  // is, and their distance zooms.
  const down = new Map();
  const between = () => {
    const [a, b = a] = [...down.values()];
    return { clientX: (a.clientX + b.clientX) / 2, clientY: (a.clientY + b.clientY) / 2 };
  };
  const apart = () => {
    const [a, b] = [...down.values()];
    return Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
  };
  let from = null, far = 0, pressed = null;
  const held = () => {
    from = down.size ? place(between()) : null;
    if (down.size === 2) far = apart();
  };
  map.addEventListener('pointerdown', e => {
    if (down.size === 2) return;
    down.set(e.pointerId, e);
    pressed = down.size === 1 ? [e.clientX, e.clientY] : null;
    map.setPointerCapture(e.pointerId);
    held();
  });
  map.addEventListener('pointermove', e => {
    if (!down.has(e.pointerId)) return;
    down.set(e.pointerId, e);
    if (down.size === 2 && apart() > 0) zoomed(from, far / apart());
    const p = place(between());
    box.x += from.x - p.x; box.y += from.y - p.y;
    ruled();
    held();
  });
  const lifted = e => { if (down.delete(e.pointerId)) held(); };
  map.addEventListener('pointerup', e => {
    const still = pressed && Math.hypot(e.clientX - pressed[0], e.clientY - pressed[1]) < 5;
    if (down.has(e.pointerId) && still) choose(e);
    lifted(e);
  });
  map.addEventListener('pointercancel', lifted);
  map.addEventListener('dblclick', reset);

  const hidden = c => c.parentNode.getAttribute('display') === 'none';
  const choose = e => {
    const p = place(e);
    const away = c => Math.hypot(c.cx.baseVal.value - p.x, c.cy.baseVal.value - p.y);
    let best = null, least = 14 / pixels();
    for (const c of marks) if (!hidden(c) && away(c) < least) [best, least] = [c, away(c)];
    if (best) tell('landmark', { key: best.dataset.key, from: 'map' });
  };
  hear('landmark', ({ key, from: source }) => {
    const found = marks.filter(c => c.dataset.key === key);
    if (!found.length) return;
    const mark = found.filter(c => !hidden(c)).at(-1) ?? found[0];
    const x = mark.cx.baseVal.value, y = mark.cy.baseVal.value;
    ring.setAttribute('cx', x); ring.setAttribute('cy', y);
    ring.setAttribute('visibility', 'visible');
    ring.dataset.key = key;
    chosen.textContent = found.at(-1).textContent;
    if (source === 'map') return;
    show(x, y, Math.min(box.width, whole[2] / 5));
    if (source !== 'search') map.scrollIntoView({ block: 'nearest' });
  });

  const tracks = [...map.querySelectorAll('[data-track]')].map(line => {
    const values = line.getAttribute('points').split(/[ ,]/).map(Number);
    const colour = line.parentNode.getAttribute('stroke');
    const now = make('circle', { class: 'now', fill: colour, visibility: 'hidden' }, world);
    now.dataset.of = line.dataset.track;
    const name = line.dataset.track, spread = data.spreads[name];
    const ellipse = make('circle', { class: 'spread', r: 3, visibility: 'hidden' }, world);
    ellipse.style.stroke = colour;
    return { values, now, ellipse, spread, times: data.tracks[name] };
  });
  // The circle of 3 sigma, by the Cholesky factor of the covariance of east and north; north is up.
  const spreadOut = (ellipse, spread, i, x, y) => {
    const [east, both, north] = spread.map(one => one[i]);
    const a = Math.sqrt(east) / metres, b = -both / Math.sqrt(east) / metres;
    const d = Math.sqrt(north - both * both / east) / metres;
    const drawn = east > 0 && Number.isFinite(b) && Number.isFinite(d);
    if (drawn) ellipse.setAttribute('transform', `matrix(${a} ${b} 0 ${d} ${x} ${y})`);
    ellipse.setAttribute('visibility', drawn ? 'visible' : 'hidden');
  };
  const slider = document.getElementById('time');
  const lasting = tracks.flatMap(({ times }) => times.length > 1 ? [times[0], times.at(-1)] : []);
  if (lasting.length) {
    [slider.min, slider.max] = [Math.min(...lasting), Math.max(...lasting)];
    slider.value = slider.min;
    document.getElementById('times').hidden = false;
    slider.addEventListener('input', () => tell('time', Number(slider.value)));
  }
  hear('time', t => {
    slider.value = t;
    for (const { values, now, ellipse, spread, times } of tracks) {
      if (times.length < 2) continue;
      const i = Math.min(Math.max(first(times, t), 1), times.length - 1);
      const share = (t - times[i - 1]) / (times[i] - times[i - 1] || 1);
      const part = Math.min(Math.max(share, 0), 1);
      const at = k => values[2 * i - 2 + k] + part * (values[2 * i + k] - values[2 * i - 2 + k]);
      now.setAttribute('cx', at(0)); now.setAttribute('cy', at(1));
      now.setAttribute('visibility', 'visible');
      if (spread) spreadOut(ellipse, spread, part < 0.5 ? i - 1 : i, at(0), at(1));
    }
  });

  // A path in the colours of its errors: of each colour one line, of pieces between two points.
  for (const group of map.querySelectorAll('[data-classes]')) {
    const { values } = tracks.find(track => track.now.dataset.of === group.dataset.of);
    const pieces = data.errorColours.map(() => []);
    [...group.dataset.classes].forEach((digit, i) => {
      const colour = Number.parseInt(digit, 32);
      if (i && colour >= 0) pieces[colour].push(`M${values.slice(2 * i - 2, 2 * i + 2).join(' ')}`);
    });
    pieces.forEach((d, k) => {
      if (d.length) make('path', { d: d.join(''), stroke: data.errorColours[k] }, group);
    });
  }

  const bar = document.getElementById('layers');
  const legends = new Map([...document.querySelectorAll('.legend')].map(one => [one.id, new Set()]));
  for (const g of map.querySelectorAll('.layer')) {
    const label = document.createElement('label'), tick = document.createElement('input');
    const swatch = text('span', '', 'swatch');
    tick.type = 'checkbox';
    tick.checked = g.getAttribute('display') !== 'none';
    const shown = () => {
      if (tick.checked) g.removeAttribute('display'); else g.setAttribute('display', 'none');
      const shows = legends.get(g.dataset.legend);
      if (!shows) return;
      if (tick.checked) shows.add(g); else shows.delete(g);
      document.getElementById(g.dataset.legend).hidden = !shows.size;
    };
    tick.addEventListener('change', shown);
    shown();
    if (g.classList.contains('filled')) swatch.classList.add('diverging');
    else if (g.classList.contains('errors')) swatch.classList.add('sequential');
    else swatch.style.background = g.getAttribute('stroke');
    label.append(tick, swatch, g.dataset.name);
    bar.append(label);
  }
  hear('layer', name => {
    const index = [...map.querySelectorAll('.layer')].findIndex(g => g.dataset.name === name);
    if (index < 0) return;
    const tick = bar.children[index].querySelector('input');
    tick.checked = true;
    tick.dispatchEvent(new Event('change'));
  });

  new ResizeObserver(sized).observe(map);
  sized();
})();
