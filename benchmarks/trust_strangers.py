"""How `slamcheck check` grades filters and logs of a stranger, sound ones and faulty ones.

    python -m benchmarks.trust_strangers [time] [sound] [faults] [--quick] [--seed 0]
                                         [--log FOLDER] [--only WORD] [--list] [--self-test]

time: the textbook's EKF on logs with stamps of all kinds; sound: filters of other forms; faults:
planted ones, with the midpoint motion and an exact arc, with and without a trace. All require the
grade `like`. A first cause is `named` if it has the words of its fault, `false` if it names another
one, else `general`. The effect is the largest difference from the same filter without the fault, in
its sigmas, of means and (behind /) the largest factor of a sigma. --log takes another log folder
with speeds and yaw rates for sound and faults; --only those whose names hold a word.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import slamcheck
from benchmarks.stranger_faults import CAUSES, naming
from benchmarks.strangers import (
    SAME,
    SOUND,
    Arc,
    Array,
    Course,
    Ekf,
    differences,
    read_log,
    simulate,
    wrapped,
)

COURSES = (
    Course("easy-10"),
    Course("hard-10", hard=True),
    Course("easy-2", rate_hz=2.0, scan_every=1),
    Course("hard-2", rate_hz=2.0, scan_every=1, hard=True),
    Course("easy-20-ns", rate_hz=19.7, scan_every=10, stamps="nanosecond"),
    Course("easy-40-jitter", rate_hz=40.0, scan_every=20, stamps="jitter"),
    Course("easy-10-apart", stamps="apart"),
    Course("hard-10-epoch", hard=True, stamps="epoch"),
    Course("easy-30-ns", rate_hz=30.0, scan_every=15, stamps="nanosecond"),
    Course("steering-10", steering=True),
    Course("steering-10-epoch", steering=True, stamps="epoch"),
    Course("hour", rate_hz=1.0, scan_every=20, duration_s=3600.0, stamps="jitter"),
)
FOR_FILTERS = ("easy-10", "hard-10", "easy-2", "hard-2", "easy-10-apart", "steering-10")
FOR_FAULTS = ("easy-10", "hard-10", "steering-10")
QUICK_FAULTS = 8
NO_EFFECT = 1e-9


class Checked(NamedTuple):
    """What a check said. by: the nearest reference. first: cause with gap, evidence and hint."""

    grade: str
    by: str
    outcome: str
    first: tuple[str, str, str]

    @property
    def words(self) -> str:
        """The first cause in a line."""
        gap, evidence, hint = self.first
        return f"{gap}: {evidence} [{hint}]" if gap else ""


class Trial:
    """Logs and estimates in a folder that is removed."""

    def __init__(self, folder: Path, seed: int) -> None:
        """folder: empty."""
        self.folder, self.seed, self.count = folder, seed, 0

    def log(self, course: Course) -> Path:
        """Return the folder of a simulated log."""
        place: Path = self.folder / course.name
        if not place.exists():
            simulate(course, self.seed, place)
        return place

    def check(self, log: Path, ekf: Ekf, traced: bool) -> Checked:
        """Write an estimate and have it graded."""
        self.count += 1
        out = self.folder / f"estimate-{self.count}"
        ekf.write(out, traced)
        try:
            found = slamcheck.check(slamcheck.load_log(log), out, require="like")
        except slamcheck.InputError as error:
            return Checked("-", "", "refused", ("refused", str(error), ""))
        except Exception as error:  # a benchmark of strangers counts crashes, too
            return Checked("-", "", "crash", (type(error).__name__, str(error), ""))
        causes = [(one.gap, one.evidence, one.hint) for one in found.causes]
        by = found.grade.by.reference.name if found.grade.by else ""
        first = (causes or [("", "", "")])[0]
        return Checked(found.grade.value or "none", by, found.outcome, first)


def effect(faulty: Ekf, sound: Ekf) -> tuple[float, float]:
    """Return the largest difference of means in sigma, and the largest factor of a sigma."""

    def parts(ekf: Ekf, labels: list[int]) -> tuple[Array, Array]:
        x, p = ekf.joint()
        rows = [3 + 2 * list(ekf.index).index(label) + k for label in labels for k in (0, 1)]
        lines = np.array([ekf.tum(pose) for _, pose, _ in ekf.path])
        mean = np.column_stack((lines[:, :2], 2.0 * np.arctan2(lines[:, 5], lines[:, 6])))
        sigma = [np.sqrt(np.abs(np.diag(cov))) for _, _, cov in ekf.path]
        landmarks = np.sqrt(np.abs(np.diag(p)[rows]))
        return np.append(np.ravel(mean), x[rows]), np.append(np.ravel(sigma), landmarks)

    labels = [label for label in sound.index if label in faulty.index]
    (x, s), (x0, s0) = parts(faulty, labels), parts(sound, labels)
    apart = x - x0
    headings = 3 * len(sound.path)
    apart[2:headings:3] = wrapped(apart[2:headings:3])
    kept = s0 > 1e-9
    ratio = np.maximum(s[kept], 1e-12) / s0[kept]
    factor = np.max(np.maximum(ratio, 1.0 / ratio))
    return float(np.max(np.abs(apart[kept]) / s0[kept])), float(factor)


def time_part(trial: Trial, options: argparse.Namespace) -> Iterator[str]:
    """Stamps of all kinds: the textbook's filter has to be `equal`."""
    equal, courses = 0, COURSES[5:9:2] if options.quick else COURSES
    for course in courses:
        log = trial.log(course)
        found = trial.check(log, SOUND["textbook EKF"](read_log(log)).run(), True)
        equal += found.grade == "equal"
        yield (
            f"{course.name:18} {found.grade:10} {found.outcome:10} {found.words[:160] or found.by}"
        )
    yield f"time: {equal} of {len(courses)} equal"


def logs(trial: Trial, names: tuple[str, ...], options: argparse.Namespace) -> list[Path]:
    """Return the logs of a part."""
    if options.log:
        return [Path(one) for one in options.log]
    names = names[:2] if options.quick else names
    return [trial.log(course) for course in COURSES if course.name in names]


def sound_part(trial: Trial, options: argparse.Namespace) -> Iterator[str]:
    """Filters without a fault: with a trace where they have one, and without."""
    counts: Counter[str] = Counter()
    every = [name for name in SOUND if options.only in name]
    for log in logs(trial, FOR_FILTERS, options):
        for name in every[::3] if options.quick else every:
            ekf = SOUND[name](read_log(log)).run()
            for traced in (True, False)[not ekf.traced :]:
                found = trial.check(log, ekf, traced)
                counts[found.grade] += 1
                counts[found.outcome] += 1
                how = "trace" if traced else ""
                yield (
                    f"{log.name:14} {name:22} {how:6} {found.grade:10} {found.outcome:10} "
                    f"{found.words[: None if options.list else 110] or found.by}"
                )
    yield f"sound: {dict(sorted(counts.items()))}"


def faults_part(trial: Trial, options: argparse.Namespace) -> Iterator[str]:
    """Faults in two motion models, with a trace and without."""
    counts: dict[str, Counter[str]] = {}
    every = [fault for fault in CAUSES if options.only in fault.name]
    for log in logs(trial, FOR_FAULTS, options):
        for base, motion in ((Ekf, "mid"), (Arc, "arc")):
            right = base(read_log(log)).run()
            for fault in every[:: len(every) // QUICK_FAULTS or 1] if options.quick else every:
                try:
                    ekf = fault.plant(base)(read_log(log)).run()
                except (np.linalg.LinAlgError, ValueError, FloatingPointError) as error:
                    yield f"{log.name:12} {fault.name:34} {motion} broke down: {error}"
                    continue
                sigma, factor = effect(ekf, right)
                if max(sigma, factor - 1.0) < NO_EFFECT:
                    yield f"{log.name:12} {fault.name:34} {motion} has no effect on this log"
                    continue
                for traced in (True, False):
                    found = trial.check(log, ekf, traced)
                    told = naming(fault, *found.first[1:]) if found.first[0] else "none"
                    key = f"{motion}, {'trace' if traced else 'no trace'}"
                    counts.setdefault(key, Counter()).update((found.outcome, told))
                    by_fault = counts.setdefault(f"{fault.name}, {key[5:]}", Counter())
                    by_fault.update((found.outcome, told))
                    yield (
                        f"{log.name:12} {fault.name:34} {motion} {'trace' if traced else '':5} "
                        f"{sigma:8.2g}/{factor:<7.2g} {found.grade:10} {found.outcome:10} "
                        f"{told:8} {found.words if options.list else found.words[:110]}"
                    )
    for key, count in sorted(counts.items()):
        yield f"faults, {key}: {dict(sorted(count.items()))}"


def self_test(trial: Trial) -> Iterator[str]:
    """Equal forms, Jacobians by differences, and the NEES over 40 drives."""
    for name in ("easy-10", "hard-10"):
        log = trial.log(next(one for one in COURSES if one.name == name))
        right = Ekf(read_log(log)).run()
        for form in SAME:
            (x, p), (x0, p0) = SOUND[form](read_log(log)).run().joint(), right.joint()
            off = max(np.abs(x - x0).max(), np.abs(p - p0).max())
            yield f"{name}: {form} differs by {off:.1e}"
            assert off < 1e-9
    rng, log = np.random.default_rng(0), trial.log(COURSES[0])
    for kind in (Ekf, Arc):
        ekf = kind(read_log(log))
        for _ in range(20):
            pose, u, point = rng.normal(size=3), rng.normal(size=2), 5.0 * rng.normal(size=2)
            at, z = np.append(pose, u), np.array([3.0, 0.5]) + rng.normal(size=2)
            step = differences(lambda s, ekf=ekf: ekf.motion(s[:3], s[3:], 0.5)[0], at)
            _, f, b = ekf.motion(pose, u, 0.5)
            seen = differences(
                lambda s, ekf=ekf: ekf.expected(s[:3], s[3:])[0], np.append(pose, point)
            )
            _, hv, hl = ekf.expected(pose, point)
            new = differences(lambda s, ekf=ekf: ekf.place(s[:3], s[3:])[0], np.append(pose, z))
            _, gx, gz = ekf.place(pose, z)
            for ours, theirs in (((f, b), step), ((hv, hl), seen), ((gx, gz), new)):
                assert np.abs(np.hstack(ours) - theirs).max() < 1e-6
    yield "Jacobians: as by central differences"
    nees: dict[str, list[Any]] = {name: [] for name in SOUND}
    for seed in range(40):
        course = Course(f"nees-{seed}", duration_s=20.0)
        truth, _ = simulate(course, seed, trial.folder / course.name)
        for name, kind in SOUND.items():
            ekf = kind(read_log(trial.folder / course.name)).run()
            _, pose, cov = ekf.path[-1]
            off = pose - truth[np.searchsorted(ekf.log.odometry_s, ekf.path[-1][0])]
            off[2] = wrapped(off[2])
            nees[name].append(off @ np.linalg.solve(cov, off))
    for name, values in nees.items():
        yield f"NEES of the last pose, {name}: {np.mean(values):.2f} (3; 95 % band 2.29 to 3.80)"
        assert 2.0 < np.mean(values) < 4.2


def main() -> None:
    """Print the parts that are asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parts = {"time": time_part, "sound": sound_part, "faults": faults_part}
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(parts)} (all)")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--log", action="append", default=[])
    parser.add_argument("--only", default="")
    parser.add_argument("--list", action="store_true", help="first causes at full length")
    parser.add_argument("--self-test", action="store_true")
    options = parser.parse_args()
    chosen = options.parts or ([] if options.self_test else list(parts))
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(Path(folder), options.seed)
        for line in self_test(trial) if options.self_test else ():
            print(line, flush=True)
        for name in chosen:
            for line in parts[name](trial, options):
                print(line, flush=True)


if __name__ == "__main__":
    main()
