"""Which faults in other people's filters the audit finds, and how often it flags sound ones.

    python -m research.trust.audit_faults [--seed 2000] [--sound 50]

Each of ten faults in each filter of examples/audit is recorded and audited. The first fault that
the audit reports is right in its event if no snapshot tells it from the planted one; where a sensor
is at fault from some time on, if it is within a tenth of the trace's events. It is right in its
blocks if they hold the planted ones, or are some of them; of a sensor, if it is named. Then sound
traces are audited, so many of each filter, seeds 1000 and up; the interval is Clopper and
Pearson's, 95 %.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from comparisons.audit.algebra import AuditFinding
from comparisons.audit.audit import audit
from comparisons.trace.events import Snapshot
from comparisons.trace.reader import TraceReader
from examples.audit.faults import Fault, Planted
from research.script import options, print_head, print_row
from research.trust.defects import share

FILTERS = ("filterpy_ekf", "navlie_se3", "gtsam_filters", "msckf")
FIRST_SOUND = 1000


class AuditOutcome(NamedTuple):
    """What the audit made of a planted fault: whether that is right, and its first finding."""

    found: bool
    event: bool
    blocks: bool
    first: AuditFinding | None


def judge(path: Path, planted: Planted, fault: Fault) -> AuditOutcome:
    """Audit a trace and compare the first fault with the planted one."""
    result = audit(path)
    faults = [finding for finding in result.findings if finding.fault]
    if not faults:
        return AuditOutcome(found=False, event=False, blocks=False, first=None)
    first = faults[0]
    event = first.event in range(planted.event, _next_snapshot(path, planted.event))
    blocks = _same_blocks(first, planted)
    if fault.statistical:
        margin = 0.1 * result.events
        event = first.event is not None and abs(first.event - planted.event) <= margin
        blocks = first.sensor == planted.sensor
    return AuditOutcome(found=True, event=event, blocks=blocks, first=first)


def _next_snapshot(path: Path, event: int) -> int:
    return next(e.number for e in TraceReader(path) if isinstance(e, Snapshot) and e.number > event)


def _same_blocks(finding: AuditFinding, planted: Planted) -> bool:
    found, sought = set(finding.blocks), set(planted.blocks)
    return bool(found) and (found <= sought or sought <= found)


def planted_faults(seed: int, folder: Path) -> None:
    """Print every fault, and how many are found."""
    rows = []
    print_head("filter", "fault", "found", "event", "blocks", "first finding")
    for name in FILTERS:
        module = import_module(f"examples.audit.{name}")
        for key, fault in module.FAULTS.items():
            path = folder / f"{name}-{key}"
            planted = module.record(path, seed, key, 1)
            judged = judge(path, planted, fault)
            rows.append(judged)
            marks = ("yes" if one else "**no**" for one in judged[:3])
            said = "sound" if judged.first is None else judged.first.text
            print_row(name, f"{planted.what}, event {planted.event}", *marks, said)
    found, event, blocks = (sum(marks) for marks in zip(*(row[:3] for row in rows), strict=True))
    both = sum(row.event and row.blocks for row in rows)
    print(f"\n{found} of {len(rows)} found; right: event {event}, blocks {blocks}, both {both}")


def sound(filters: Sequence[str], runs: int, folder: Path) -> None:
    """Print how many sound traces are flagged."""
    flagged = 0
    for name in filters:
        for seed in range(FIRST_SOUND, FIRST_SOUND + runs):
            path = folder / f"{name}-{seed}"
            import_module(f"examples.audit.{name}").record(path, seed)
            result = audit(path)
            if not result.sound:
                flagged += 1
                print(f"{name}, seed {seed}: {result.findings[0].text}", flush=True)
            path.unlink()
    print(share(flagged, runs * len(filters), "sound traces flagged"))


def main() -> None:
    """Print both."""
    given = options(__doc__, seed=2000, sound=50)
    with tempfile.TemporaryDirectory() as folder:
        planted_faults(given.seed, Path(folder))
        sound(FILTERS, given.sound, Path(folder))


if __name__ == "__main__":
    main()
