"""Random graphs, broken files and random command lines: no traceback, no hang, no NaN, no false "converged".

python benchmarks/fuzz.py                                  # all: 2,000 graphs, 5,000 files, 500 command lines
python benchmarks/fuzz.py graphs --count 200 --seed 7
python benchmarks/fuzz.py files --count 1300
python benchmarks/fuzz.py commands --count 50 --only 17    # one case again

Everything follows from the random seed and the number of the case. A case fails that ends in a traceback, needs more than
20 s of processor time, or repeats a long input in its message. The exit status is 1 if a case fails.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections import Counter
from collections.abc import Callable

from fuzzing.attempt import Case, attempt
from fuzzing.commands import command_case
from fuzzing.files import file_case
from fuzzing.graphs import graph_case

#: the address space [bytes] of the run: what would take more memory fails instead of ending other programs
MEMORY = 8 << 30

SUITES: dict[str, Callable[[int, int], Case]] = {"graphs": graph_case, "files": file_case, "commands": command_case}
COUNTS = {"graphs": 2000, "files": 5000, "commands": 500}


def main() -> int:
    """Run the cases and print what fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("suites", nargs="*", help=f"of {', '.join(SUITES)}; default: all")
    parser.add_argument("--count", type=int, help="cases of each")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="run this case alone")
    arguments = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    failed = 0
    for suite in arguments.suites or SUITES:
        begin, outcomes, slowest = time.process_time(), Counter[str](), (0.0, "")
        numbers = range(arguments.count or COUNTS[suite]) if arguments.only is None else [arguments.only]
        for number in numbers:
            name, check = SUITES[suite](arguments.seed, number)
            start = time.process_time()
            outcome, problems = attempt(check)
            slowest = max(slowest, (time.process_time() - start, name))
            outcomes[outcome] += 1
            failed += bool(problems)
            for problem in problems:
                print(f"{name}\n    {problem[:300]}", flush=True)
        counts = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items())
        spent = f"{time.process_time() - begin:.0f} s of processor time"
        print(f"{suite}: {counts}; {spent}, slowest {slowest[0]:.1f} s ({slowest[1]})")
    print(f"{failed} cases failed")
    return failed > 0


if __name__ == "__main__":
    sys.exit(main())
