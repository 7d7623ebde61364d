"""Which fault of its edges explains that a pose graph does not fit.

Every composition of a slot and a change (`faults.edges`) is screened by the loops that the graph
closes: what the odometry says of a closure's two poses, or of two measurements of a landmark,
beside what they say. The likeliest are solved; one is named where its optimum leaves the stated
noise, everywhere, and is likelier by far than that of the graph as it stands. Numbers are fitted by
Gauss and Newton's method with all unknowns eliminated, and named if they differ from those of no
fault. Where nothing is named, the kind of edges is that does not agree with the rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.explain.disagreement import MOST_EDGES
from comparisons.explain.edge_fits import (
    are_white,
    fitted,
    fitted_noise,
    likelihood,
    mended_graph,
    newton_step,
    openness,
    optimum_of,
    optimum_with,
    roughly,
)
from comparisons.explain.loops import loop_sizes
from comparisons.faults.edges import (
    CLOSURES,
    LANDMARKS,
    ODOMETRY,
    EdgeColumns,
    EdgeFault,
    EdgeSlot,
    changes_of_information,
    changes_of_motion,
    columns,
    faults_of,
    slots,
)
from comparisons.plane import in_own_axes
from graphslam.extreme_edges import extreme_edges
from graphslam.goodness_of_fit import Goodness, far_less, row_origins
from graphslam.graph_builder import from_values
from graphslam.optimum import ChiSquareTest
from graphslam.problem import SlamProblem
from graphslam.smoother import SmootherEvidence
from graphslam.sparse_system import column_lengths, normal_factors, scaled_columns, sparse_system

_LIKELIER = 40.0
"""Twice the logarithm of the likelihoods' ratio above which a change is no chance."""
_EACH_NUMBER = 10.0
"""What every fitted number adds to -2 log likelihood: it could have been any other."""
_AS_LIKELY = -2.0 * float(np.log(1e-6))
"""Explanations are equally good whose likelihoods differ by less."""
_WIDTH = 3.29
"""Sigmas of an interval that holds 99.9 %."""
_WORK = 60_000
"""Edges of all graphs that are solved, of each sort of changes."""
_FEWEST_SOLVED, _MOST_SOLVED, _MOST_FITTED = 3, 60, 5
_MOST_NAMED = 6
_MOST_STARTS = 2
"""From which numbers are fitted to loops: the best."""
_APART = 0.3
"""Difference of numbers, from which fits that begin with them may end apart."""
_AS_CLOSE = 1.5
"""Times the least median of squared residuals of loops, up to which others close them as well."""
_FAR = 200.0
"""Squared residual of an edge that no noise of the others explains."""
_MOST_SINGLE = 3
_TRIED_SINGLE = 6
_READINGS_OF_FEW = ("is the covariance", "is a square root of it")
"""Of edges that are told by their size alone."""
_MOST_JUDGED = 5_000
"""Edges of a graph with a plausible chi-square whose residuals are judged all the same."""
_NO_CHANCE = 1e-9
_CLOSING = 6.0
"""Medians of squared residuals of loops, over those of the noise, up to which loops close."""
_MOST_RATIO = 2.5
"""Largest upper end over lower end of the interval of an information that is named."""
_TELLS = 4.0
"""Mean square of what edges measure, in their sigma, from which they tell anything."""
_OUTSIDE = 1e-3
"""Share of intervals of an information that do not hold it."""
_TIMES = "times the information"
_BOTH = " and with the opposite sign"
"""Of a change that is an order and signs at once."""
_ALIKE = 1e-6
"""Chi-squares are of one map, mirrored or turned, that differ by less, relative."""


class EdgeReading(NamedTuple):
    """What makes a graph fit.

    Attributes:
        words: Which edges fit how.
        chi_square: Of the optimum then.
        is_note: It is about noise that is smaller than stated, which makes no estimate wrong.
    """

    words: str
    chi_square: ChiSquareTest
    is_note: bool = False


class EdgeCandidate(NamedTuple):
    """What is likelier than a graph as it stands.

    Attributes:
        words: What fits.
        slot: Its words.
        likelihood: -2 log of it.
        test: Of the optimum's chi-square.
        numbers: How many were fitted.
        kind: The words without their numbers.
        is_vague: Its number is too uncertain to be named alone.
        is_sound: It leaves the stated noise, everywhere.
    """

    words: str
    slot: str
    likelihood: float
    test: ChiSquareTest
    numbers: int = 0
    kind: str = ""
    is_vague: bool = False
    is_sound: bool = True


def explained(result: SmootherEvidence) -> EdgeReading | None:
    """Return what makes a graph fit whose optimum does not.

    Args:
        result: The optimum of a graph of poses.

    Returns:
        None where the graph fits as it stands, or no change makes it fit.
    """
    problem, optimality = result.problem, result.optimality
    test = optimality.chi_square
    if test.dof <= 0 or problem.pose_landmarks.count or result.reweighted:
        return None
    doubtful = not optimality.verified or test.reading != "plausible"
    if not (doubtful or _stand_twice(problem) or _leaves_noise(result)):
        return None
    some = equally_good(_Search(result).candidates())
    return _reading(some, test) if some else None


def few_misread(problem: SlamProblem) -> EdgeReading | None:
    """Return the reading of the few edges of extreme information by which a graph fits.

    Args:
        problem: A graph.

    Returns:
        None where there are no such edges, or no reading makes them like the others and the graph
        fit.
    """
    every = EdgeSlot("they", (ODOMETRY, CLOSURES))
    few = extreme_edges(columns(problem, every).covariance)
    if not len(few.rows):
        return None
    slot = every._replace(rows=few.rows)
    for change in changes_of_information(3):
        if not change.words.endswith(_READINGS_OF_FEW):
            continue
        mended = mended_graph(EdgeFault(slot, change), problem)
        if mended is None or len(extreme_edges(columns(mended, every).covariance).rows):
            continue
        goodness = optimum_of(mended)
        if goodness is not None and goodness.sound:
            return EdgeReading(f"they fit {change.words}", goodness.test)
    return None


def _leaves_noise(result: SmootherEvidence) -> bool:
    """Whether no chance leaves residuals as some are, though chi-square is plausible."""
    reading = result.optimality.chi_square.reading
    if result.graph.size() > _MOST_JUDGED or reading != "plausible":
        return False
    worst = Goodness(result.problem, result.graph, result.values).worst
    return worst is not None and worst.p_value < _NO_CHANCE


def _stand_twice(problem: SlamProblem) -> bool:
    """Whether closures stand there twice, number for number."""
    closed = problem.loop_closures
    rows = np.column_stack((closed.first, closed.second, closed.motion))
    return len(np.unique(rows, axis=0)) < len(rows)


def _reading(candidates: Sequence[EdgeCandidate], test: ChiSquareTest) -> EdgeReading:
    """One sentence of equally good explanations, those with the fewest numbers first."""
    by_kind: dict[str, EdgeCandidate] = {}
    for candidate in sorted(
        candidates, key=lambda candidate: (candidate.numbers, candidate.likelihood)
    ):
        by_kind.setdefault(candidate.kind or candidate.words, candidate)
    best = next(iter(by_kind.values()))
    listed = _of_one_map(list(by_kind.values()))
    words = ", or ".join(listed[:_MOST_NAMED])
    more = len(listed) - _MOST_NAMED
    words += f", or by {more} more changes" if more > 0 else ""
    smaller = test.reading == "too low" and any(
        _TIMES in candidate.words for candidate in by_kind.values()
    )
    return EdgeReading(words, replace(test, chi2=best.test.chi2, dof=best.test.dof), smaller)


def _of_one_map(candidates: Sequence[EdgeCandidate]) -> list[str]:
    """Words of candidates, those of one slot joined whose graphs fit equally to rounding.

    These have one map but for a mirror or quarter turns, which no edge tells.
    """
    groups: list[list[EdgeCandidate]] = []
    for candidate in candidates:
        for group in groups:
            if _is_one_map(group[0], candidate):
                group.append(candidate)
                break
        else:
            groups.append([candidate])
    return [_of_group(group) for group in groups]


def _is_one_map(candidate: EdgeCandidate, other: EdgeCandidate) -> bool:
    plain = candidate.slot == other.slot and not candidate.numbers + other.numbers
    return plain and abs(candidate.test.chi2 - other.test.chi2) <= _ALIKE * candidate.test.chi2


def _of_group(group: Sequence[EdgeCandidate]) -> str:
    """Join words of one slot; changes of two sorts at once are said by what they amount to."""
    simple = [candidate.words for candidate in group if _BOTH not in candidate.words] or [
        group[0].words
    ]
    head = f"{group[0].slot} fit "
    words = " or ".join(
        [simple[0], *(phrase.removeprefix(head) for phrase in simple[1:_MOST_NAMED])]
    )
    return words if len(simple) == len(group) else f"{words} (or so, mirrored or turned)"


def equally_good(every: Sequence[EdgeCandidate]) -> list[EdgeCandidate]:
    """Return the likeliest candidates; none where one is likelier that leaves more than noise.

    Args:
        every: Of one graph.
    """
    least = min((candidate.likelihood for candidate in every), default=0.0)
    alike = [
        candidate
        for candidate in every
        if candidate.is_sound and candidate.likelihood <= least + _AS_LIKELY
    ]
    return [] if all(candidate.is_vague for candidate in alike) else alike


class _Search:
    """The search over one graph."""

    def __init__(self, result: SmootherEvidence) -> None:
        """result: its optimum as it stands."""
        self.problem, self.test = result.problem, result.optimality.chi_square
        self.stated = Goodness(result.problem, result.graph, result.values)
        self.likelihood = likelihood(self.stated)
        every = [fault for slot in slots(self.problem) for fault in faults_of(slot)]
        self.plain = [fault for fault in every if not fault.change.neutral]
        self.numbered = [fault for fault in every if fault.change.neutral]
        self.edges = len(self.problem.steps) + len(self.problem.loop_closures.first)
        self.edges += len(self.problem.z)
        self._solved: dict[tuple[object, ...], Goodness | None] = {}
        self.most = int(np.clip(_WORK // max(self.edges, 1), _FEWEST_SOLVED, _MOST_SOLVED))

    def candidates(self) -> list[EdgeCandidate]:
        """Return all changes that are likelier than the graph as it stands."""
        measured = self._screened(fault for fault in self.plain if fault.change.keeps_weights)
        informations = self._screened(
            fault for fault in self.plain if not fault.change.keeps_weights
        )
        every = [*self._plainly(measured), *self._plainly(informations)]
        if not any(candidate.is_sound for candidate in every):  # else no other leaves so much less
            every += [*self._by_noise(), *self._by_size(measured)]
            if self.edges <= MOST_EDGES:
                every += [*self._by_numbers(), *self._by_single()]
        return every

    def _by_size(self, screened: list[EdgeFault]) -> Iterator[EdgeCandidate]:
        """Yield changes that no chance makes so much lower, the noise of all edges being fitted."""
        stated = likelihood(self.stated, any_size=True)
        for fault in screened:
            goodness = self._optimum_with(fault)
            if goodness is not None and goodness.within and far_less(goodness.test, self.test):
                words = f"{fault.slot.words} fit {fault.said()}"
                value = likelihood(goodness, self._log_volume(fault), any_size=True)
                if value + _LIKELIER < stated:
                    value += _EACH_NUMBER
                    yield EdgeCandidate(words, fault.slot.words, value, goodness.test)

    def _optimum_with(self, fault: EdgeFault) -> Goodness | None:
        """Return the optimum with what mends a fault without numbers, unless it is too high."""
        mended = mended_graph(fault, self.problem)
        if mended is None:
            return None
        edges = columns(mended, fault.slot)
        numbers = (edges.first, edges.second, np.round(edges.z, 9), _digits(edges.covariance))
        key = fault.slot.kinds, *(number.tobytes() for number in numbers)
        if key not in self._solved:
            self._solved[key] = optimum_with(fault, self.problem)
        return self._solved[key]

    def _screened(self, some: Iterable[EdgeFault]) -> list[EdgeFault]:
        """Return the faults without numbers that loops speak for, the best first."""
        scored: list[tuple[float, int, EdgeFault]] = []
        for fault in some:
            mended = mended_graph(fault, self.problem)
            if mended is not None:
                sizes = loop_sizes(mended)
                if not fault.change.keeps_weights:  # else the largest covariance were the best
                    sizes = np.maximum(sizes, 1.0 / np.maximum(sizes, 1e-300))
                scored.append((float(np.max(sizes, initial=0.0)), len(scored), fault))
        scored.sort(key=lambda score: score[:2])
        most = max(_CLOSING, 2.0 * scored[0][0]) if scored else 0.0
        return [fault for score, _, fault in scored[: self.most] if score <= most]

    def _plainly(self, screened: list[EdgeFault]) -> Iterator[EdgeCandidate]:
        """Yield changes without numbers."""
        for fault in screened:
            goodness = self._optimum_with(fault)
            if goodness is None or goodness.test.reading != "plausible":
                continue
            words = f"{fault.slot.words} fit {fault.said()}"
            if fault.change.name == "twice":
                if goodness.sound and not self.stated.sound:
                    yield EdgeCandidate(words, fault.slot.words, -np.inf, goodness.test)
                continue
            value = likelihood(goodness, self._log_volume(fault))
            weights = not fault.change.keeps_weights
            if not weights or _tells(goodness.problem, fault.slot):
                yield from self._candidate(words, fault.slot, goodness, value, weights=weights)

    def _log_volume(self, fault: EdgeFault, numbers: Array | None = None) -> float:
        """Logarithm of the volume of what is meant over that of what was read."""
        edges = len(columns(self.problem, fault.slot).first)
        return edges * fault.change.log_volume_of(numbers)

    def _candidate(
        self,
        words: str,
        slot: EdgeSlot,
        goodness: Goodness,
        value: float,
        numbers: int = 0,
        *,
        weights: bool = False,
    ) -> Iterator[EdgeCandidate]:
        """Yield a change, unless it is likelier by chance.

        Args:
            words: What to say.
            slot: Which edges.
            goodness: The optimum then.
            value: -2 log likelihood, but for the numbers.
            numbers: How many were fitted.
            weights: It is of the informations.
        """
        value += _EACH_NUMBER * numbers
        if value + _LIKELIER < self.likelihood:
            sound = goodness.sound and (not weights or are_white(goodness, slot))
            yield EdgeCandidate(words, slot.words, value, goodness.test, numbers, is_sound=sound)

    def _by_numbers(self) -> Iterator[EdgeCandidate]:
        """Yield changes whose numbers are fitted."""
        for fault, start in self._likeliest():
            fit = fitted(fault, self.problem, start)
            if fit is None:
                continue
            numbers, sigma, goodness = fit
            apart = np.abs(numbers - np.array(fault.change.neutral))
            if not (apart > 2.0 * _WIDTH * sigma).any() or not np.isfinite(sigma).all():
                continue
            words = f"{fault.slot.words} fit {fault.said(numbers, _WIDTH * sigma)}"
            value = likelihood(goodness, self._log_volume(fault, numbers))
            for candidate in self._candidate(words, fault.slot, goodness, value, len(numbers)):
                yield candidate._replace(kind=fault.kind)

    def _likeliest(self) -> list[tuple[EdgeFault, Array]]:
        """Return the faults with numbers that loops speak for, and numbers from which to begin.

        Small ones are those by which chi-square would fall most, to first order.
        """
        rough: dict[str, tuple[float, Array]] = {}
        falls: dict[str, float] = {}
        for fault in self.numbered:
            if fault.kind in rough:
                continue
            falls[fault.kind] = self._fall(fault)
            starts = [np.array(numbers) for numbers in (fault.change.neutral, *fault.change.starts)]
            open_by = [openness(fault, self.problem, start) for start in starts]
            for k in np.argsort(open_by, kind="stable")[:_MOST_STARTS].tolist():
                start = starts[k]
                numbers, score = roughly(fault, self.problem, start)
                if fault.kind not in rough or score < rough[fault.kind][0]:
                    rough[fault.kind] = score, numbers
        ranked = sorted(rough, key=lambda kind: rough[kind][0])
        best = ranked[: min(_MOST_FITTED, self.most)]
        best += [kind for kind in ranked if rough[kind][0] < _AS_CLOSE * rough[best[0]][0]]
        steepest = sorted(falls, key=lambda kind: -falls[kind])[: min(_MOST_FITTED, self.most)]
        chosen = [
            (edge_fault, rough[edge_fault.kind][1])
            for edge_fault in self.numbered
            if edge_fault.kind in best
        ]
        neutral = [
            (edge_fault, np.array(edge_fault.change.neutral))
            for edge_fault in self.numbered
            if edge_fault.kind in steepest
        ]
        return chosen + [
            (edge_fault, start)
            for edge_fault, start in neutral
            if edge_fault.kind not in best
            or np.abs(rough[edge_fault.kind][1] - start).max() > _APART
        ]

    def _fall(self, fault: EdgeFault) -> float:
        """Return by how much chi-square would fall, to first order."""
        stated = self.stated
        try:
            step, sigma, _ = newton_step(
                fault, self.problem, np.array(fault.change.neutral), stated.values
            )
        except (RuntimeError, ValueError, np.linalg.LinAlgError):
            return 0.0
        return float(np.sum((step / np.maximum(sigma, 1e-300)) ** 2))

    def _by_noise(self) -> Iterator[EdgeCandidate]:
        """Yield informations that are so many times too large or too small, vague ones, too."""
        for slot in slots(self.problem):
            fit = fitted_noise(slot, self.stated)
            if fit is None or not fit[0].settled or not fit[1].sound:
                continue
            noise, goodness = fit
            low, high = noise.interval(_OUTSIDE)
            if not low > 0.0 or low <= 1.0 <= high or not _tells(goodness.problem, slot):
                continue
            words = _said_information(slot.words, noise.factor, low, high)
            value = likelihood(goodness)
            for candidate in self._candidate(words, slot, goodness, value, 1, weights=True):
                vague = high > _MOST_RATIO * low
                yield candidate._replace(kind=f"{slot.words} {_TIMES}", is_vague=vague)

    def _by_single(self) -> Iterator[EdgeCandidate]:
        """Yield the edges without which all others fit: up to a few."""
        problem, goodness, before = self.problem, self.stated, list[str]()
        for _ in range(_MOST_SINGLE):
            fits: list[tuple[float, int, EdgeSlot, Goodness]] = []
            for slot in _suspects(goodness)[:_TRIED_SINGLE]:
                fit = optimum_of(_left_out(problem, slot), any_size=True)
                if fit is not None:
                    fits.append((fit.test.chi2, len(fits), slot, fit))
            fits.sort(key=lambda fit: fit[:2])
            if not fits or not fits[0][0] < goodness.test.chi2 - _LIKELIER:
                return
            for _, _, slot, fit in fits:
                yield from self._without([*before, slot.words], slot, fit)
            _, _, slot, goodness = fits[0]
            if goodness.sound:
                return
            problem = goodness.problem
            before.append(slot.words)

    def _without(
        self, names: list[str], last: EdgeSlot, goodness: Goodness
    ) -> Iterator[EdgeCandidate]:
        """Yield that edges do not agree. last: of them. goodness: the optimum without them."""
        alone = len(names) == 1
        words = f"{' and '.join(names)} do{'es' if alone else ''} not agree with the rest, which "
        words += "fits without it" if alone else "fits without them"
        value = likelihood(goodness) + len(names) * self._anything()
        for candidate in self._candidate(words, last, goodness, value):
            said = self._of_single(last, goodness) if alone and candidate.is_sound else ""
            yield candidate._replace(words=f"{words}, and with it {said}" if said else words)

    def _anything(self) -> float:
        """-2 log likelihood of an edge that may measure anything, being any of the edges."""
        poses, _ = from_values(self.stated.values, self.problem)
        width_m = float(np.ptp(poses[:, :2], axis=0).max()) or 1.0
        volume = 2.0 * np.pi * (2.0 * width_m) ** 2
        return 2.0 * float(np.log(volume * self.edges)) - 3.0 * float(np.log(2.0 * np.pi))

    def _of_single(self, slot: EdgeSlot, rest: Goodness) -> str:
        """Say which changes of one edge make it fit. rest: the optimum of the others."""
        said: list[str] = []
        poses = from_values(rest.values, rest.problem)[0]
        for change in changes_of_motion():
            mended = mended_graph(EdgeFault(slot, change), self.problem)
            if mended is None or _misses(columns(mended, slot), slot, poses):
                continue
            goodness = optimum_of(mended)
            if goodness is not None and goodness.sound and change.words not in said:
                said.append(change.words)
        return " or ".join(said) if len(said) <= _MOST_NAMED else ""


def _tells(problem: SlamProblem, slot: EdgeSlot) -> bool:
    """Whether what edges measure is larger than their noise; any numbers fit else."""
    edges = columns(problem, slot)
    z = edges.z if LANDMARKS in slot.kinds or slot.is_motion else edges.z - edges.z.mean(axis=0)
    squared = np.einsum("ni,nij,nj->n", z, np.linalg.inv(edges.covariance), z)
    return bool(np.median(squared) > _TELLS * z.shape[1])


def _misses(edges: EdgeColumns, slot: EdgeSlot, poses: Array) -> bool:
    """Whether the single edge of a slot is far from what poses (K, 3) tell."""
    row = np.zeros(0, dtype=np.intp) if slot.rows is None else slot.rows
    first, second, spread = edges.first[row], edges.second[row], edges.covariance[row]
    apart = in_own_axes(edges.z[row], in_own_axes(poses[first], poses[second]))
    apart[:, 2] = np.angle(np.exp(1j * apart[:, 2]))
    squared = np.einsum("ni,nij,nj->n", apart, np.linalg.inv(spread), apart)
    return bool((squared > _FAR).any())


def _said_information(slot: str, factor: float, low: float, high: float) -> str:
    """Say of an information what the noise's factor tells of it."""
    size, least, most = (times**-2.0 for times in (factor, high, low))
    return f"{slot} fit with {size:.2g} ({least:.2g} to {most:.2g}) times the information"


def _digits(covariance: Array) -> Array:
    """Covariances (N, n, n) to nine digits of their scale."""
    scale = np.maximum(np.abs(covariance).max(axis=(1, 2), keepdims=True), 1e-300)
    return np.asarray(np.round(covariance / scale, 9) * np.exp(np.round(np.log(scale), 9)))


def _suspects(goodness: Goodness) -> list[EdgeSlot]:
    """Return single edges between poses, those first whose leaving out lowers chi-square most."""
    p = goodness.problem
    rows = row_origins(p)
    jacobian, right = sparse_system(goodness.graph, goodness.values, len(rows.component))
    jacobian = scaled_columns(jacobian, column_lengths(jacobian))
    try:
        solver = normal_factors(jacobian)
    except RuntimeError:
        return []
    closings = len(right) - 3 * len(p.loop_closures.first)
    starts = np.concatenate(
        (3 + 3 * np.arange(len(p.steps)), np.arange(closings, len(right), 3))
    ).astype(np.intp)
    size = np.array([right[start : start + 3] @ right[start : start + 3] for start in starts])
    falls = []
    for number in np.argsort(-size)[:40].tolist():
        block = np.arange(starts[number], starts[number] + 3)
        fitted = jacobian[block] @ solver.solve(jacobian[block].T.toarray())
        left = np.eye(3) - fitted + 1e-9 * np.eye(3)
        falls.append((float(right[block] @ np.linalg.solve(left, right[block])), number))
    falls.sort(reverse=True)
    return [_single(p, number) for _, number in falls]


def _single(problem: SlamProblem, number: int) -> EdgeSlot:
    """One edge between poses, by its row in those of odometry and closures."""
    steps, closed = problem.steps, problem.loop_closures
    if number < len(steps):
        first = int(steps[number])
        words = f"edge {first} to {first + 1} (odometry)"
        return EdgeSlot(words, (ODOMETRY,), np.array([number]))
    row = number - len(steps)
    words = f"edge {closed.first[row]} to {closed.second[row]} (a loop closure)"
    return EdgeSlot(words, (CLOSURES,), np.array([row]))


def _left_out(problem: SlamProblem, slot: EdgeSlot) -> SlamProblem:
    """Return the problem without one edge."""
    [row] = [] if slot.rows is None else slot.rows.tolist()
    if slot.kinds == (ODOMETRY,):
        spread = problem.increment_covariance.copy()
        spread[problem.steps[row]] = np.nan
        return replace(problem, increment_covariance=spread)
    closed, kept = problem.loop_closures, np.ones(len(problem.loop_closures.first), dtype=bool)
    kept[row] = False
    columns_kept = {
        name: getattr(closed, name)[kept] for name in ("first", "second", "motion", "covariance")
    }
    return replace(problem, loop_closures=replace(closed, **columns_kept))
