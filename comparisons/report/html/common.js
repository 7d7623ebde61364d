const data = JSON.parse(document.getElementById('data').textContent);

const tell = (name, detail) => document.dispatchEvent(new CustomEvent(name, { detail }));
const hear = (name, listener) => document.addEventListener(name, e => listener(e.detail));

hear('time', t => {
  const now = document.getElementById('now'), at = round(data.start + t, 9);
  if (now) now.textContent = data.event ? `at event ${Math.round(at)}` : `at ${at.toFixed(1)} s`;
});

const make = (name, attributes = {}, parent = null) => {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (parent) parent.append(made);
  return made;
};

const text = (name, content, className = '') => {
  const made = document.createElement(name);
  made.textContent = content;
  if (className) made.className = className;
  return made;
};

// The first index of a sorted list whose value is not below x.
const first = (list, x) => {
  let low = 0, high = list.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (list[middle] < x) low = middle + 1; else high = middle;
  }
  return low;
};

const round = (x, digits) => Number(Number(x).toPrecision(digits));

// A step of 1, 2 or 5 times a power of ten, as long as possible but not longer.
const niceStep = most => {
  const power = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].map(k => k * power).find(step => step <= most) ?? power;
};
