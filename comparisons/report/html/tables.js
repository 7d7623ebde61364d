(() => {
  for (const table of document.querySelectorAll('table.sortable')) {
    const body = table.tBodies[0];
    table.querySelectorAll('th button').forEach((button, i) => {
      let up = false;
      button.addEventListener('click', () => {
        up = !up;
        const order = (a, b) => {
          const [x, y] = [a, b].map(row => row.cells[i].textContent);
          const apart = parseFloat(x) - parseFloat(y);
          return (Number.isNaN(apart) ? x.localeCompare(y) : apart) * (up ? 1 : -1);
        };
        body.append(...[...body.rows].sort(order));
      });
    });
    const chosen = e => {
      const row = e.target.closest('tbody tr[data-key]');
      if (row) tell('landmark', { key: row.dataset.key, from: 'table' });
    };
    table.addEventListener('click', chosen);
    table.addEventListener('keydown', e => { if (e.key === 'Enter') chosen(e); });
  }
  hear('landmark', ({ key }) => {
    for (const row of document.querySelectorAll('tr[data-key]')) {
      const chosen = row.dataset.key === key, box = row.closest('.scroll');
      row.classList.toggle('chosen', chosen);
      if (chosen && row.closest('#landmarks')) {
        row.hidden = false;
        box.scrollTop = row.offsetTop - box.clientHeight / 2;
      }
    }
  });

  // A table that is cut says so, with what shows the rest.
  for (const box of document.querySelectorAll('.held, .sideways, .scroll')) {
    const note = text('p', '', 'note cut hand');
    const table = box.querySelector('table');
    box.before(note);
    new ResizeObserver(() => {
      const below = box.scrollHeight > box.clientHeight + 1;
      const beside = box.scrollWidth > box.clientWidth + 1;
      const rows = [...table.tBodies].reduce((sum, body) => sum + body.rows.length, 0);
      const said = [below ? `${rows} rows: scroll the table for all of them.` : '',
        beside ? 'Wider than the page: move the table sideways for all columns.' : ''];
      note.textContent = said.filter(Boolean).join(' ');
      note.hidden = !note.textContent;
    }).observe(box);
  }

  for (const button of document.querySelectorAll('button[data-time]')) {
    button.addEventListener('click', () => {
      tell('time', Number(button.dataset.time) - data.start);
      document.getElementById('when')?.scrollIntoView();
    });
  }

  // Rows that hold what is sought stay; one whose landmark is called so is shown on the map.
  const find = document.getElementById('find');
  if (find) {
    const rows = [...document.querySelectorAll('#landmarks tbody tr')];
    const seek = enter => {
      const sought = find.value.trim().toLowerCase();
      const name = row => row.cells[0].textContent.toLowerCase();
      for (const row of rows) row.hidden = !name(row).includes(sought);
      const found = rows.find(row => name(row) === sought) ?? (enter && rows.find(row => !row.hidden));
      if (sought && found) tell('landmark', { key: found.dataset.key, from: 'search' });
    };
    find.addEventListener('input', () => seek(false));
    find.addEventListener('keydown', e => { if (e.key === 'Enter') seek(true); });
  }

  // The address may say what to look at: report.html#time=12.5&landmark=7&layer=associations
  const obey = () => {
    const said = new URLSearchParams(location.hash.slice(1));
    for (const layer of said.getAll('layer')) tell('layer', layer);
    if (said.has('from') && said.has('to')) {
      tell('view', ['from', 'to'].map(name => Number(said.get(name)) - data.start));
    }
    if (said.has('time')) tell('time', Number(said.get('time')) - data.start);
    if (said.has('landmark')) {
      const rows = [...document.querySelectorAll('#landmarks tbody tr')], sought = said.get('landmark');
      const row = rows.find(one => one.cells[0].textContent === sought);
      const named = Object.entries(data.names ?? {}).find(([, name]) => name === sought);
      tell('landmark', { key: row ? row.dataset.key : named ? named[0] : sought, from: 'link' });
    }
  };
  obey();
  addEventListener('hashchange', obey);
})();
