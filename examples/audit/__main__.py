"""Record one of the filters: `python -m examples.audit filterpy_ekf run.trace --fault twice`."""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path

FILTERS = ("filterpy_ekf", "filterpy_ukf", "navlie_se3", "gtsam_filters", "msckf")


def main(words: list[str] | None = None) -> None:
    """Record a trace, and print where its bug is."""
    parser = argparse.ArgumentParser(prog="python -m examples.audit", description=__doc__)
    parser.add_argument("filter", choices=FILTERS)
    parser.add_argument("trace", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fault", help="one of the filter's FAULTS")
    parser.add_argument("--snapshots", type=int, default=1, help="steps by snapshot")
    options = parser.parse_args(words)
    module = import_module(f"examples.audit.{options.filter}")
    if options.fault is not None and options.fault not in module.FAULTS:
        parser.error(f"--fault {options.fault}: expected one of {', '.join(module.FAULTS)}")
    planted = module.record(options.trace, options.seed, options.fault, options.snapshots)
    if planted is not None:
        sensor = "" if planted.sensor is None else f" of sensor {planted.sensor}"
        print(f"planted in event {planted.event}{sensor}: {planted.what}")


if __name__ == "__main__":
    main()
