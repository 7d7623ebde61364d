"""Run a command as other processors would round it: `python -m benchmarks.flavours COMMAND ...`.

OpenBLAS and numpy choose their code by the processor; both let the environment choose older code.
What a flavour changes are the last bits of sums, sines and arctangents.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence

import numpy as np


def newest_features() -> str:
    """The vector features of numpy that are in use, but the oldest of those it may do without."""
    found = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    return " ".join(found[1:] or found)


def flavours() -> dict[str, dict[str, str]]:
    """What to set in the environment, by the flavour's name; the first sets nothing."""
    return {
        "this processor": {},
        "Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
        "an old processor": {
            "OPENBLAS_CORETYPE": "Prescott",
            "NPY_DISABLE_CPU_FEATURES": newest_features(),
        },
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command under each flavour asked for; the number of flavours under which it fails."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--only", nargs="+", choices=list(flavours()), default=list(flavours()))
    parser.add_argument("command", nargs=argparse.REMAINDER, help="after a --")
    chosen = parser.parse_args(argv)
    command = [word for word in chosen.command if word != "--"]
    failed = []
    for name in chosen.only:
        print(f"as on {name}: {' '.join(command)}", flush=True)
        if subprocess.run(command, env={**os.environ, **flavours()[name]}, check=False).returncode:
            failed.append(name)
    print(f"fails as on: {', '.join(failed)}" if failed else "passes as on all", flush=True)
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
