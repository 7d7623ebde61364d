"""report.html: whole without a network, and safe whatever a log says."""

import json
import re
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.checks.consistency.finding import ConsistencyFinding
from comparisons.checks.finding import Finding
from comparisons.checks.gaps import GapsFinding
from comparisons.checks.settings import settings_result
from comparisons.estimates.estimate import Estimate
from comparisons.jobs.run import Comparison
from comparisons.report.explain import every_explanation
from comparisons.report.html import map as map_page
from comparisons.report.html.curves import data_block
from comparisons.report.html.drawing import Drawing
from comparisons.report.html.page import page
from comparisons.report.html.shell import DARK, figures, policy, prose, script, style, themed
from comparisons.report.html.tables import LandmarkRow, landmarks, settings
from comparisons.report.marks import Panel
from comparisons.report.models import Result
from comparisons.report.panels import consistency_panels
from comparisons.report.run import RunReport
from comparisons.report.settings import SettingLine, setting_lines
from comparisons.words import SETTINGS, SPENT, Cause, Row
from tests.helpers import altered, compared, present, simulated, written

HOSTILE = """x"><script>document.title='owned'</script><img src=http://evil/ onerror=alert(1)>'&"""


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    log = simulated(loop_s=20.0)
    provenance = {**log.provenance, HOSTILE: HOSTILE}
    return compared(replace(log, name=HOSTILE, provenance=provenance))


@pytest.fixture(scope="module")
def report(comparison: Comparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(comparison, tmp_path_factory.mktemp("run") / "report") / "report.html"


class Reader(HTMLParser):
    """Counts what opens and closes, and keeps attributes and text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.tags: list[str] = []
        self.text = ""
        self.feed(page)
        assert not self.open

    @property
    def names(self) -> set[str]:
        """Of all attributes."""
        return {name for _, name, _ in self.attributes}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in ("meta", "img", "br", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def drawn(comparison: Comparison, result: Result) -> str:
    """The page, without pictures."""
    return page(RunReport(comparison, result).page())


def read(path: Path) -> Reader:
    return Reader(path.read_text(encoding="utf-8"))


def data_of(text: str) -> dict[str, Any]:
    """What a page gives its script."""
    block = present(re.search(r'id="data">(.*?)</script>', text))
    data: dict[str, Any] = json.loads(block[1])
    return data


def test_it_is_whole_without_a_network(report: Path) -> None:
    found = read(report)
    for _, name, value in found.attributes:
        if name in ("src", "href", "xlink:href", "action"):
            assert value.startswith("data:image/png;base64,")
    assert "link" not in found.tags
    assert "url(" not in report.read_text(encoding="utf-8")
    assert ("meta", "http-equiv", "Content-Security-Policy") in found.attributes
    assert ("meta", "content", policy(style(), script())) in found.attributes


def test_what_a_log_says_is_text(report: Path) -> None:
    found = read(report)
    assert found.tags.count("script") == 2  # the data, the script
    assert not [name for name in found.names if name.startswith("on")]
    assert "&lt;script&gt;document.title" in report.read_text(encoding="utf-8")


def test_verdict_and_causes_come_first(comparison: Comparison) -> None:
    result = RunReport.build(comparison)
    cause = Cause(gap="<b>x</b>", evidence=HOSTILE, hint=HOSTILE)
    reported = result.model_copy(update={"causes": [cause], "remarks": [HOSTILE]})
    text = drawn(comparison, reported)
    order = [text.index(part) for part in ('class="verdict', 'class="cause"', 'id="map"', "<table")]
    assert order == sorted(order)
    assert "<b>x</b>" not in text
    assert text.count("<script") == 2


@pytest.mark.parametrize("kind", sorted(every_explanation()))
def test_a_cause_comes_with_what_it_means(comparison: Comparison, kind: str) -> None:
    cause = Cause(gap=kind, evidence="measured", hint="look")
    text = drawn(comparison, RunReport.build(comparison).model_copy(update={"causes": [cause]}))
    known = every_explanation()[kind]
    card = text[text.index('id="outcome"') : text.index('id="beside"')]
    sought = (escape(known.title), ">look<", ">measured<", escape(known.meaning))
    places = [card.index(part) for part in sought]
    assert places == sorted(places)
    assert escape(known.check) in card


def test_the_verdict_comes_first_then_what_to_do_and_each_fact_is_a_sentence(
    comparison: Comparison,
) -> None:
    """What to do stands at the head of each card."""
    causes = [
        Cause(gap="model", evidence="it is 3 off; two things (a; b); and 5 more", hint="mend it"),
        Cause(gap="algebra", evidence="one thing (a; b)", hint="then this."),
    ]
    text = drawn(comparison, RunReport.build(comparison).model_copy(update={"causes": causes}))
    top = text[text.index('id="outcome"') : text.index('id="beside"')]
    assert top.startswith('id="outcome"><p class="words">EKF and smoother')
    first, second = top.split('class="cause"')[1:]
    assert first.index('<p class="hint">mend it<') < first.index("<li>it is 3 off</li>")
    assert re.findall("<li>(.*?)</li>", first) == ["it is 3 off", "two things (a; b)", "and 5 more"]
    assert second.index('<p class="hint">then this.') < second.index("<p>one thing (a; b)</p>")


def test_the_page_says_where_numbers_stand_in_place_of_seconds(comparison: Comparison) -> None:
    result = RunReport.build(comparison)
    said = "pose numbers in place of seconds"
    log = result.log.model_copy(update={"provenance": {"times": said}})
    assert f"; {said}</span>" in drawn(comparison, result.model_copy(update={"log": log}))
    assert said not in drawn(comparison, result)


def test_a_number_with_an_exponent_stays_in_one_line() -> None:
    assert prose("allows 1e-06; <b>") == 'allows <span class="whole">1e-06</span>; &lt;b&gt;'
    assert prose("label-3 of e-mail 12") == "label-3 of e-mail 12"


def test_settings_that_differ_come_first(comparison: Comparison) -> None:
    config = comparison.prepared.config
    usual = setting_lines(config)
    assert not any(line.changed for line in usual)
    smoother = config.smoother.model_copy(update={"lag": 7})
    lines = setting_lines(config.model_copy(update={"smoother": smoother}))
    assert lines[0][:4] == ("smoother.lag", "7", "100", True)
    assert sorted(line.setting for line in lines) == sorted(line.setting for line in usual)
    written = set(re.findall(r"^(\w+) = ", config.toml(), re.MULTILINE))
    assert written <= {line.setting.rpartition(".")[2] for line in lines}
    text = drawn(comparison, RunReport.build(comparison))
    assert "All are at their defaults." in text
    assert all(f"<b>{line.setting}</b>" in text for line in usual)


def test_a_setting_that_is_no_documents_is_named_with_it(comparison: Comparison) -> None:
    config = comparison.prepared.config
    nearest = config.ekf.model_copy(update={"association": "nn"})
    changed = config.model_copy(update={"ekf": nearest})
    found = settings_result(changed, "simulated", nearest)
    assert found.differing
    lines = {line.setting: line for line in setting_lines(changed, found, nearest)}
    for one in found.differing:
        assert one.place in lines[one.setting].document
    assert lines["ekf.association"].changed
    assert not lines["ekf.nn_gate"].changed


def test_the_command_that_runs_it_again_is_there_without_a_script(report: Path) -> None:
    text = report.read_text(encoding="utf-8")
    assert '<code tabindex="0">slamcheck run config.toml</code>' in text
    assert '<button type="button" hidden>Copy</button>' in text
    assert (report.parent / "config.toml").is_file()


def test_every_colour_of_a_line_is_seen_on_a_dark_page(report: Path) -> None:
    """At 3 to 1 or more; without the colours for the dark several are not."""
    text = report.read_text(encoding="utf-8")
    painted = set(re.findall(r'data-name="[^"]*" stroke="([^"]*)"', text))
    painted |= {one["colour"] for p in data_of(text)["panels"] for one in p["curves"]}
    light = {re.sub(r".*(#\w{6}).*", r"\1", colour) for colour in painted}
    assert len(light) > 4
    assert {themed(colour) for colour in light} == painted
    assert all(contrast(DARK.get(colour, colour), "#1c1f23") >= 3.0 for colour in light)
    assert any(contrast(colour, "#1c1f23") < 3.3 for colour in light)
    assert all(contrast(colour, "#1c1f23") >= 4.5 for colour in DARK.values())


def contrast(first: str, second: str) -> float:
    """As WCAG defines it, of two colours like #00798c."""
    parts = [[int(c[i : i + 2], 16) / 255.0 for i in (1, 3, 5)] for c in (first, second)]
    dark, bright = sorted(
        sum(
            share * (v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4)
            for share, v in zip((0.2126, 0.7152, 0.0722), part, strict=True)
        )
        for part in parts
    )
    return (bright + 0.05) / (dark + 0.05)


def test_an_agreement_with_a_qualifier_is_no_plain_one(comparison: Comparison) -> None:
    plain = RunReport.build(comparison).model_copy(
        update={"verdict": "agree", "qualifiers": [], "inconsistent": []}
    )
    reported = plain.model_copy(
        update={"qualifiers": ["filter inconsistent"], "inconsistent": ["NIS of <b> 3"]}
    )
    before, after = (drawn(comparison, one) for one in (plain, reported))
    assert '<span class="verdict agree">agree<' in before
    assert "The filter is inconsistent" not in before
    assert '<span class="verdict unverified">agree, filter inconsistent<' in after
    assert "The filter is inconsistent: NIS of &lt;b&gt; 3." in after
    assert "<dt>Consistency</dt>" in before
    assert "<dt>Consistency</dt>" not in after, "the same figures twice"


def test_figures_are_those_of_the_terminal(comparison: Comparison, report: Path) -> None:
    text = report.read_text(encoding="utf-8")
    rows = RunReport.of(comparison).summary().rows
    assert {"Log", "EKF", "Smoother"} < {row.group for row in rows}
    for row in rows:
        mark = {True: "in", False: "out", None: ""}[row.inside]
        cells = (escape(cell) for cell in (row.quantity, row.value, row.band, mark))
        shown = f"<td>{'</td><td>'.join(cells)}</td></tr>" in text
        assert shown == (row.group not in (SETTINGS, *SPENT))  # the page has tables of these


def test_every_landmark_is_in_the_table_and_on_the_map(
    comparison: Comparison, report: Path
) -> None:
    text = report.read_text(encoding="utf-8")
    count = len(comparison.ekf.estimate.landmark)
    assert text.count("<tr data-key=") == count
    assert len(re.findall(r"<title>EKF, landmark \d+:", text)) == 2 * count
    for key in comparison.ekf.estimate.landmark_id.tolist():
        assert text.count(f'data-key="{key}"') == 4  # both estimates, the variance ratio, the row


def test_of_many_landmarks_the_farthest_apart_are_shown(
    comparison: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_page, "MOST_LANDMARKS", 5)
    blocks = comparison.agreement.landmarks
    text = drawn(comparison, RunReport.build(comparison))
    distance = np.array([block.distance_sigma for block in blocks])
    farthest = comparison.ekf.estimate.landmark_id[np.argsort(-distance)[:5]].tolist()
    rows = re.findall(r'<tr data-key="(\d+)"', text)
    assert sorted(map(int, rows)) == sorted(farthest)
    assert f"5 of {len(blocks)} landmarks" in text
    assert len(re.findall(r"<polygon", text)) == 2 * 5


def test_no_wheel_is_asked_for_where_there_is_none(comparison: Comparison) -> None:
    text = drawn(comparison, RunReport.build(comparison)).split("<main>")[1]
    assert text.count("Wheel") == len(re.findall(r'class="[^"]*mouse">Wheel', text)) == 2
    assert text.count("Pinch") == len(re.findall(r'class="[^"]*touch">Pinch', text)) == 1
    assert "@media (hover: none) { .mouse { display: none; }" in style()


def test_the_worst_landmark_comes_first(comparison: Comparison) -> None:
    """Whatever their order on the map: what disagrees, then what is farthest apart."""
    blocks = [
        replace(b, distance_sigma=sigma, agrees=sigma != 0.5)
        for b, sigma in zip(comparison.agreement.landmarks, (0.1, 0.5, np.nan, 0.3), strict=False)
    ]
    rows = [LandmarkRow(str(i), f"name {i}", block) for i, block in enumerate(blocks)]
    text = landmarks(rows, "")
    assert re.findall(r'<tr data-key="(\d+)"', text) == ["1", "2", "3", "0"]
    assert 'type="search"' in text
    assert 'type="search"' not in landmarks([], "none")


def test_every_estimate_of_an_extension_is_on_the_page(comparison: Comparison) -> None:
    """As a layer of the map, and as a curve; landmarks by their ids."""
    third = replace(
        comparison.smoothed,
        pose=comparison.smoothed.pose + (3.0, 4.0, 0.0),
        landmark_id=np.append(comparison.smoothed.landmark_id[2:], 777),
        landmark=comparison.smoothed.landmark[1:],
        joint_covariance=comparison.smoothed.joint_covariance[2:, 2:],
    )
    found = Finding()
    found.estimates = {"third": third, "plain": comparison.smoothed}
    found.titles = {"third": "a third <i>"}
    more = altered(comparison, "known.findings", {**comparison.findings, "x": found})
    text = drawn(more, RunReport.build(comparison))
    assert 'data-name="a third &lt;i&gt; trajectory"' in text
    assert 'data-name="plain landmarks"' in text
    count = len(comparison.smoothed.landmark)
    assert len(re.findall("<circle [^>]*><title>a third &lt;i&gt;, landmark", text)) == count - 2
    data = data_of(text)
    assert set(data["tracks"]) == {"smoother", "EKF", "a third <i>", "plain"}
    panel = next(p for p in data["panels"] if p["title"] == "distance from the smoother [m]")
    apart = {curve["name"]: curve["y"] for curve in panel["curves"]}
    assert set(apart) == {"EKF", "a third <i>", "plain"}
    assert set(apart["a third <i>"]) == {5}
    assert set(apart["plain"]) == {0}
    assert "distance from the smoother" not in drawn(comparison, RunReport.build(comparison))


@pytest.mark.slow
def test_a_long_log_leaves_a_page_of_less_than_5_mb(comparison: Comparison) -> None:
    """Of 100,000 poses and 1,500 landmarks, without pictures, which do not grow."""
    c, many, poses = comparison, 1500, 100_000
    which = np.arange(many) % len(c.ekf.estimate.landmark)
    entries = np.concatenate((np.arange(3), (3 + 2 * which[:, None] + (0, 1)).ravel()))
    row = np.arange(poses) % len(c.ekf.estimate.pose)

    def long(e: Estimate) -> Estimate:
        return replace(
            e,
            time_s=np.arange(float(poses)),
            pose=e.pose[row],
            pose_covariance=e.pose_covariance[row],
            landmark_id=np.arange(many),
            landmark=e.landmark[which],
            joint_covariance=e.joint_covariance[np.ix_(entries, entries)],
        )

    blocks = tuple(c.agreement.landmarks[i] for i in which.tolist())
    panels = consistency_panels(c)
    panels = replace(panels, errors=tuple(_lengthened(panel, poses) for panel in panels.errors))
    grown = altered(c, "known.run.estimate", long(c.ekf.estimate))
    grown = altered(grown, "known.kept.gaps.smoothed", long(c.smoothed))
    gaps = GapsFinding(replace(c.agreement, landmarks=blocks))
    grown = altered(grown, "known.findings", {**c.findings, "agreement": gaps})
    report = RunReport.of(grown)
    vars(report)["panels"] = panels
    text = page(report.page())
    assert len(text) < 4_000_000


def _lengthened(panel: Panel, count: int) -> Panel:
    """The panel with its curves and bands of `count` points."""

    def long(mark: Any) -> Any:
        columns = {n: v for n, v in vars(mark).items() if isinstance(v, np.ndarray)}
        return replace(mark, **{n: np.resize(v, count) for n, v in columns.items()})

    return replace(
        panel, curves=tuple(map(long, panel.curves)), bands=tuple(map(long, panel.bands))
    )


def test_north_is_up() -> None:
    drawing = Drawing.of(np.array([(0.0, 0.0), (10.0, 10.0)]))
    point = np.array([(5.0, 9.0), (5.0, 1.0)])
    drawing.marks("a", "#000", point, ["north", "south"], [1, 2])
    heights = [float(v) for v in re.findall(r'cy="([\d.]+)"', drawing.svg())]
    assert heights[0] < heights[1]


def test_what_is_not_finite_is_not_drawn() -> None:
    nothing = np.full((2, 2), np.nan)
    drawing = Drawing.of(nothing)
    drawing.marks("a", "#000", nothing, ["x", "y"], [1, 2])
    drawing.outlines("b", "#000", nothing[None], ["z"])
    drawing.dots("c", "#000", nothing)
    drawing.path("d", "#000", nothing)
    drawing.links("e", "#000", nothing, nothing)
    assert "nan" not in drawing.svg()


def test_what_broke_down_leaves_a_page(comparison: Comparison) -> None:
    """Poses, landmarks, ratios and errors that are no numbers."""
    c, ekf = comparison, comparison.ekf.estimate
    poses = present(present(c.consistency.ekf).poses)
    gone = np.where(np.arange(len(ekf.pose)) % 7 == 3, np.nan, 1.0)[:, None]
    landmark = ekf.landmark.copy()
    landmark[2] = np.inf
    blocks = tuple(
        replace(b, variance_ratio_least=np.nan, distance_sigma=np.inf)
        for b in c.agreement.landmarks
    )
    broken = altered(c, "known.run.estimate", replace(ekf, pose=gone * ekf.pose, landmark=landmark))
    gaps = GapsFinding(replace(c.agreement, landmarks=blocks))
    worse = altered(c.consistency, "ekf.poses.error", gone[1:] * poses.error)
    worse = altered(worse, "ekf.poses.sigma", gone[1:] * poses.sigma)
    findings = {**c.findings, "consistency": ConsistencyFinding(worse), "agreement": gaps}
    broken = altered(broken, "known.findings", findings)
    text = drawn(broken, RunReport.build(c))
    places = re.findall(r' (?:points|d|cx|cy|x1)="([^"]*)"', text)
    assert len(places) > 100
    assert not [place for place in places if re.search("nan|inf", place)]
    data = data_of(text)
    track = present(re.search(r'points="([^"]*)" stroke-dasharray="5 3" data-track="EKF"', text))
    assert len(track[1].split()) == len(data["tracks"]["EKF"]) == int(np.isfinite(gone).sum())
    assert None in data["panels"][0]["curves"][0]["y"]


def test_data_cannot_end_its_block() -> None:
    said = {"a": "</script><!--", "b": ["'\"&\u2028", HOSTILE]}
    text = data_block(said)
    inner = text.removeprefix('<script type="application/json" id="data">')
    inner = inner.removesuffix("</script>")
    assert not re.search("[<>&\u2028]", inner)
    assert json.loads(inner) == said
    with pytest.raises(ValueError, match="is nan"):
        data_block(float("nan"))


def test_the_script_takes_no_text_for_markup() -> None:
    assert not re.search(r"innerHTML|outerHTML|insertAdjacent|document\.write|\beval\b", script())


def test_bands_of_single_figures_are_explained() -> None:
    inside = Row("EKF NEES", "pose, mean (expected 3)", "2.4", "0.22 to 9.35 (95 %)", inside=True)
    plain = Row("Log", "coverage", "95 %")
    assert "One value in twenty" in figures([inside, plain])
    assert '<tr class="good">' in figures([inside])
    assert "One value in twenty" not in figures([plain])
    assert "good" not in figures([plain])


def test_documents_of_settings_are_named() -> None:
    line = SettingLine(
        setting="x.y", value="1", default="1", document="2 (N 5.7)", meaning="z", changed=False
    )
    assert "N: Nieto 2005" in settings([line])
    assert "N: Nieto 2005" not in settings([line._replace(document="")])
