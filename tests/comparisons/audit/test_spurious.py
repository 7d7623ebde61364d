"""What a filter has learnt of directions that its sensors cannot tell."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from comparisons.arrays import Array, Index
from comparisons.audit.replay import BlockLayout
from comparisons.audit.spurious import (
    MOST_POINTS,
    PARTS,
    Learnt,
    LearntDirection,
    _Stretch,
    _Whole,
    learnt,
    unit_of,
)
from comparisons.experiments.montecarlo.runs import FILTERS
from comparisons.experiments.scenarios.world import ScenarioWorld, measure
from comparisons.experiments.variants.batch_ekf import BatchEkf, BatchFilter, BatchInvariantEkf
from comparisons.trace.events import (
    Augment,
    Clone,
    Directions,
    Event,
    Predict,
    Remove,
    Reset,
    Snapshot,
    TracePrior,
    Update,
)
from ekf_reference.core.landmark_types import LandmarkKind
from ekf_reference.core.linearisation import FirstEstimates, MeanState, Points
from research.recorded_batch import record
from tests.comparisons.montecarlo.worlds import short_world
from tests.helpers import present

BLIND = "camera"
HEADING_ONLY = LearntDirection("heading", "deg", 3.0, {}, None)


class Written:
    """A trace that is written down by hand."""

    def __init__(self, blocks: dict[str, int], covariance: Array) -> None:
        self.events: list[Event] = [
            TracePrior(0, 0.0, tuple(blocks), tuple(blocks.values()), np.asarray(covariance, float))
        ]

    def _at(self) -> tuple[int, float]:
        return len(self.events), 0.5 * len(self.events)

    def directions(self, basis: Array, names: tuple[str, ...], blocks: tuple[str, ...]) -> None:
        found = np.asarray(basis, float)
        self.events.append(Directions(*self._at(), blocks, found, names, (BLIND,)))

    def update(
        self, h: Array, r: Array, blocks: tuple[str, ...], sensor: str = BLIND, *, used: bool = True
    ) -> None:
        h, r = np.atleast_2d(np.asarray(h, float)), np.atleast_2d(np.asarray(r, float))
        z = np.zeros(len(h))
        self.events.append(Update(*self._at(), sensor, blocks, z, h, r, used, None, None))

    def add(self, kind: Callable[..., Event], *arguments: object) -> None:
        self.events.append(kind(*self._at(), *arguments))

    def learnt(self) -> Learnt:
        return present(learnt(self.events))


def two_landmarks(moved: float = 0.0, unit: float = 1.0) -> Written:
    """A vehicle on a line, unknown shift; landmarks at 2 and 5 m seen before and after a step.

    moved: the second measurement of the first landmark is taken for (1 + moved) times its offset.
    unit: how many units of length are a metre.
    """
    one, square = np.eye(1), unit**2 * np.eye(1)
    trace = Written({"pose": 1}, square)
    trace.directions(one, ("shift",), ("pose",))
    trace.add(Augment, "a", ("pose",), one, one, 0.04 * square)
    trace.add(Augment, "b", ("pose",), one, one, 0.04 * square)
    trace.add(Predict, ("pose",), one, 0.01 * square)
    trace.update(np.array([-1.0, 1.0 + moved]), 0.04 * square, ("pose", "a"))
    trace.update(np.array([-1.0, 1.0]), 0.04 * square, ("pose", "b"))
    return trace


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_a_unit_of_length_changes_no_sigma(unit: float) -> None:
    plain, other = (two_landmarks(0.5, one).learnt().directions[0] for one in (1.0, unit))
    assert np.isclose(other.sigma / unit, plain.sigma, rtol=1e-9)


def test_by_hand() -> None:
    """With alpha = 1 the first residual is 0.5; landmark 0.04, step 0.01, measurement 0.04.

    Its variance is 1.5^2 0.04 + 0.01 + 0.04. The second is expected to see what the first has told
    of the step, -0.01 / 0.14 of 0.5 with variance 0.01 - 0.01^2 / 0.14.
    """
    assert two_landmarks().learnt().directions[0].information == 0.0
    found = two_landmarks(0.5).learnt()
    first = 1.5**2 * 0.04 + 0.01 + 0.04
    step = 0.01 - 0.01**2 / first
    second = step + 0.04 + 0.04
    shares = 0.5**2 / first, (0.01 / first * 0.5) ** 2 / second
    assert np.isclose(found.directions[0].information, sum(shares), rtol=1e-14)
    assert np.allclose(found.growth[:, 0], np.cumsum((0.0, *shares)), rtol=1e-14)
    assert found.event.tolist() == [1, 5, 6]
    assert found.time_s.tolist() == [0.5, 2.5, 3.0]
    largest = present(found.directions[0].largest)
    assert largest[:3] == (5, 2.5, BLIND)
    assert np.isclose(largest.information, shares[0], rtol=1e-14)
    assert largest.blocks == ("pose", "a")
    assert found.directions[0].unit == "m"
    assert np.isclose(found.directions[0].sigma, sum(shares) ** -0.5, rtol=1e-14)


def test_neither_what_was_rejected_nor_what_can_tell_counts() -> None:
    trace = two_landmarks(0.5)
    before = trace.learnt().information
    trace.update(np.array([1.0]), np.array([[1e-4]]), ("pose",), "gps")
    trace.update(np.array([-1.0, 3.0]), np.array([[0.04]]), ("pose", "a"), used=False)
    assert np.array_equal(trace.learnt().information, before)
    trace.update(np.array([1.0]), np.array([[1e-4]]), ("pose",))
    assert trace.learnt().information[0, 0] > before[0, 0] + 10.0


def random_trace(seed: int, directions: int = 2) -> Written:
    """Every kind of event, of no particular meaning: all of it tells of the directions.

    A name that has become free is used again, for a block of another size.
    """
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(5, 5))
    trace = Written({"pose": 3, "bias": 2}, root @ root.T)
    names = ("yaw", "east", "north")[:directions]
    trace.directions(rng.normal(size=(3, directions)), names, ("pose",))
    both = ("pose", "bias")
    for k in range(3):
        name, copy = f"point {k}", "point 0" if k else "clone"
        spread = np.diag(rng.uniform(0.1, 1.0, 2))
        trace.add(Augment, name, both, rng.normal(size=(2, 5)), rng.normal(size=(2, 2)), spread)
        trace.add(Predict, both, rng.normal(size=(5, 5)), np.diag(rng.uniform(0.1, 1.0, 5)))
        trace.add(Clone, copy, "pose")
        trace.update(rng.normal(size=(2, 5)), np.diag(rng.uniform(0.1, 1.0, 2)), (name, copy))
        trace.add(Reset, ("bias",), rng.normal(size=(2, 2)))
        trace.update(rng.normal(size=(1, 7)), np.array([[0.3]]), ("bias", "pose", name))
        trace.add(Snapshot, ("pose",), np.eye(3), None, None)
        trace.add(Remove, (copy,) if k else (copy, name))
    return trace


class Definition:
    """One linear model of all that was measured: z = A alpha + B w, w ~ N(0, I).

    Every block is followed as a function of alpha and of every noise there ever was, its columns.
    """

    def __init__(self, prior: TracePrior, directions: Directions, noises: int) -> None:
        self.d, self.free = directions.basis.shape[1], directions.basis.shape[1]
        self.columns, self.blind = self.d + len(prior.covariance) + noises, directions.blind
        n = np.zeros((len(prior.covariance), self.d))
        n[: len(directions.basis)] = directions.basis
        inside = np.linalg.inv(n.T @ np.linalg.inv(prior.covariance) @ n)
        whole = self.noise(prior.covariance - n @ inside @ n.T)
        whole[:, : self.d] = n
        self.of = dict(zip(prior.blocks, np.split(whole, np.cumsum(prior.dims)[:-1]), strict=True))
        self.rows: list[Array] = []

    def noise(self, covariance: Array) -> Array:
        """Return columns of their own for a noise."""
        values, axes = np.linalg.eigh(covariance)
        columns = np.zeros((len(covariance), self.columns))
        columns[:, self.free : self.free + len(values)] = axes * np.sqrt(np.maximum(values, 0.0))
        self.free += len(values)
        return columns

    def take(self, event: Event) -> None:
        """Follow one event."""
        if isinstance(event, Clone):
            self.of[event.name] = self.of[event.source]
        if not isinstance(event, Predict | Reset | Augment | Update):
            return
        if isinstance(event, Update) and event.sensor not in self.blind:
            return
        parts = [self.of[b] for b in event.blocks]
        moved: Array = event.jacobian @ np.vstack(parts)
        if isinstance(event, Augment):
            self.of[event.name] = moved + event.noise_jacobian @ self.noise(event.noise)
            return
        if not isinstance(event, Reset):
            moved = moved + self.noise(event.noise)
        if isinstance(event, Update):
            self.rows.append(moved)
            return
        ends = np.cumsum([len(one) for one in parts])
        self.of.update(zip(event.blocks, np.split(moved, ends[:-1]), strict=True))

    def information(self) -> Array:
        """A^T (B B^T)^-1 A."""
        whole = np.vstack(self.rows)
        a, b = whole[:, : self.d], whole[:, self.d :]
        result: Array = a.T @ np.linalg.solve(b @ b.T, a)
        return result


def by_definition(events: Sequence[Event]) -> Array:
    prior, directions, *others = events
    assert isinstance(prior, TracePrior)
    assert isinstance(directions, Directions)
    noisy = [e for e in others if isinstance(e, Predict | Augment | Update)]
    model = Definition(prior, directions, sum(len(e.noise) for e in noisy))
    for event in others:
        model.take(event)
    return model.information()


@pytest.mark.parametrize("most", [1, 2, 4, 1000])
@pytest.mark.parametrize("seed", range(3))
def test_the_recursion_is_the_definition(
    seed: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many blocks a stretch may touch."""
    monkeypatch.setattr("comparisons.audit.spurious.MOST_BLOCKS", most)
    trace = random_trace(seed)
    found, expected = trace.learnt(), by_definition(trace.events)
    assert np.allclose(found.information, expected, rtol=1e-9, atol=1e-9 * expected.max())
    marginal = 1.0 / np.diag(np.linalg.inv(expected))
    assert np.allclose([d.information for d in found.directions], marginal, rtol=1e-8)
    assert np.allclose(found.growth[-1], marginal, rtol=1e-8)
    yaw = found.directions[0]
    assert yaw.unit == "deg"
    assert np.isclose(yaw.sigma, np.degrees(marginal[0] ** -0.5), rtol=1e-8)
    assert np.isclose(yaw.by_sensor[BLIND], expected[0, 0], rtol=1e-9)


def test_the_curve_and_the_largest_share_are_those_of_what_there_was_until_then() -> None:
    """By brute force: what the trace holds until each update, less what it held before."""
    trace = random_trace(1)
    found = trace.learnt()
    held = [by_definition(trace.events[: number + 1]) for number in found.event[1:]]
    marginal = [1.0 / np.diag(np.linalg.inv(one)) for one in held[1:]]
    assert np.allclose(found.growth[2:], marginal, rtol=1e-8)
    gained = np.diff([np.diag(one) for one in held], axis=0, prepend=0.0)
    for i, one in enumerate(found.directions):
        assert one.largest is not None
        assert one.largest.event == found.event[1 + gained[:, i].argmax()]
        assert np.isclose(one.largest.information, gained[:, i].max(), rtol=1e-9)


def test_the_measurement_that_told_most_is_named() -> None:
    """Three landmarks in one update, the last of them taken for twice as far."""
    one, landmarks = np.eye(1), ("a", "b", "c")
    trace = Written({"pose": 1}, one)
    trace.directions(one, ("shift",), ("pose",))
    for name in landmarks:
        trace.add(Augment, name, ("pose",), one, one, 0.04 * one)
    h = np.column_stack((-np.ones(3), np.diag([1.0, 1.0, 2.0])))
    trace.update(h, 0.04 * np.eye(3), ("pose", *landmarks))
    largest = present(trace.learnt().directions[0].largest)
    assert largest.blocks == ("pose", "c")
    assert largest.seen == "c"


def test_the_part_in_which_most_was_learnt() -> None:
    told = np.concatenate((np.zeros(1001), np.linspace(0.0, 2.0, 41), np.linspace(2, 3, 959)))
    growth: Array = told[:, None]
    number, time_s = np.arange(len(growth)), 0.5 * np.arange(len(growth), dtype=np.float64)
    found = Learnt((HEADING_ONLY,), np.eye(1), number, time_s, growth)
    time_s, information = found.curve("heading")
    assert len(time_s) == PARTS + 1
    assert (information[0], information[-1]) == (0.0, 3.0)
    begin_s, end_s, gained = found.fastest("heading")
    assert 500.0 <= begin_s < end_s <= 520.5
    assert end_s - begin_s == 10.0
    assert np.isclose(gained, 1.0)
    alone = Learnt((HEADING_ONLY,), np.eye(1), number[:1], np.zeros(1), np.zeros((1, 1)))
    assert alone.fastest("heading") == (0.0, 0.0, 0.0)


class NoAlphaAfterUpdates(_Stretch):
    """Broken: what an update has told is not taken from the rest."""

    def fuse(self, event: Update) -> tuple[Array, Array] | None:
        alpha = slice(self.size, self.fixed)
        u = self.rows[:, alpha].copy()
        found = super().fuse(event)
        self.rows[:, alpha] = u
        return found


class NothingToOthers(_Whole):
    """Broken: blocks that a stretch does not touch learn nothing of it."""

    def take_over(self, stretch: _Stretch) -> None:
        stretch.told.clear()
        super().take_over(stretch)


class PriorKept(_Whole):
    """Broken: the prior tells the directions, too."""

    def __init__(self, layout: BlockLayout, covariance: Array, u: Array) -> None:
        super().__init__(layout, covariance + u @ u.T, u)


@pytest.mark.parametrize("broken", [NoAlphaAfterUpdates, NothingToOthers, PriorKept])
def test_broken_recursions_are_rejected(
    broken: type[_Stretch | _Whole], monkeypatch: pytest.MonkeyPatch
) -> None:
    trace = random_trace(0)
    expected = by_definition(trace.events)
    monkeypatch.setattr("comparisons.audit.spurious.MOST_BLOCKS", 1)
    assert np.allclose(trace.learnt().information, expected, rtol=1e-9)
    monkeypatch.setattr(f"comparisons.audit.spurious.{broken.__mro__[1].__name__}", broken)
    assert not np.allclose(trace.learnt().information, expected, rtol=1e-3)


class NewestLandmarks(FirstEstimates):
    """Broken: one Jacobian of FEJ, that by the landmarks, is taken at their newest estimates."""

    def measurement(
        self, state: MeanState, landmark_index: Index, kind: LandmarkKind
    ) -> Points | None:
        return self.predicted, state.places(kind)[..., landmark_index, :]


def learnt_on_the_circle(filter_: BatchFilter, place: ScenarioWorld) -> Learnt:
    """What the filter has learnt in the second of two runs."""
    events: list[Event] = []
    assert isinstance(filter_, BatchEkf | BatchInvariantEkf)
    record(filter_, len(place.landmark), {1: events.append})
    data = measure(place, range(2))
    for k, seen in enumerate(place.seen):
        filter_.predict(data.control[:, k])
        if len(seen):
            filter_.observe(data.z[k], place.sigma[k], seen)
    return present(learnt(events))


@pytest.fixture(scope="module")
def circle() -> ScenarioWorld:
    return short_world("circle", 300)


def test_the_ekf_learns_its_heading_on_the_circle(circle: ScenarioWorld) -> None:
    found = learnt_on_the_circle(FILTERS["ekf"](circle, 2), circle)
    east, north, heading = found.directions
    assert east.information == north.information == 0.0
    assert heading.information > 50.0
    assert (np.diff(found.growth[:, 2]) >= 0.0).all()


@pytest.mark.parametrize("name", ["fej", "oc", "riekf", "ideal"])
def test_consistent_variants_learn_nothing(name: str, circle: ScenarioWorld) -> None:
    found = learnt_on_the_circle(FILTERS[name](circle, 2), circle)
    assert [one.information for one in found.directions] == [0.0, 0.0, 0.0]
    assert np.abs(found.information).max() < 1e-20
    assert [one.largest for one in found.directions] == [None, None, None]


def test_a_broken_fej_is_found(circle: ScenarioWorld) -> None:
    broken = BatchEkf(circle.robot, NewestLandmarks(), 2, len(circle.landmark))
    assert learnt_on_the_circle(broken, circle).directions[2].information > 1.0


def test_the_curve_is_bounded_and_ends_with_all() -> None:
    one = np.eye(1)
    trace = Written({"pose": 1}, one)
    trace.directions(one, ("shift",), ("pose",))
    for _ in range(3 * MOST_POINTS + 7):
        trace.update(np.array([1.0]), one, ("pose",))
    found = trace.learnt()
    assert MOST_POINTS / 2 <= len(found.event) - 1 <= MOST_POINTS
    assert found.event[-1] == len(trace.events) - 1
    assert np.isclose(found.growth[-1, 0], 3 * MOST_POINTS + 7)
    assert (np.diff(found.event) > 0).all()


def test_without_directions_there_is_nothing_to_say() -> None:
    assert learnt(Written({"pose": 1}, np.eye(1)).events) is None


def test_a_direction_that_is_rounding_explains_no_other() -> None:
    """Its information is 1e-30, its correlation with the other one nearly 1."""
    trace = Written({"pose": 2}, np.eye(2))
    trace.directions(np.eye(2), ("east", "yaw"), ("pose",))
    trace.add(Augment, "ahead", ("pose",), np.array([[1.0, 0.0]]), np.eye(1), 1e-6 * np.eye(1))
    trace.update(np.array([-1.0 + 1e-15, 1.0, 1.0]), np.eye(1), ("pose", "ahead"))
    found = trace.learnt()
    assert 0.0 < found.information[0, 0] < 1e-28
    assert found.directions[0].information == 0.0
    assert np.isclose(found.directions[1].information, 1.0)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("heading", "deg"), ("yaw about gravity", "deg"), ("north", "m"), ("x", "m"), ("scale", "")],
)
def test_units_follow_names(name: str, unit: str) -> None:
    assert unit_of(name) == unit
