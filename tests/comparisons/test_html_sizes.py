"""report.html at 1400 and 390 pixels, light and dark: nothing overflows, nothing is hard to see."""

import shutil
from pathlib import Path

import pytest

from comparisons.report.run import RunReport
from comparisons.words import Cause
from tests.comparisons.browser import look, noted
from tests.helpers import compared, simulated, written

pytestmark = [pytest.mark.browser, pytest.mark.slow]

LOOK = """
const root = document.documentElement, frame = document.getElementById('frame');
document.querySelectorAll('details').forEach(one => { one.open = true; });
noted.over = root.scrollWidth - root.clientWidth;
const lines = node => {
  const range = document.createRange();
  range.selectNodeContents(node);
  return new Set([...range.getClientRects()].map(r => Math.round(r.top))).size;
};
noted.broken = [...document.querySelectorAll('.sortable td')].filter(c => lines(c) > 1).length;
const part = c => c.match(/[\\d.]+/g).slice(0, 3).map(v => v / 255)
  .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
const light = c => part(c).reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
const contrast = (a, b) => {
  const [low, high] = [light(a), light(b)].sort((x, y) => x - y);
  return (high + 0.05) / (low + 0.05);
};
const style = one => getComputedStyle(one), ground = style(document.body).backgroundColor;
noted.ground = light(ground);
noted.words = Math.min(...['.words', '.cause', '.hint', '.note', 'dd', 'dt', 'summary', 'td', 'th']
  .flatMap(name => [...document.querySelectorAll(name)].slice(0, 3))
  .map(one => contrast(style(one).color, ground)));
noted.ladder = Math.min(...[...document.querySelectorAll('.ladder text')]
  .map(one => contrast(style(one).fill, ground)));
noted.map = Math.min(...[...document.querySelectorAll('#map .layer:not(.filled)')]
  .map(one => contrast(style(one).stroke, style(frame).backgroundColor)));
noted.letters = Math.min(...[...document.querySelectorAll('.ladder text')]
  .map(one => one.getBoundingClientRect().height));
const svg = document.querySelector('.ladder svg').getBoundingClientRect();
const where = document.getElementById('where'), times = document.getElementById('times');
noted.share = frame.getBoundingClientRect().width / where.getBoundingClientRect().width;
noted.top = frame.getBoundingClientRect().top;
noted.below = ['where', 'when'].map(name => {
  document.getElementById(name).scrollIntoView();
  return times.getBoundingClientRect().bottom - innerHeight;
});
noted.outside = [...document.querySelectorAll('.ladder text')]
  .filter(one => one.getBoundingClientRect().right > svg.right).length;
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with a cause and its own association, whose branch is the narrowest of the ladder."""
    found = compared(simulated(seed=2, loop_s=20.0), smoother_association="own")
    cause = Cause(gap="model", evidence="a number 1234567.8901 " * 20, hint="look " * 30)
    result = RunReport.build(found).model_copy(update={"causes": [cause], "verdict": "disagree"})
    return written(found, tmp_path_factory.mktemp("run") / "report", result) / "report.html"


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [1400, 390])
def test_everything_fits_and_can_be_read(
    report: Path, tmp_path: Path, width: int, dark: bool
) -> None:
    found = noted(report, tmp_path, LOOK, width=width, dark=dark)
    assert found["over"] <= 0
    assert found["broken"] == found["outside"] == 0
    assert (found["ground"] < 0.05) == dark
    assert found["words"] >= 4.5
    assert found["ladder"] >= 4.5
    assert found["map"] >= (3.0 if dark else 2.5)
    assert found["letters"] >= 10.0
    assert found["share"] == pytest.approx(1.0)
    assert width == 390 or found["top"] < 300.0  # the map stands beside the verdict
    assert max(found["below"]) < 2.0  # the slider stays in view beside map and curves


def test_what_is_cut_or_broken_is_seen(report: Path, tmp_path: Path) -> None:
    """The broken variant: as the page was, with numbers that break, or tables that overflow."""
    text = report.read_text(encoding="utf-8")
    nowrap, scrolls = ".sortable td { white-space: nowrap; }", "overflow-x: auto"
    assert nowrap in text
    assert scrolls in text
    page = tmp_path / "broken.html"
    page.write_text(text.replace(nowrap, ".sortable td { overflow-wrap: anywhere; }"))
    assert noted(page, tmp_path, LOOK, width=390)["broken"] > 0
    wide = "<main><table><td>" + "9" * 80 + "</td></table>"
    page.write_text(text.replace("<main>", wide))
    assert noted(page, tmp_path, LOOK, width=390)["over"] > 0
    stays = "position: sticky; bottom: 0;"
    assert stays in text
    page.write_text(text.replace(stays, ""))
    assert max(noted(page, tmp_path, LOOK, width=390)["below"]) > 100.0


def test_tables_say_that_they_are_cut(report: Path, tmp_path: Path) -> None:
    """Of what lies to the right, and of what lies below; nothing where all is seen."""
    steps = """
    await new Promise(done => setTimeout(done, 100));
    const boxes = [...document.querySelectorAll('.held, .sideways, .scroll')];
    const beside = box => box.scrollWidth > box.clientWidth + 1;
    const below = box => box.scrollHeight > box.clientHeight + 1;
    noted.said = boxes.map(box => box.previousElementSibling.hidden ? ''
      : box.previousElementSibling.textContent);
    noted.beside = boxes.map(beside);
    noted.below = boxes.map(below);
    """
    for width in (1400, 390):
        found = noted(report, tmp_path, steps, width=width)
        assert ["move the table sideways" in said for said in found["said"]] == found["beside"]
        assert ["rows: scroll the table" in said for said in found["said"]] == found["below"]
        assert any(found["below"])
        assert any(found["beside"]) == (width == 390)


COPY = """
const again = document.getElementById('again'), button = again.querySelector('button');
noted.hidden = button.hidden;
noted.command = again.querySelector('code').textContent;
Object.defineProperty(navigator, 'clipboard', { value: CLIPBOARD });
document.execCommand = () => false;
button.click();
await new Promise(done => setTimeout(done, 50));
noted.selected = String(getSelection());
noted.said = again.querySelector('[role=status]').textContent;
"""


def test_the_button_copies_or_selects(report: Path, tmp_path: Path) -> None:
    """The command names the folder that the page lies in, and can be taken by hand."""
    folder = tmp_path / "it's here"
    folder.mkdir()
    page = shutil.copy(report, folder)
    refused = noted(Path(page), folder, COPY.replace("CLIPBOARD", "undefined"))
    quoted = str(folder).replace("'", "'\\''")
    assert refused["command"] == f"slamcheck run '{quoted}/config.toml'"
    assert refused["hidden"] is False
    assert refused["selected"] == refused["command"]
    assert refused["said"].startswith("Selected")
    taken = "{ writeText: async text => { noted.copied = text; } }"
    copied = noted(Path(page), folder, COPY.replace("CLIPBOARD", taken))
    assert copied["copied"] == copied["command"]
    assert copied["said"] == "Copied."


def test_paper_shows_what_is_folded(report: Path, tmp_path: Path) -> None:
    """Details open for the printer, and close again."""
    steps = """
    const open = () => document.querySelectorAll('details[open]').length;
    noted.before = open();
    dispatchEvent(new Event('beforeprint'));
    noted.printed = open() === document.querySelectorAll('details').length;
    dispatchEvent(new Event('afterprint'));
    noted.after = open();
    """
    assert noted(report, tmp_path, steps) == {"before": 0, "printed": True, "after": 0}


def test_many_landmarks_open_quickly(report: Path, tmp_path: Path) -> None:
    """A thousand rows and marks: the script is done, and a sort takes less than a second."""
    text = report.read_text(encoding="utf-8")
    body = text[text.index('<table id="landmarks"') :]
    row = body[body.index("<tr data-key") : body.index("</tr>", body.index("<tr data-key")) + 5]
    page = tmp_path / "many.html"
    page.write_text(text.replace(row, row * 1000, 1), encoding="utf-8")
    steps = """
    const start = performance.now();
    document.querySelector('#landmarks th button').click();
    noted.rows = document.querySelector('#landmarks').tBodies[0].rows.length;
    document.body.getBoundingClientRect();
    noted.seconds = (performance.now() - start) / 1000;
    """
    found = noted(page, tmp_path, steps)
    assert found["rows"] > 1000
    assert found["seconds"] < 1.0


def test_it_prints(report: Path, tmp_path: Path) -> None:
    """Chromium makes pages of it, more than one and not hundreds."""
    paper = tmp_path / "report.pdf"
    look(report.as_uri(), tmp_path / "profile", f"--print-to-pdf={paper}")
    pages = paper.read_bytes().count(b"/Type /Page\n")
    assert 3 <= pages <= 30
