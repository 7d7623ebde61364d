"""Legitimate designs of a filter agree, with a trace and without; broken ones of them do not."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from comparisons.audit.audit import audit
from comparisons.checks.grade import GRADES
from comparisons.config import CheckConfig
from comparisons.estimates.external import ExternalEstimate, read_external
from comparisons.fingerprints.data_use import first_rows, seldom_measured, without
from comparisons.jobs.check import check
from comparisons.jobs.external_check import ExternalCheck
from comparisons.logs.log import Log
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from comparisons.pipeline.solve import Solution, solve
from research.trust.designs import BROKEN, FORMS, LOGS, Design, Filter, Quick, results, unlabelled
from research.trust.designs import read_log as read_plain
from research.trust.odometry_drives import drive
from tests.helpers import present

Checked = Callable[..., ExternalCheck]
SAMPLES = 61


class World(NamedTuple):
    """A short drive of 6 s with the smoother's solutions of it, and of it without some data."""

    folder: Path
    log: Log
    solutions: dict[int, tuple[Log, Solution]]

    def solver(self, log: Log, config: Any, progress: Any) -> Solution:
        """Solve each log once."""
        if id(log) not in self.solutions:
            self.solutions[id(log)] = log, solve(log, config, progress)
        return self.solutions[id(log)][1]

    def hand_in(
        self, design: Design, folder: Path, broken: str = "", *, traced: bool
    ) -> ExternalEstimate:
        """What a filter of a design leaves."""
        run = Filter(design, read_plain(self.folder), broken).run()
        run.write(folder, traced=traced)
        return read_external(folder)

    def check(self, given: ExternalEstimate) -> ExternalCheck:
        """What is said of it."""
        return check(self.log, given, CheckConfig(), solver=self.solver)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    folder = tmp_path_factory.mktemp("designs") / "log"
    write_log_folder(drive(3, "velocity", SAMPLES), folder)
    return World(folder, read_log_folder(folder), {})


@pytest.fixture
def no_names() -> Iterator[None]:
    """The searches for the names of faults take long, and acquit nobody here."""
    with Quick():
        yield


TRACED = (
    "joint, ranges before bearings",
    "scalars",
    "scalars, bearing first",
    "map first, scalars",
    "delayed by clones",
    "pruned on the way, by landmark",
    "iterated",
    "iterated, by landmark, Joseph",
)


@pytest.mark.parametrize("name", TRACED)
def test_a_trace_of_any_design_is_taken_as_it_is(tmp_path: Path, world: World, name: str) -> None:
    """Its equations lead to the estimate, and are the models', to rounding."""
    found = world.check(world.hand_in(FORMS[name], tmp_path / "e", traced=True))
    trace = present(found.trace)
    assert found.outcome == "agree", found.causes
    assert not trace.verdict.causes
    for gap in (present(trace.algebra), trace.agreement.model):
        assert max(gap.sigma, gap.covariance) < 1e-8


@pytest.mark.parametrize("name", ["scalars", "delayed by clones", "iterated"])
def test_audit_takes_what_check_takes(tmp_path: Path, world: World, name: str) -> None:
    world.hand_in(FORMS[name], tmp_path / "e", traced=True)
    found = audit(tmp_path / "e" / "filter.trace")
    assert not [one.text for one in found.findings if one.fault]
    assert found.gains_compared > 10


@pytest.mark.parametrize("name", ["scalars", "map first", "iterated", "delayed by clones"])
@pytest.mark.parametrize("broken", BROKEN)
def test_a_broken_filter_of_the_same_design_disagrees(
    tmp_path: Path, world: World, no_names: None, name: str, broken: str
) -> None:
    found = world.check(world.hand_in(FORMS[name], tmp_path / "e", broken, traced=True))
    causes = {one.gap for one in present(found.trace).verdict.causes}
    assert found.outcome == "disagree"
    assert causes & {"algebra", "model"}


def test_innovations_of_single_entries_are_judged_by_entry(tmp_path: Path, world: World) -> None:
    found = world.check(world.hand_in(FORMS["scalars"], tmp_path / "e", traced=True))
    names = {one.sensor: [nis.dof for nis in one.nis] for one in present(found.trace).sensors}
    assert names == {"range of measurements": [1], "bearing of measurements": [1]}


def test_an_entry_used_twice_is_named(tmp_path: Path, world: World) -> None:
    """The bearing of each measurement, twice; so range and bearing of the others, once each."""

    class Twice(Filter):
        def known_update(
            self, ks: list[int], names: list[str], rows: NDArray[np.intp] | None = None
        ) -> None:
            super().known_update(ks, names, rows)
            if rows is not None and rows[0] == 1:
                super().known_update(ks, names, rows)

    Twice(FORMS["scalars"], read_plain(world.folder)).run().write(tmp_path / "e", traced=True)
    found = world.check(read_external(tmp_path / "e"))
    assert found.outcome == "disagree"
    assert "are used more than once, with up to 2 times" in found.causes[0].evidence


LEFT_OUT = {
    "first dropped": "the first of each landmark",
    "gate of 99 %": "those beyond a gate of 9.21, the 99 % of two degrees of freedom",
    "first dropped, gate of 95 %": "the first of each landmark and those beyond a gate of 5.99",
}


@pytest.mark.parametrize("traced", [True, False])
@pytest.mark.parametrize("name", LEFT_OUT)
def test_what_is_left_out_on_purpose_is_a_remark(
    tmp_path: Path, world: World, name: str, traced: bool
) -> None:
    found = world.check(world.hand_in(FORMS[name], tmp_path / "e", traced=traced))
    assert (found.outcome, found.grade.value) == ("agree", "equal"), found.causes
    (said,) = [one for one in found.remarks if "leaves out" in one]
    assert LEFT_OUT[name] in said
    run = Filter(FORMS[name], read_plain(world.folder)).run()
    used = {
        int(k)
        for call, _, more in run.calls
        if call in ("update", "augment")
        for k in np.ravel(more["numbers"])
    }
    count = len(world.log.measurements.landmark)
    assert said.startswith(f"the filter leaves out {count - len(used)} of {count} measurements: ")


class Careless(Filter):
    """Loses every seventh measurement, by no rule."""

    def fuse(self, ks: list[int]) -> None:
        """Use the others."""
        if kept := [k for k in ks if k % 7]:
            super().fuse(kept)


@pytest.mark.parametrize("traced", [True, False])
def test_what_is_lost_by_no_rule_is_no_design(
    tmp_path: Path, world: World, no_names: None, traced: bool
) -> None:
    Careless(Design(), read_plain(world.folder)).run().write(tmp_path / "e", traced=traced)
    found = world.check(read_external(tmp_path / "e"))
    assert not any("leaves out" in one for one in found.remarks)
    assert found.outcome == "disagree"


@pytest.mark.parametrize("broken", ["sign", "noise"])
@pytest.mark.parametrize("traced", [True, False])
def test_a_rule_does_not_excuse_a_fault(
    tmp_path: Path, world: World, no_names: None, traced: bool, broken: str
) -> None:
    given = world.hand_in(FORMS["first dropped"], tmp_path / "e", broken, traced=traced)
    assert world.check(given).outcome == "disagree"


def test_removed_landmarks_are_said_and_not_missing(tmp_path: Path, world: World) -> None:
    """With a trace by its events, without by the number of measurements."""
    counts = np.unique(world.log.measurements.landmark, return_counts=True)[1]
    fewest = int(counts.min())
    assert fewest < counts.max()
    few = f"those with fewer than {fewest + 1}"
    for traced, words in ((True, "which its filter removed"), (False, few)):
        folder = tmp_path / str(traced)
        found = world.check(world.hand_in(Design(prune=fewest + 1), folder, traced=traced))
        assert (found.outcome, found.grade.value) == ("agree", "equal"), found.causes
        (said,) = [one for one in found.remarks if "that the map lacks" in one]
        assert words in said


def test_a_landmark_that_is_lacking_by_no_rule_is_missing(tmp_path: Path, world: World) -> None:
    """That with the most measurements."""
    world.hand_in(Design(), tmp_path / "e", traced=False)
    labels, counts = np.unique(world.log.measurements.landmark, return_counts=True)
    place = tmp_path / "e" / "landmarks.csv"
    head, *lines = place.read_text().splitlines()
    keep = [k for k, one in enumerate(lines) if int(one.split(",")[0]) != labels[counts.argmax()]]
    place.write_text("\n".join([head, *(lines[k] for k in keep)]) + "\n")
    with np.load(tmp_path / "e" / "covariances.npz") as archive:
        pose, joint = archive["pose"], archive["last_pose_and_landmarks"]
    rows = np.concatenate(([0, 1, 2], *([3 + 2 * k, 4 + 2 * k] for k in keep)))
    np.savez(
        tmp_path / "e" / "covariances.npz",
        pose=pose,
        last_pose_and_landmarks=joint[np.ix_(rows, rows)],
    )
    found = world.check(read_external(tmp_path / "e"))
    assert found.outcome == "disagree"
    assert "1 of" in found.causes[0].evidence
    assert "missing in the map" in found.causes[0].evidence


def test_another_start_without_effect_is_a_remark(tmp_path: Path, world: World) -> None:
    """A start that is exact either way, beside what a measurement tells."""
    found = world.check(world.hand_in(FORMS["another prior"], tmp_path / "e", traced=False))
    assert found.outcome == "agree", found.causes
    assert any("without it the last pose and the map differ by" in one for one in found.remarks)


@pytest.fixture(scope="module")
def nameless(tmp_path_factory: pytest.TempPathFactory) -> World:
    """The same without labels, and with landmarks that are not near each other."""
    folder = tmp_path_factory.mktemp("nameless") / "log"
    write_log_folder(unlabelled(drive(3, "velocity", SAMPLES)), folder)
    return World(folder, read_log_folder(folder), {})


class Doubling(Filter):
    """Begins a second landmark where a first one is, for one of them after 3 s."""

    def labelled(self, ks: list[int]) -> list[int]:
        """Return labels as the filter does, but for the first of the later ones."""
        found = super().labelled(ks)
        if self.log.seen_s[ks[0]] > 3.0:
            found[0] = 99
        return found


def test_a_map_tells_labels_that_a_log_lacks(
    tmp_path: Path, nameless: World, no_names: None
) -> None:
    """If the optimum by these is plausible; a landmark that is there twice is not."""
    right = nameless.check(nameless.hand_in(Design(), tmp_path / "right", traced=False))
    assert (right.outcome, right.grade.value) == ("agree", "equal"), right.causes
    twice = Doubling(Design(), read_plain(nameless.folder)).run()
    twice.write(tmp_path / "twice", traced=False)
    assert nameless.check(read_external(tmp_path / "twice")).outcome != "agree"
    for broken in ("noise", "cross"):
        given = nameless.hand_in(Design(), tmp_path / broken, broken, traced=False)
        assert nameless.check(given).outcome != "agree"


def test_rules_of_rows() -> None:
    label = np.array([4, 4, 7, -1, 7, 4, 9])
    assert first_rows(label, 1).tolist() == [0, 2, 6]
    assert first_rows(label, 2).tolist() == [0, 1, 2, 4, 6]
    assert seldom_measured(label, np.array([9])) == 1
    assert seldom_measured(label, np.array([9, 7])) == 2
    assert seldom_measured(label, np.array([7])) == 0
    assert seldom_measured(label, np.array([4, 7, 9])) == 0
    assert seldom_measured(label, np.array([5])) == 0


def test_a_log_keeps_its_instants_without_some_measurements(world: World) -> None:
    other = without(world.log, np.array([0, 5]), 9.0)
    assert other.measurements.labelled
    assert np.array_equal(other.measurements.time_s, world.log.measurements.time_s)
    assert other.measurements.label_gate == 9.0
    assert (other.measurements.landmark[[0, 5]] == -1).all()
    assert world.log.measurements.label_gate == np.inf


@pytest.mark.nightly
@pytest.mark.parametrize("name", [name for name in LOGS if name != "MR.CLAM"])
def test_no_design_is_convicted_or_refused(name: str) -> None:
    """Each on this log, with a trace and without.

    A prior of its own is another estimate where it has an effect, and is what is named.
    """
    wrong = [one for one in results([name], FORMS, [""]) if one.code]
    assert all(one.form == "another prior" and "prior" in one.said for one in wrong), wrong


def test_there_are_enough_designs() -> None:
    assert len(FORMS) >= 32
    assert len(set(FORMS.values())) == len(FORMS)
    assert GRADES[0] == "wrong"
