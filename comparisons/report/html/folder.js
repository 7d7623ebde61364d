// The command that makes the result again, with the path of the folder where that is known.
(() => {
  const again = document.getElementById('again');
  if (!again) return;
  const code = again.querySelector('code'), button = again.querySelector('button');
  const said = again.querySelector('[role=status]');
  const quoted = path => {
    if (/^[\w@%+=:,.\/-]+$/.test(path)) return path;
    return /^[A-Za-z]:/.test(path) ? `"${path}"` : `'${path.replaceAll("'", "'\\''")}'`;
  };
  if (location.protocol === 'file:') {
    try {
      const path = decodeURIComponent(location.pathname).replace(/^\/(?=[A-Za-z]:\/)/, '');
      const folder = path.slice(0, path.lastIndexOf('/') + 1);
      code.textContent = `slamcheck ${again.dataset.job} ${quoted(`${folder}config.toml`)}${again.dataset.more}`;
      again.querySelector('.where').hidden = !again.dataset.more;
    } catch { /* a path that is not UTF-8: the command stays as it stands */ }
  }
  const chosen = () => {
    const range = document.createRange();
    range.selectNodeContents(code);
    getSelection().removeAllRanges();
    getSelection().addRange(range);
  };
  button.hidden = false;
  button.addEventListener('click', async () => {
    chosen();
    try {
      await navigator.clipboard.writeText(code.textContent);
      said.textContent = 'Copied.';
    } catch {
      said.textContent = document.execCommand('copy') ? 'Copied.' : 'Selected: press Ctrl+C.';
    }
  });
})();

// Paper shows everything.
(() => {
  let opened = [];
  addEventListener('beforeprint', () => {
    opened = [...document.querySelectorAll('details:not([open])')];
    for (const one of opened) one.open = true;
  });
  addEventListener('afterprint', () => { for (const one of opened) one.open = false; });
})();
