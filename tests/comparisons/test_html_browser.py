"""report.html in a headless Chromium: the script runs, and does what it says."""

import re
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from comparisons.jobs.run import Comparison
from comparisons.report.html.shell import script
from tests.comparisons.browser import came_up, look, noted
from tests.comparisons.test_html_report import HOSTILE
from tests.helpers import compared, present, simulated, written

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    """A log with a hostile name, and the smoother's own association beside the filter's."""
    log = replace(simulated(seed=2, loop_s=20.0), name=HOSTILE)
    return compared(log, smoother_association="own")


@pytest.fixture(scope="module")
def report(comparison: Comparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(comparison, tmp_path_factory.mktemp("run") / "report") / "report.html"


@pytest.mark.slow
def test_a_browser_builds_layers_and_curves(report: Path, tmp_path: Path) -> None:
    dom = look(report.as_uri(), tmp_path)
    assert came_up(dom)
    layers = len(re.findall('<g class="layer', dom))
    assert layers >= 9
    assert dom.count('type="checkbox"') == layers
    # Curves of errors east, north and of heading, NEES, spurious heading, NIS and whiteness; east,
    # north and heading of the paths; and two maps of correlations.
    assert dom.count("<figure>") == 7 + 3 + 2
    assert len(re.findall(r'<path d="M[^"]{200,}"[^>]* class="line"', dom)) >= 5
    assert "NaN" not in dom.split("<script", 1)[0]
    assert "<title>owned</title>" not in dom


@pytest.mark.slow
def test_a_mistake_in_the_script_is_seen(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The broken variant: a name that does not exist, in a page that is otherwise in order."""
    mistaken = script().replace("hear('time'", "heer('time'")
    monkeypatch.setattr("comparisons.report.html.page.script", lambda _names: mistaken)
    page = written(comparison, tmp_path / "report") / "report.html"
    dom = look(page.as_uri(), tmp_path / "profile")
    assert "<svg" in dom
    assert not came_up(dom)


def test_nothing_but_the_script_is_run(report: Path, tmp_path: Path) -> None:
    """Markup that got past every escape would still meet the policy."""
    text = report.read_text(encoding="utf-8")
    page = tmp_path / "injected.html"
    attack = "<script>document.title='owned'</script><p onclick='' id=x></p>"
    page.write_text(text.replace("<main>", attack + "<main>"), encoding="utf-8")
    dom = look(page.as_uri(), tmp_path / "profile")
    assert came_up(dom)
    assert "<title>owned</title>" not in dom


def test_a_link_says_what_to_look_at(comparison: Comparison, report: Path, tmp_path: Path) -> None:
    key = int(comparison.ekf.estimate.landmark_id[3])
    dom = look(f"{report.as_uri()}#time=10&landmark={key}&layer=associations", tmp_path)
    assert 'id="now">at 10.0 s<' in dom
    assert len(re.findall(r'<circle class="now"[^>]* visibility="visible"', dom)) == 2
    ellipses = re.findall(r'<circle class="spread"[^>]* transform="matrix\(([^)]*)\)"', dom)
    metres = float(present(re.search(r'data-metres="([^"]*)"', dom))[1])
    at = int(np.argmin(np.abs(comparison.ekf.estimate.time_s - 10.0)))
    for text, estimate in zip(
        ellipses, (comparison.smoothed, comparison.ekf.estimate), strict=True
    ):
        factor = metres * np.reshape(list(map(float, text.split()))[:4], (2, 2)).T
        south = estimate.pose_covariance[at, :2, :2] * ((1.0, -1.0), (-1.0, 1.0))
        assert factor @ factor.T == pytest.approx(south, rel=2e-3)
        assert factor @ factor.T != pytest.approx(np.abs(south), rel=0.1)
    assert re.search(rf'<tr data-key="{key}"[^>]*class="[^"]*chosen', dom)
    assert re.search(rf'<circle class="ring"[^>]* data-key="{key}"', dom)
    hidden = present(re.search(r'<g class="layer faint" data-name="associations"[^>]*>', dom))
    assert "display" not in hidden[0]
    names = re.findall(r'<text x="[^"]*" y="[^"]*"[^>]*visibility="inherit"[^>]*>(\d+)<', dom)
    assert {str(key)} < set(names) <= set(map(str, comparison.ekf.estimate.landmark_id.tolist()))


STEPS = """
noted.ready = document.documentElement.dataset.ready;
const box = document.getElementById('map').viewBox.baseVal;
const curve = document.querySelector('svg.curve'), at = curve.getBoundingClientRect();
const spot = (x, more = {}) => ({ clientX: at.left + x * at.width, clientY: at.top + 50,
  pointerId: 1, bubbles: true, cancelable: true, ...more });
const ticks = () => [...curve.querySelectorAll('.tick')].map(t => t.textContent)
  .filter(t => t.endsWith(' s')).join('|');
curve.setPointerCapture = () => {};
noted.whole = ticks();
const slider = document.getElementById('time');
slider.value = slider.max;
slider.dispatchEvent(new Event('input'));
noted.slid = [...document.querySelectorAll('.now, .spread, .cursor')]
  .every(one => one.getAttribute('visibility') === 'visible' || !one.closest('#world'));
curve.dispatchEvent(new PointerEvent('pointermove', spot(0.5)));
noted.now = document.querySelectorAll('.now[visibility=visible]').length;
noted.cursors = document.querySelectorAll('.cursor[visibility=visible]').length;
curve.dispatchEvent(new WheelEvent('wheel', spot(0.5, { deltaY: -1 })));
noted.wheel = ticks();
curve.dispatchEvent(new MouseEvent('dblclick', spot(0.5)));
curve.dispatchEvent(new PointerEvent('pointerdown', spot(0.4)));
curve.dispatchEvent(new PointerEvent('pointermove', spot(0.5)));
curve.dispatchEvent(new PointerEvent('pointerup', spot(0.5)));
noted.drag = ticks();
const row = document.querySelector('#landmarks tbody tr'), before = box.width;
row.click();
noted.zoomed = box.width < before;
const label = document.getElementById('chosen').textContent;
noted.label = label.includes(`landmark ${row.dataset.key}:`);
const mark = [...document.querySelectorAll('#map circle[data-key]')]
  .find(c => c.dataset.key !== row.dataset.key), r = mark.getBoundingClientRect();
const map = document.getElementById('map');
map.setPointerCapture = () => {};
const here = { clientX: r.left + r.width / 2, clientY: r.top + r.height / 2, pointerId: 1 };
map.dispatchEvent(new PointerEvent('pointerdown', here));
map.dispatchEvent(new PointerEvent('pointerup', here));
noted.chosen = document.querySelector('#landmarks tr.chosen').dataset.key !== row.dataset.key;
const width = () => map.viewBox.baseVal.width, alone = width();
const touch = (kind, id, x) => map.dispatchEvent(new PointerEvent(kind,
  { clientX: r.left + x, clientY: r.top, pointerId: id, pointerType: 'touch' }));
touch('pointerdown', 1, -20);
touch('pointerdown', 2, 20);
touch('pointermove', 2, 60);
noted.pinched = Math.abs(width() / alone - 0.5) < 0.01;
touch('pointerup', 2, 60);
touch('pointerup', 1, -20);
touch('pointermove', 1, 0);
noted.left = Math.abs(width() / alone - 0.5) < 0.01;
const find = document.getElementById('find');
const rows = [...document.querySelectorAll('#landmarks tbody tr')];
const left = sought => {
  find.value = sought;
  find.dispatchEvent(new Event('input'));
  return rows.filter(one => one.getBoundingClientRect().height > 0).length;
};
noted.none = left('no such landmark');
noted.one = left(row.cells[0].textContent) >= 1 && row.classList.contains('chosen');
noted.all = left('') === rows.length;
location.hash = `#landmark=${rows.at(-1).cells[0].textContent}`;
window.dispatchEvent(new HashChangeEvent('hashchange'));
noted.linked = rows.at(-1).classList.contains('chosen');
"""


@pytest.mark.slow
def test_pointing_zooming_and_choosing(report: Path, tmp_path: Path) -> None:
    # Frames are rare without a screen, so that what waits for one is done at once.
    at_once = "<body><script>window.requestAnimationFrame = draw => draw();</script>"
    page = tmp_path / "tried.html"
    page.write_text(report.read_text("utf-8").replace("<body>", at_once, 1), "utf-8")
    found = noted(page, tmp_path, STEPS)
    assert found.pop("ready") == "yes"
    assert len({found.pop(name) for name in ("whole", "wheel", "drag")}) == 3
    assert found.pop("now") == 2  # the pose on both trajectories
    assert found.pop("cursors") == 9  # all curves over time
    assert found.pop("none") == 0
    names = {"zoomed", "label", "chosen", "pinched", "left", "one", "all", "linked", "slid"}
    assert found == dict.fromkeys(names, True)


@pytest.mark.slow
@pytest.mark.parametrize("size", ["1200,900", "400,800"])
def test_a_screenshot_is_not_blank(report: Path, tmp_path: Path, size: str) -> None:
    picture = tmp_path / "shot.png"
    look(report.as_uri(), tmp_path / "profile", f"--screenshot={picture}", size=size)
    seen = matplotlib.image.imread(picture)[..., :3]
    assert seen.shape[:2] == tuple(int(side) for side in size.split(","))[::-1]
    assert np.mean(np.abs(seen - seen[0, 0]).max(axis=2) > 0.05) > 0.02
    colours = np.unique((31.0 * seen.reshape(-1, 3)).astype(int), axis=0)
    assert len(colours) > 50
