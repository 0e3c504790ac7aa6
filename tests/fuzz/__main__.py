"""Run cases by hand: `python -m tests.fuzz --seed 7 --kind scenes --only 12`."""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from pathlib import Path

from tests.fuzz.case import random_of
from tests.fuzz.kinds import KINDS, SHARES
from tests.fuzz.runner import run_cases


def main() -> None:
    """Read the arguments, run, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    parser.add_argument("--seed", type=int, default=random.randrange(2**31))
    parser.add_argument("--kind", choices=KINDS, help="default: all")
    parser.add_argument("--cases", type=int, help="in all; default: 2,000 and a few more")
    parser.add_argument("--only", type=int, help="the number of a single case of the kind")
    parser.add_argument("--all", action="store_true", help="tell the ending of every case")
    parser.add_argument("--keep", type=Path, help="with --only: its files go there, too")
    given = parser.parse_args()
    kinds = [given.kind] if given.kind else list(KINDS)
    print(f"seed {given.seed}", flush=True)
    with tempfile.TemporaryDirectory(prefix="gpf-fuzz-") as folder:
        if given.only is not None:
            shares, first = {kinds[0]: 1}, given.only
        else:
            whole = sum(SHARES[kind] for kind in kinds)
            factor = 1 if given.cases is None else given.cases / whole
            shares, first = {kind: max(1, round(SHARES[kind] * factor)) for kind in kinds}, 0
        tally = run_cases(shares, given.seed, Path(folder), first)
        if given.keep:  # the run has made the good files
            given.keep.mkdir(parents=True)
            make, rng = KINDS[kinds[0]], random_of(given.seed, kinds[0], first)
            print(make(rng, given.keep, Path(folder) / "good").words)
    for ending in tally.endings if given.only is not None or given.all else tally.faults:
        print(ending)
    print(tally.table())
    sys.exit(bool(tally.faults))


if __name__ == "__main__":
    main()
