"""Tell which cases are to be diagnosed once more by a library without their effect.

Prints a line `CASE EFFECT` for every clear single case of a known effect. It opens the truth, as
the scorer does; the diagnosis is told only which effect to leave out.
"""

import argparse
from pathlib import Path

from tests.blind.figures import DETECTABLE
from tests.blind.truth import read_truth


def main() -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(description="List the cases for leave-one-out.")
    parser.add_argument("--truth", type=Path, required=True)
    options = parser.parse_args()
    truths, _ = read_truth(options.truth)
    for truth in truths:
        effects = truth["effects"]
        if len(effects) == 1 and effects[0]["known"] and effects[0]["d_prime"] >= DETECTABLE:
            print(truth["case"], effects[0]["effect"])


if __name__ == "__main__":
    main()
