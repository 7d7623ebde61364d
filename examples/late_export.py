"""A right estimate, exported with a bug: every pose is stamped with the time of the next one.

slamcheck run simulated-loop --out right
python examples/late_export.py right/ekf late.tum
slamcheck check simulated-loop --estimate right/ekf      # agree, exits with 0
slamcheck check simulated-loop --estimate late.tum       # disagree: time, exits with 1
"""

import sys
from itertools import pairwise
from pathlib import Path

source, target = Path(sys.argv[1]) / "trajectory.tum", Path(sys.argv[2])
rows = [line.split() for line in source.read_text().splitlines()]
late = [[after[0], *before[1:]] for before, after in pairwise(rows)]
target.write_text("".join(" ".join(row) + "\n" for row in late))
