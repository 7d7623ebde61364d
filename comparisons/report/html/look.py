"""Style and script of the page."""

STYLE = """
:root { color-scheme: light dark; --line: #8884; --ink: #1b1b1b; --soft: #666; --page: #fff; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8e8e8; --soft: #aaa; --page: #16181b; }
}
body { font: 15px/1.45 system-ui, sans-serif; color: var(--ink); background: var(--page);
  margin: 0 auto; max-width: 1180px; padding: 1.2rem; }
h1 { font-size: 1.5rem; margin: 0 0 .2rem; overflow-wrap: anywhere; }
h2 { font-size: 1.1rem; margin: 1.8rem 0 .5rem; border-bottom: 1px solid var(--line); }
.verdict { display: inline-block; padding: .15rem .7rem; border-radius: 1rem; color: #fff;
  font-weight: 600; }
.agree { background: #2a7d4f; } .disagree { background: #b3261e; }
.unproven { background: #96690a; }
.cause { border-left: 4px solid #b3261e; padding: .3rem .8rem; margin: .6rem 0;
  overflow-wrap: anywhere; }
.cause b { text-transform: capitalize; } .hint, .note { color: var(--soft); }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .22rem .6rem; border-bottom: 1px solid var(--line);
  overflow-wrap: anywhere; vertical-align: top; }
th button { font: inherit; font-weight: 600; color: inherit; background: none; border: 0;
  padding: 0; cursor: pointer; text-align: left; }
.scroll { max-height: 26rem; overflow: auto; }
.bad td:last-child { color: #d13c32; font-weight: 600; }
#map { width: 100%; height: 560px; border: 1px solid var(--line); touch-action: none;
  cursor: grab; }
#map .path { fill: none; } #map polygon { fill: none; }
#map polyline, #map polygon, #map line { stroke-width: 1.4; vector-effect: non-scaling-stroke; }
#map circle { stroke: none; }
.layers label { margin-right: 1rem; white-space: nowrap; }
.swatch { display: inline-block; width: .8rem; height: .8rem; border-radius: 2px; margin: 0 .3rem; }
img { max-width: 100%; background: #fff; }
"""

SCRIPT = """
(() => {
  const map = document.getElementById('map');
  if (map) {
    const box = map.viewBox.baseVal, whole = [box.x, box.y, box.width, box.height];
    const place = e => {
      const p = map.createSVGPoint(); p.x = e.clientX; p.y = e.clientY;
      return p.matrixTransform(map.getScreenCTM().inverse());
    };
    const sized = () => {
      const r = 2.2 * box.width / whole[2];
      for (const c of map.querySelectorAll('circle')) c.setAttribute('r', Math.max(r, .05));
    };
    const zoom = (p, f) => {
      const w = Math.min(Math.max(box.width * f, whole[2] / 500), whole[2] * 3);
      f = w / box.width;
      box.x = p.x - (p.x - box.x) * f; box.y = p.y - (p.y - box.y) * f;
      box.width = w; box.height *= f; sized();
    };
    map.addEventListener('wheel', e => {
      e.preventDefault(); zoom(place(e), e.deltaY > 0 ? 1.2 : 1 / 1.2);
    }, { passive: false });
    let from = null;
    map.addEventListener('pointerdown', e => {
      from = place(e); map.setPointerCapture(e.pointerId);
    });
    map.addEventListener('pointermove', e => {
      if (!from) return;
      const p = place(e); box.x += from.x - p.x; box.y += from.y - p.y;
    });
    map.addEventListener('pointerup', () => { from = null; });
    map.addEventListener('dblclick', () => {
      [box.x, box.y, box.width, box.height] = whole; sized();
    });
    const bar = document.getElementById('layers');
    for (const g of map.querySelectorAll('.layer')) {
      const label = document.createElement('label'), tick = document.createElement('input');
      const swatch = document.createElement('span');
      tick.type = 'checkbox'; tick.checked = true;
      tick.addEventListener('change', () => { g.style.display = tick.checked ? '' : 'none'; });
      swatch.className = 'swatch'; swatch.style.background = g.getAttribute('stroke');
      label.append(tick, swatch, g.dataset.name); bar.append(label, ' ');
    }
  }
  for (const table of document.querySelectorAll('table.sortable')) {
    const body = table.tBodies[0];
    table.querySelectorAll('th button').forEach((button, i) => {
      let up = false;
      button.addEventListener('click', () => {
        up = !up;
        const key = row => row.cells[i].dataset.key ?? row.cells[i].textContent;
        const order = (a, b) => {
          const x = key(a), y = key(b), d = parseFloat(x) - parseFloat(y);
          return (Number.isNaN(d) ? x.localeCompare(y) : d) * (up ? 1 : -1);
        };
        body.append(...[...body.rows].sort(order));
      });
    });
  }
})();
"""
